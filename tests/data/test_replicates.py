"""Replicates: which rows count, and the noise they show, against the noise that was put in."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import robot, rotation
from pcalib.data import replicates
from pcalib.data.measurement import Measurements

DELTA = robot.load(Path(__file__).resolve().parents[2] / "models" / "delta.toml")


def data(n=40, times=2, seed=0, pos=2e-5, rot=6e-5, **more):
    rng = np.random.default_rng(seed)
    q = np.repeat(rng.uniform(-1, 0.5, (n, 3)), times, axis=0)
    x = np.repeat(rng.normal(0, 0.1, (n, 3)), times, axis=0) + pos * rng.standard_normal((n * times, 3))
    R = np.repeat(rotation.exp(rng.normal(0, 0.1, (n, 3))), times, axis=0)
    R = rotation.exp(rot * rng.standard_normal((n * times, 3))) @ R
    ids = np.repeat(np.arange(n), times)
    return Measurements.create(DELTA, q, x, R, pose_id=ids, sigma_pos=2e-5, sigma_rot=6e-5, **more)


def test_noise_is_what_was_put_in():
    found = [replicates.noise(data(seed=seed)) for seed in range(200)]
    assert all((n.groups, n.rows, n.dof_pos, n.dof_rot) == (40, 80, 120, 120) for n in found)
    # The variance of a pooled variance is 2/dof: the mean of 200 of them is good to 0.9 %.
    assert np.mean([n.ratio_pos**2 for n in found]) == pytest.approx(1, abs=0.03)
    assert np.mean([n.ratio_rot**2 for n in found]) == pytest.approx(1, abs=0.03)
    assert np.std([n.ratio_pos**2 for n in found]) == pytest.approx(np.sqrt(2 / 120), rel=0.2)
    assert found[0].sigma_pos == pytest.approx(2e-5, rel=0.25) and found[0].sigma_rot == pytest.approx(6e-5, rel=0.25)


def test_a_noise_twice_the_stated_is_seen_as_such():
    noise = replicates.noise(data(n=200, times=3, pos=4e-5))
    assert noise.dof_pos == 200 * 2 * 3
    assert noise.ratio_pos == pytest.approx(2, rel=0.1) and noise.ratio_rot == pytest.approx(1, rel=0.1)


def test_by_hand():
    q, x = np.zeros((3, 3)), np.array([[0, 0, 0.0], [2e-5, 0, 0], [1e-5, 0, 3e-5]])
    noise = replicates.noise(Measurements.create(DELTA, q, x, pose_id=[5, 5, 5], sigma_pos=1e-5))
    # About the means (1e-5, 0, 1e-5): squares 2e-10 in x, 6e-10 in z, over 6 degrees of freedom.
    assert noise.sigma_pos == pytest.approx(np.sqrt(8e-10 / 6))
    assert noise.dof_pos == 6 and noise.dof_rot == 0 and np.isnan(noise.sigma_rot)


def test_missing_components_count_for_nothing():
    whole = data(n=10)
    position = whole.position.copy()
    position[::2, 0] = np.nan
    turn = whole.rotation.copy()
    turn[1::2] = np.nan
    part = Measurements.create(DELTA, whole.q, position, turn, pose_id=whole.pose_id, sigma_pos=2e-5, sigma_rot=6e-5)
    noise = replicates.noise(part)
    assert noise.dof_pos == 20 and noise.dof_rot == 0


def test_nothing_repeated():
    noise = replicates.noise(data(times=1))
    assert noise.groups == noise.rows == noise.dof_pos == 0 and np.isnan(noise.sigma_pos)
    assert (replicates.groups(replace(data(), pose_id=np.full(80, -1))) == -1).all()


@pytest.mark.parametrize(
    ("change", "counts"),
    [
        ({"q": 1e-7}, True),
        ({"q": 1e-5}, False),
        ({"payload": 0.5}, False),
        ({"tool": 0.01}, False),
        ({"dir2": 2.0}, False),
        ({"temp_rods": 0.3}, True),
        ({"temp_rods": 2.0}, False),
        ({"time": 1000.0}, True),
        ({"humidity": 10.0}, True),
    ],
    ids=str,
)
def test_only_rows_under_the_same_conditions_count(change, counts):
    n = 4
    columns = {"dir2": np.full(n, -1.0), "temp_rods": np.full(n, 20.0), "time": np.zeros(n), "humidity": np.zeros(n)}
    start = Measurements.create(
        DELTA, np.zeros((n, 3)), np.zeros((n, 3)), pose_id=[1, 1, 2, 2], columns=columns, payload=1.0
    )
    np.testing.assert_array_equal(replicates.groups(start), [0, 0, 1, 1])
    (name, by), = change.items()
    if name in columns:
        changed = replace(start, columns=columns | {name: columns[name] + by * np.array([0, 1, 0, 0])})
    else:
        values = getattr(start, name).copy()
        values[1] += by
        changed = replace(start, **{name: values})
    expected = [0, 0, 1, 1] if counts else [-1, -1, 0, 0]
    np.testing.assert_array_equal(replicates.groups(changed), expected)


def test_rows_of_one_id_under_two_conditions_are_two_groups():
    start = data(n=1, times=6)
    two = replace(start, payload=np.array([0, 1, 0, 1, 0, 2.0]))
    np.testing.assert_array_equal(replicates.groups(two), [0, 1, 0, 1, 0, -1])


def test_groups_are_those_of_comparing_every_row_with_every_group():
    """Rows near, at and beyond the slack of a command; the first row of a group is what others are compared with."""
    rng = np.random.default_rng(3)
    q = rng.integers(0, 4, (400, 3)) * 0.1 + rng.choice([0.0, 4e-7, 9e-7, 1.1e-6, 3e-6], (400, 3))
    made = Measurements.create(
        DELTA, q, np.zeros((400, 3)), np.broadcast_to(np.eye(3), (400, 3, 3)), pose_id=np.zeros(400, int),
        columns={"temp_arms": rng.choice([20.0, 20.4, 20.9], 400)}, sigma_pos=2e-5, sigma_rot=6e-5,
    )  # fmt: skip
    firsts: list[int] = []
    number = []
    for row in range(400):
        near = [
            g for g, f in enumerate(firsts)
            if (np.abs(q[f] - q[row]) <= replicates.COMMAND_AGREES).all()
            and abs(made.columns["temp_arms"][f] - made.columns["temp_arms"][row]) <= replicates.TEMPERATURE_AGREES
        ]  # fmt: skip
        firsts += [] if near else [row]
        number.append(near[0] if near else len(firsts) - 1)
    counts = np.bincount(number)
    found = replicates.groups(made)
    for row in range(400):
        alike = np.flatnonzero(np.array(number) == number[row]) if counts[number[row]] > 1 else np.array([], int)
        np.testing.assert_array_equal(np.flatnonzero(found == found[row]) if found[row] >= 0 else [], alike)
