"""Printer configuration: exact where a three-arm firmware holds the geometry, an honest loss where it does not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import effects, firmware, prediction, wording
from pcalib import robot as robots
from pcalib.errors import InputError
from pcalib.mechanics import kinematics
from pcalib.model import FittedEffect, Frame, Model
from pcalib.prediction import Conditions

MODELS = Path(__file__).parents[1] / "models"
ROBOT = robots.load(MODELS / "linear_delta.toml")
MECHANISM = ROBOT.mechanism
ARMS = firmware.ThreeArms(
    radius=0.171, rod=np.array([0.340, 0.3405, 0.3397]), angle=np.radians([209.7, 330.4, 90.1]),
    homed=np.array([0.660, 0.661, 0.6595]), scale=np.array([1.0, 1.001, 0.999]), q_home=0.66,
)  # fmt: skip


def printer(arms):
    """Raw parameters of the printer that a three-arm firmware describes exactly."""
    values = {}
    for i in range(3):
        # Both anchors of a tower turn with it: the rods of a pair stay parallel and the towers upright.
        turn = np.array([np.cos(arms.angle[i]), np.sin(arms.angle[i])])
        side = 0.025 * np.array([turn[1], -turn[0], 0.0])
        values[f"s{i + 1}"] = arms.scale[i]
        for sign, j in ((-1, 1), (1, 2)):
            values[f"l{i + 1}{j}"] = arms.rod[i]
            for c, axis in enumerate("xyz"):
                values[f"a{i + 1}{j}.{axis}"] = sign * side[c]
                values[f"b{i + 1}{j}.{axis}"] = sign * side[c] + (0.03 * turn[c] if c < 2 else 0.0)
        for c, axis in enumerate("xy"):
            values[f"p{i + 1}.{axis}"] = (arms.radius + 0.03) * turn[c]
        values[f"p{i + 1}.z"] = arms.homed[i] - arms.scale[i] * arms.q_home
    return np.array([values.get(name, k) for name, k in zip(MECHANISM.parameters, MECHANISM.nominal, strict=True)])


def commands(n=200):
    return np.random.default_rng(0).uniform(0.45, 0.6, (n, 3))


def test_the_nozzle_is_where_three_rods_meet():
    q = commands()
    p = ARMS.nozzle(q)
    for i in range(3):
        tower = np.array([ARMS.radius * np.cos(ARMS.angle[i]), ARMS.radius * np.sin(ARMS.angle[i])])
        z = ARMS.homed[i] - ARMS.scale[i] * (ARMS.q_home - q[:, i])
        length = np.sqrt(np.sum((p[:, :2] - tower) ** 2, axis=1) + (p[:, 2] - z) ** 2)
        assert np.abs(length - ARMS.rod[i]).max() < 1e-12
        assert (p[:, 2] < z).all()


def test_the_endstop_is_the_nozzles_height_in_the_middle():
    same = replace(ARMS, homed=np.full(3, 0.66), rod=np.full(3, 0.34), scale=np.ones(3))
    z = same.nozzle(np.full((1, 3), same.q_home))[0]
    assert same.endstop == pytest.approx(z[2], abs=1e-12) and np.abs(z[:2]).max() < 1e-3


def test_values_come_back_exactly_where_the_firmware_holds_the_geometry():
    model = Model(ROBOT, printer(ARMS), "complete")
    q = commands()
    assert np.abs(kinematics.forward(MECHANISM, model.k, q).pose.x - ARMS.nozzle(q)).max() < 1e-12
    found = firmware.configuration(replace_joint_max(model))
    assert found.arms.radius == pytest.approx(ARMS.radius, abs=1e-10)
    assert found.arms.rod == pytest.approx(ARMS.rod, abs=1e-10)
    assert found.arms.angle == pytest.approx(ARMS.angle, abs=1e-10)
    assert found.arms.endstop == pytest.approx(ARMS.endstop, abs=1e-10)
    assert found.largest < 1e-11 and found.tilt < 1e-7
    assert "nothing of it is lost" in found.statement()


def replace_joint_max(model):
    return replace(model, robot=replace(model.robot, joint_max=ARMS.q_home))


def test_the_text_of_both_firmwares():
    found = firmware.configuration(replace_joint_max(Model(ROBOT, printer(ARMS), "complete")))
    said = found.klipper()
    assert "delta_radius: 171.0000\n" in said and "[stepper_b]\n" in said and "angle: 330.4000\n" in said
    assert "arm_length: 340.5000\n" in said and f"position_endstop: {ARMS.endstop[0] * 1e3:.4f}\n" in said
    assert "rotation_distance: the present value times 1.0010000" in said
    said = found.rrf()
    mean = ARMS.endstop.mean()
    height = f"H{mean * 1e3:.4f}"
    assert said.startswith(f"M665 L340.0000:340.5000:339.7000 R171.0000 {height} B140.0 X-0.3000 Y0.4000 Z0.1000")
    assert f"M666 X{(ARMS.endstop[0] - mean) * 1e3:.4f} " in said
    assert "M92 Y: the present value divided by 1.001" in said


def test_what_is_lost_is_what_separates_the_models():
    """Unequal rods of one pair: the plate tilts, which no three-arm model can hold."""
    k = printer(ARMS)
    k[MECHANISM.index("l11")] += 0.3e-3
    k[MECHANISM.index("beta2.x")] += 2e-3
    model = replace_joint_max(Model(ROBOT, k, "complete"))
    found = firmware.configuration(model)
    q = kinematics.inverse(MECHANISM, MECHANISM.nominal, firmware._grid(ROBOT)).q
    q = q[((q >= ROBOT.joint_min) & (q <= ARMS.q_home)).all(axis=1)]
    pose = kinematics.forward(MECHANISM, k, q).pose
    miss = np.linalg.norm(found.arms.nozzle(q) - pose.x, axis=1)
    assert found.rms == pytest.approx(np.sqrt(np.mean(miss**2))) and found.largest == pytest.approx(miss.max())
    assert found.rms > 1e-5
    assert found.tilt > 1e-3 and "it loses" in found.statement() and "no tilt of the plate" in found.statement()
    far = replace(found, rms=2.5e-3, largest=4e-3, rms_z=5e-5, tilt=0.03).statement()
    assert "it loses 2.50 mm RMS (4.00 mm at most, 50.0 µm RMS in height)" in far and "by 1.50 mm." in far
    for name in ("radius", "rod", "angle", "homed"):  # the values are a minimum
        for step in (-2e-5, 2e-5):
            other = replace(found.arms, **{name: getattr(found.arms, name) + step})
            assert np.mean(np.sum((other.nozzle(q) - pose.x) ** 2, axis=1)) > np.mean(miss**2)


def with_effects(model, **theta):
    """A model with effects of the library, one number each."""
    found = [effects.get(name, robot=model.robot) for name in theta]
    return replace(
        model, effects=tuple(FittedEffect(e, np.full(len(e.parameters), theta[e.name]), e.name) for e in found)
    )


def test_a_gear_ratio_goes_into_the_scale():
    """A firmware holds it whole: only the frame and the instrument's scale, which move no nozzle, are left out."""
    plain = replace_joint_max(Model(ROBOT, printer(ARMS), "complete"))
    model = with_effects(replace(plain, frame=Frame(translation=np.ones(3))), gear_ratio=2e-3, tracker_scale=1e-3)
    found = firmware.configuration(model)
    assert found.arms.scale == pytest.approx(1.002 * ARMS.scale, abs=1e-9)
    assert found.largest < 1e-9 and found.unknown == {} and found.effects == ("gear_ratio", "tracker_scale")
    q = commands()
    there = prediction.predict(with_effects(plain, gear_ratio=2e-3), q, Conditions.of(len(q))).position
    assert np.abs(there - found.arms.nozzle(q)).max() < 1e-9
    assert np.linalg.norm(there - ARMS.nozzle(q), axis=1).max() > 5e-4
    assert "Level complete with gear_ratio, tracker_scale has no more than that" in found.statement()
    assert "rotation_distance: the present value times 1.0020000" in found.klipper()


def test_what_effects_leave_is_in_the_loss():
    """Springs under the robot's own weight: of what they do the best three arms hold a part."""
    plain = replace_joint_max(Model(ROBOT, printer(ARMS), "complete"))
    model = with_effects(plain, drive_compliance=2e-5)
    found = firmware.configuration(model)
    q = commands()
    sag, loaded = (
        prediction.predict(model, q, Conditions(np.zeros((len(q), 3)), np.full(len(q), kg))).position for kg in (0, 1)
    )
    miss = np.linalg.norm(found.arms.nozzle(q) - sag, axis=1)
    assert 1e-7 < found.rms < 0.2 * np.linalg.norm(ARMS.nozzle(q) - sag, axis=1).max()
    assert miss.max() < 1.5 * found.largest
    assert list(found.unknown) == ["1 kg of payload"]
    assert found.unknown["1 kg of payload"] == pytest.approx(np.linalg.norm(loaded - sag, axis=1).max(), rel=0.3)
    assert "without payload, at 20 °C and at rest" in found.statement() and "1 kg of payload by" in found.statement()
    assert found.json()["unknown"][0]["max_um"] == pytest.approx(1e6 * found.unknown["1 kg of payload"])


@pytest.mark.parametrize(
    ("name", "theta", "condition", "least"),
    [
        ("thermal_rods", 2e-5, "10 °C more", 2e-5 * 10 * 0.34),
        ("base_drift", 1e-4 / 3600, "an hour", 1e-4),
        ("friction_hysteresis", 1e-5, "the direction of motion", 1e-6),
        ("backlash", 1e-4, "the direction of motion", 5e-5),
    ],
)
def test_conditions_that_a_firmware_does_not_know_are_said_in_figures(name, theta, condition, least):
    plain = replace_joint_max(Model(ROBOT, printer(ARMS), "complete"))
    found = firmware.configuration(with_effects(plain, **{name: theta}))
    assert least < found.unknown[condition] < 100 * least
    size = wording.size(found.unknown[condition])
    assert f"{condition} by {size}" in found.statement()
    assert "not looked for" not in found.statement()


def test_other_kinds_and_other_towers_are_refused():
    delta = robots.load(MODELS / "delta.toml")
    with pytest.raises(InputError, match="of kind delta"):
        firmware.configuration(Model.nominal(delta))
    text = ROBOT.text.replace("[210.0, 330.0, 90.0]", "[90.0, 210.0, 330.0]")
    found = firmware.configuration(Model.nominal(robots.parse(text)))
    assert "angle: 90.0000" in found.klipper()
    with pytest.raises(InputError, match="210°, 330° and 90°"):
        found.rrf()
