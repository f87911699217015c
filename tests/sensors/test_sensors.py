"""Every sensor: derivatives against differences, first guesses, and readings as the virtual robot has them."""

from dataclasses import replace

import numpy as np
import pytest

from bench import sensors as virtual
from pcalib import rotation, sensors
from pcalib.sensors.base import Scene

SET_UPS = [
    ("distance", "A", {}), ("distance", "A", {"distance_offset": "unknown"}), ("inclinometer", "", {}),
    ("probe", "A", {"surface_A": "plane"}), ("probe", "A", {"surface_A": "sphere"}),
    ("rotation_component", "", {}), ("pose_distance", "", {}),
]  # fmt: skip


def scene(n=12, seed=0, up=(0.0, 0.0, 1.0)):
    rng = np.random.default_rng(seed)
    R = rotation.exp(rng.normal(0, 0.1, (n, 3)))
    return Scene(rng.normal([0, 0, -0.8], 0.2, (n, 3)), R, np.array(up), rng.normal([0, 0, -0.8], 0.2, (n, 3)))


def values(sensor, to, options, seed=0):
    rng = np.random.default_rng(seed)
    return [rng.normal(0, 0.1, len(b.parameters)) for b in sensor.blocks(to, options)]


def test_every_sensor_is_tried_here(own_tests):
    assert {s.name for s in sensors.every()} - own_tests <= {name for name, _, _ in SET_UPS}


@pytest.mark.parametrize("name, to, options", SET_UPS)
@pytest.mark.parametrize("up", [(0, 0, 1.0), (0, 0, -1.0), (0.6, 0, 0.8)])
def test_derivatives_are_those_of_differences(name, to, options, up):
    sensor, at = sensors.get(name), scene(up=up)
    theta = values(sensor, to, options)
    seen, h = sensor.see(at, theta), 1e-6

    def moved(twist):
        R = rotation.exp(twist[3:]) @ at.R
        return sensor.see(replace(at, x=at.x + twist[:3], R=R), theta).value

    by = np.stack([(moved(h * e) - moved(-h * e)) / (2 * h) for e in np.eye(6)], axis=-1)
    assert np.abs(by - seen.by_twist).max() < 1e-7
    if seen.by_origin is not None:
        ends = [sensor.see(replace(at, origin=at.origin + s * h * e), theta).value for e in np.eye(3) for s in (1, -1)]
        by = np.stack([(a - b) / (2 * h) for a, b in zip(ends[::2], ends[1::2], strict=True)], axis=-1)
        assert np.abs(by - seen.by_origin[..., :3]).max() < 1e-7 and not seen.by_origin[..., 3:].any()
    if not theta:
        assert seen.own.shape[-1] == 0
        return
    flat = np.concatenate(theta)
    cuts = np.cumsum([len(t) for t in theta])[:-1]

    def other(values):
        return sensor.see(at, np.split(values, cuts)).value

    own = np.stack([(other(flat + h * e) - other(flat - h * e)) / (2 * h) for e in np.eye(len(flat))], axis=-1)
    assert np.abs(own - seen.own).max() < 1e-7


@pytest.mark.parametrize("name, to, options", SET_UPS)
def test_the_first_guess_finds_the_set_up(name, to, options):
    sensor, at = sensors.get(name), scene(40)
    sizes = [len(b.parameters) for b in sensor.blocks(to, options)]
    truth = {
        "distance": [np.array([0.3, -0.2, -1.1]), np.zeros(1)],
        "inclinometer": [np.array([0.01, -0.02, 0.0]), np.zeros(2)],
        "rotation_component": [], "pose_distance": [],
        "probe": [np.array([0.02, -0.01, -0.9])] if sizes == [3] else [np.array([0.1, 0.0, -1.0, 0.05])],
    }[name][: len(sizes)]  # fmt: skip
    found = sensor.start(at, sensor.see(at, truth).value, to, options)
    assert [len(f) for f in found] == sizes
    for a, b in zip(found, truth, strict=True):
        assert np.abs(a - b).max() < 1e-6


TRUTHS = {
    "ballbar": ("distance", {"stations_m": [0.3, 0.1, -1.1]}, lambda v: [v["stations"]]),
    "dial_gauge": ("probe", {"slope": [0.02, -0.03]}, lambda v: [_plane(v)]),
}


def _plane(v):
    normal = np.array([-v["slope"][0], -v["slope"][1], 1.0])
    normal /= np.linalg.norm(normal)
    angle = np.arccos(normal[2])
    side = np.array([-normal[1], normal[0]]) / np.linalg.norm(normal[:2])
    return np.append(angle * side, normal @ v["place"] - v["zero"])


@pytest.mark.parametrize("name", TRUTHS)
def test_readings_agree_with_the_virtual_robot(name):
    called, given, theta_of = TRUTHS[name]
    at = scene(20)
    made = virtual.make(name, {**given, "sigma_um": 0})
    read = made.read(at.x, at.R, np.arange(20), 0)
    seen = sensors.get(called).see(at, theta_of(made.values))
    assert read.name == called
    assert np.abs(read.value[:, 0] - seen.value[:, 0]).max() < 1e-12


def test_an_inclinometer_reads_the_turns_of_a_plate_above_its_zero():
    at = scene(30)
    made = virtual.make("inclinometer", {"sigma_urad": 0, "zero_mrad": [3, -2], "level_mrad": [8, -5], "turn_deg": 2})
    read = made.read(at.x, at.R, np.arange(30), 0)
    flat = made.read(at.x, np.broadcast_to(np.eye(3), at.R.shape), np.arange(30), 0).value[0, 3:5]
    theta = [np.append(flat, np.radians(2)), -made.values["level"]]
    seen = sensors.get("inclinometer").see(at, theta)
    assert np.abs(read.value[:, 3:5] - seen.value).max() < 1e-9
    turned = made.read(at.x, rotation.exp(np.tile([1e-4, -2e-4, 0.0], (30, 1))), np.arange(30), 0).value[:, 3:5] - flat
    assert np.abs(turned - [1e-4, -2e-4]).max() < 1e-5  # turned by 2°, so to 4 %
