"""Misread files are named with the edit that mends them, and errors of manufacture are not taken for them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.jobs import misreadings as trials
from pcalib import planning, robot
from pcalib.data import misreadings, orientation
from pcalib.data.measurement import Measurements
from pcalib.fitting import as_drawn, drawing, mixups
from pcalib.mechanics import kinematics

MODELS = Path(__file__).resolve().parents[2] / "models"
DELTA = robot.load(MODELS / "delta.toml")
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
        found = as_drawn.compare(data, DELTA)
        assert not found.far and 1e-4 < found.rms < as_drawn.LARGE and len(found.unreachable) == 0
        assert found.aligned_rms <= found.rms * (1 + 1e-9)
        judged = mixups.judge(data, DELTA, always=True)
        assert not (judged.readings or judged.numbers or judged.frame or judged.far)
        assert mixups.sentence(judged, found) == ""
    assert as_drawn.compare(tracker, DELTA).rms == pytest.approx(as_drawn.compare(base, DELTA).aligned_rms, rel=1e-9)


def test_rotations_that_are_all_zero_are_in_no_other_unit():
    """Some programs write 0 where nothing was measured; that is the same in degrees and in radians."""
    rng = np.random.default_rng(4)
    q = planning.reachable(DELTA, 60, rng).q
    seen = kinematics.forward(DELTA.mechanism, DELTA.mechanism.nominal, q).pose.x
    seen = seen + 2e-5 * rng.standard_normal(seen.shape)
    data = Measurements.create(DELTA, q, seen, np.tile(np.eye(3), (60, 1, 1)), sigma_pos=2e-5, sigma_rot=6e-5)
    judged = mixups.judge(data, DELTA)
    assert not any("radian" in words for _, words, _ in judged.readings), judged.readings


@pytest.mark.parametrize("kind", trials.KINDS)
def test_every_way_to_misread_has_an_inverse(kind):
    """What an entry spoils it mends again, to rounding."""
    loaded = robot.load(MODELS / f"{kind}.toml")
    data = trials.right_file(loaded, np.random.default_rng(0))
    for entry in misreadings.table(data, loaded):
        back, drawn = entry.mend(*entry.spoil(data, loaded))
        if entry.code == "position_not_tcp":  # the same readings, told without the tool
            there = back.position + (back.rotation @ data.tool[..., None])[..., 0]
            back = replace(back, position=there, tool=data.tool)
        for name in ("q", "position", "rotation"):
            np.testing.assert_allclose(getattr(back, name), getattr(data, name), atol=1e-9, err_msg=entry.words)
        np.testing.assert_array_equal(back.mask, data.mask)
        np.testing.assert_allclose(back.tool, data.tool, atol=1e-12)
        for key, value in loaded.dimensions.items():
            np.testing.assert_allclose(drawn.dimensions[key], value, err_msg=entry.words)
    words = [entry.words for entry in misreadings.table(data, loaded)]
    assert len(set(words)) == len(words)


@pytest.mark.parametrize("kind", trials.KINDS)
def test_misread_files_are_named(kind):
    """A sample; all of them by scripts/misreadings."""
    found = [t for t in trials.misread(kind, seed=2, every=40) if t.visible]
    assert len(found) >= 2
    assert [t.entry.words for t in found if not t.named] == []


def test_dimensions_that_differ_little_are_named_where_they_are_exchanged():
    """An h4 has a base radius of 150 and a base spacing of 160 mm: exchanged, noise is a quarter of what is wrong."""
    for seed in range(3):
        h4 = robot.load(MODELS / "h4.toml")
        data = trials.right_file(h4, np.random.default_rng([seed, 7]))
        entry = next(e for e in misreadings.table(data, h4) if e.code == "dimensions_exchanged")
        assert "base radius and base spacing" in entry.words
        written, drawn = entry.spoil(data, h4)
        found = mixups.judge(written, drawn)
        assert [words for _, words, _ in found.readings] == [entry.words]


def test_right_files_are_not():
    assert list(trials.false_alarms(70, seed=3, tried=35)) == []


def test_a_frame_that_is_not_aligned_is_no_swap(base):
    turned = Rotation.from_rotvec([0, 0, 0.4]).apply(base.position) + [0.05, 0.02, 0]
    data = replace(base, position=turned)
    found = as_drawn.compare(data, DELTA)
    assert found.rms > 0.02 and found.aligned_rms < 0.1 * found.rms
    judged = mixups.judge(data, DELTA)
    assert judged.frame and judged.readings == () and "frame = tracker" in mixups.remedy(judged)


def test_a_few_wrong_rows_are_no_swap(base):
    position = base.position.copy()
    position[:3] += 0.3
    data = replace(base, position=position)
    found = as_drawn.compare(data, DELTA)
    assert set(found.rows[found.error > 0.1]) == {0, 1, 2}
    judged = mixups.judge(data, DELTA)
    assert not judged.tried and judged.readings == ()


def test_too_little_to_say(base):
    assert np.isnan(as_drawn.compare(base.take(slice(0, 3)), DELTA).rms)
    blank = replace(base, position=np.full((30, 3), np.nan), mask=np.zeros((30, 6), bool))
    assert np.isnan(as_drawn.compare(blank, DELTA).rms)
    assert mixups.judge(blank, DELTA) == mixups.Judgement(None)


@pytest.mark.parametrize("seed", [29, 30, 49])
def test_a_robot_built_badly_turns_its_plate_and_is_not_taken_for_a_mix_up(base, seed):
    """Parts off by 2 mm and half a degree turn these plates by 4° to 5°, and move them by less than 5 mm."""
    units = np.array(DELTA.mechanism.units)
    size = np.where(units == "rad", np.radians(0.5), 2e-3)
    k = DELTA.mechanism.nominal + size * np.random.default_rng(seed).standard_normal(len(size))
    pose = kinematics.forward(DELTA.mechanism, k, base.q).pose
    data = replace(base, position=pose.x, tool=0 * base.tool, rotation=pose.R, mask=np.ones((len(base), 6), bool))
    assert as_drawn.compare(data, DELTA).far and mixups.judge(data, DELTA, always=True).readings == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: replace(d, q=d.q + np.radians([0, -2.0, 0])), r"the zero of motor q2 is off by \+[12]\.[09]\d°"),
        (lambda d: replace(d, q=d.q * [1, 1, 1 / 1.06]), r"motor q3 moves 1\.06\d* times as far as commanded"),
    ],
    ids=["zero", "scale"],
)
def test_one_number_that_is_far_from_the_drawing_is_said_in_words(base, change, said):
    judged = mixups.judge(change(base), DELTA)
    assert judged.far and any(re.fullmatch(said, words) for _, words, *_ in judged.numbers)


def test_the_robot_file_of_another_robot_is_named(base):
    other = replace(DELTA, dimensions={**DELTA.dimensions, "arm_length": 0.5})
    judged = mixups.judge(base, other)
    assert judged.codes == {"dimension"} and judged.numbers[0][1].startswith("arm length is 149.8")


def test_numbers_are_searched_for_to_the_noise(base):
    """The search is least squares over geometry and the numbers: where the data leave no doubt it finds them."""
    found = drawing.search(
        base, DELTA, ("rad",), lambda d, r, a: (replace(d, q=d.q + np.radians([3.0, 0, 0]) + a[0] * np.eye(3)[0]), r)
    )
    assert found is not None and np.degrees(found[0]) == pytest.approx(-3.0, abs=0.15)


def tracked(base: Measurements, order: str, soft: float = 0.0) -> Measurements:
    """The same poses with a body 35° off the plate's axes, as Euler angles; drives give way by `soft` [rad] at 2 kg."""
    rng = np.random.default_rng(8)
    q = base.q + soft * rng.integers(0, 2, (len(base), 1))
    units = np.array(DELTA.mechanism.units)
    k = DELTA.mechanism.nominal + np.where(units == "rad", 2e-3, 5e-4) * np.random.default_rng(3).standard_normal(60)
    pose = kinematics.forward(DELTA.mechanism, k, q).pose
    turn, body = REGISTRATION.as_matrix(), Rotation.from_rotvec([0.1, -0.2, 0.57]).as_matrix()
    x = pose.tcp(base.tool) @ turn.T + [3, 1, 0.5] + 2e-5 * rng.standard_normal((len(q), 3))
    R = turn @ pose.R @ body @ Rotation.from_rotvec(6e-5 * rng.standard_normal((len(q), 3))).as_matrix()
    data = Measurements.create(DELTA, base.q, x, R, tool=base.tool, sigma_pos=2e-5, sigma_rot=6e-5, frame="tracker")
    return replace(data, written=orientation.to_euler(order, R), euler=order)


@pytest.mark.parametrize("declared", ["zyx", "zxz", ""])
def test_large_rotations_in_another_order_are_named_although_the_data_look_near(base, declared):
    """A tracked body's own turn is an unknown of the fit, and takes up most of a wrong order of angles."""
    right = tracked(base, "xyz")
    v = right.written
    assert v is not None and not mixups.judge(right, DELTA).readings
    R = orientation.from_euler(declared, v) if declared else Rotation.from_rotvec(v).as_matrix()
    found = mixups.judge(replace(right, rotation=R, euler=declared), DELTA)
    assert any("write '# euler = xyz'" in edit for *_, edit in found.readings) and found.absurd


def test_what_drives_give_way_is_no_other_order_of_rotations(base):
    right = tracked(base, "xyz", soft=5e-4)
    distance = drawing.distance(right, DELTA)
    assert distance is not None and distance.misfit > 1.5**2 * distance.readings
    assert not mixups.judge(right, DELTA).readings


def test_readings_that_explain_data_alike_are_all_told_one_of_each_kind_first(base):
    """A mirrored axis of the tracker and two exchanged motors look the same on a robot of three equal arms."""
    right = tracked(base, "xyz")
    mirrored = replace(right, position=right.position * [1, -1, 1], rotation=np.full_like(right.rotation, np.nan))
    mirrored = replace(mirrored, mask=mirrored.mask & (np.arange(6) < 3), written=None, euler="")
    found = mixups.judge(mirrored, DELTA)
    said = mixups.sentence(found, as_drawn.compare(mirrored, DELTA))
    assert "left-handed" in said and "is what stands in" in said and "cannot tell which" in said
