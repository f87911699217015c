"""Swapped columns and mirrored frames are found, and errors of manufacture are not taken for them."""

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcalib import planning, robot
from pcalib.data import mixups
from pcalib.data.measurement import Measurements
from pcalib.mechanics import kinematics

DELTA = robot.load(Path(__file__).resolve().parents[2] / "models" / "delta.toml")
REGISTRATION = Rotation.from_rotvec([0.3, -1.2, 2.0])


@pytest.fixture(scope="module")
def base():
    """30 poses of a robot with errors of half a millimetre."""
    rng = np.random.default_rng(3)
    q = planning.reachable(DELTA, 30, rng).q
    units = np.array(DELTA.mechanism.units)
    k = DELTA.mechanism.nominal + np.where(units == "rad", 2e-3, 5e-4) * rng.standard_normal(60)
    tool = np.array([0.02, 0.0, -0.1])
    return Measurements.create(DELTA, q, kinematics.forward(DELTA.mechanism, k, q).pose.tcp(tool), tool=tool)


@pytest.fixture(scope="module")
def tracker(base):
    return replace(base, position=REGISTRATION.apply(base.position) + [3, 1, 0.5], frame="tracker")


def test_sound_data_raise_no_suspicion(base, tracker):
    for data in (base, tracker):
        found = mixups.compare(data, DELTA)
        assert found.explanations == () and 1e-4 < found.rms < mixups.LARGE and len(found.unreachable) == 0
        assert found.aligned_rms <= found.rms * (1 + 1e-9)
    assert mixups.compare(tracker, DELTA).rms == pytest.approx(mixups.compare(base, DELTA).aligned_rms, rel=1e-9)


@pytest.mark.parametrize("order", [o for o in permutations(range(3)) if o != (0, 1, 2)], ids=str)
def test_swapped_actuators_are_named(base, order):
    found = mixups.compare(replace(base, q=base.q[:, order]), DELTA)
    for j, i in enumerate(order):
        if i != j:  # q_{i+1} was written into column j
            assert any(f"q{i + 1} is what stands in q{j + 1}" in e for e in found.explanations), found.explanations


def test_swapped_and_mirrored_axes_are_named(base):
    swapped = mixups.compare(replace(base, position=base.position[:, [1, 0, 2]]), DELTA)
    assert "x is what stands in y, y is what stands in x" in swapped.explanations
    mirrored = mixups.compare(replace(base, position=base.position * [1, -1, 1]), DELTA)
    assert "y has the wrong sign" in mirrored.explanations


def test_a_left_handed_tracker_is_named(tracker):
    found = mixups.compare(replace(tracker, position=tracker.position * [1, 1, -1]), DELTA)
    assert "the tracker's frame is left-handed" in found.explanations


def test_a_frame_that_is_not_aligned_is_no_swap(base):
    turned = Rotation.from_rotvec([0, 0, 0.4]).apply(base.position) + [0.05, 0.02, 0]
    found = mixups.compare(replace(base, position=turned), DELTA)
    assert found.explanations == () and found.rms > 0.02 and found.aligned_rms < 0.1 * found.rms


def test_a_few_wrong_rows_are_no_swap(base):
    position = base.position.copy()
    position[:3] += 0.3
    found = mixups.compare(replace(base, position=position), DELTA)
    assert found.explanations == () and set(found.rows[found.error > 0.1]) == {0, 1, 2}


def test_too_little_to_say(base):
    assert np.isnan(mixups.compare(base.take(slice(0, 3)), DELTA).rms)
    blank = replace(base, position=np.full((30, 3), np.nan), mask=np.zeros((30, 6), bool))
    assert np.isnan(mixups.compare(blank, DELTA).rms)


def test_radians_in_columns_of_degrees_are_named(base):
    found = mixups.compare(replace(base, q=np.radians(base.q)), DELTA)
    assert found.explanations == ("q1, q2, q3 are in radians, not degrees",)


@pytest.mark.parametrize(
    ("misread", "said"),
    [
        (lambda R: Rotation.from_rotvec(np.degrees(R.as_rotvec())), "the rotation is in degrees, not radians"),
        (lambda R: Rotation.from_euler("x", 50, degrees=True) * R, None),  # another target, and no misreading
        (
            lambda R: Rotation.from_quat(R.as_quat(canonical=True), scalar_first=True),
            "the quaternion's columns are in the order x, y, z, w",
        ),
    ],
    ids=["degrees", "turned", "scalar last"],
)
def test_rotations_read_wrongly_are_named(base, misread, said):
    turned = Rotation.from_rotvec(3e-3 * np.random.default_rng(1).standard_normal((30, 3)))
    mask = np.ones((30, 6), bool)
    sound = replace(base, rotation=turned.as_matrix(), mask=mask)
    # The measured point lies on the tool, and moves with the plate: here it is the plate's centre.
    centre = kinematics.forward(DELTA.mechanism, DELTA.mechanism.nominal, base.q).pose.x
    sound = replace(sound, position=centre, tool=np.zeros((30, 3)))
    assert mixups.compare(sound, DELTA).explanations == ()
    found = mixups.compare(replace(sound, rotation=misread(turned).as_matrix()), DELTA)
    assert found.explanations == ((said,) if said else ())


@pytest.mark.parametrize("seed", [29, 30, 49])
def test_a_robot_built_badly_turns_its_plate_and_is_not_taken_for_a_mix_up(base, seed):
    """Parts off by 2 mm and half a degree turn these plates by 4° to 5°, and move them by less than 5 mm."""
    units = np.array(DELTA.mechanism.units)
    size = np.where(units == "rad", np.radians(0.5), 2e-3)
    k = DELTA.mechanism.nominal + size * np.random.default_rng(seed).standard_normal(len(size))
    pose = kinematics.forward(DELTA.mechanism, k, base.q).pose
    data = replace(base, position=pose.x, tool=0 * base.tool, rotation=pose.R, mask=np.ones((len(base), 6), bool))
    found = mixups.compare(data, DELTA)
    assert found.turn > mixups.LARGE_TURN and found.explanations == ()


def test_a_rotation_of_the_base_in_the_plate_is_named():
    """Where the robot commands the rotation, its inverse is another one."""
    hexapod = robot.load(Path(__file__).resolve().parents[2] / "models" / "hexapod.toml")
    q = planning.reachable(hexapod, 30, np.random.default_rng(0)).q
    pose = kinematics.forward(hexapod.mechanism, hexapod.mechanism.nominal, q).pose
    data = Measurements.create(hexapod, q, pose.x, np.swapaxes(pose.R, 1, 2))
    assert mixups.compare(data, hexapod).explanations == ("the rotation is that of the base seen from the plate",)
    assert mixups.compare(replace(data, rotation=pose.R), hexapod).explanations == ()
