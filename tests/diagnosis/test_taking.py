"""Of a large file rows are looked at that stand for all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcalib.data.measurement import Measurements
from pcalib.data.readings import nothing
from pcalib.diagnosis.problem import problem
from pcalib.diagnosis.taking import EACH, MOST, REPEATED, STRETCH, taken
from pcalib.fitting import trust
from pcalib.fitting.noise_level import CONTRASTS, contrasts
from pcalib.fitting.trust import _Reading
from pcalib.model import Model


def measured(delta, n: int, **more) -> Measurements:
    q = np.random.default_rng(0).uniform(-0.3, 0.3, (n, 3))
    return Measurements.create(delta, more.pop("q", q), np.zeros((n, 3)), **more)


def test_small_files_are_taken_whole(delta):
    assert (taken(measured(delta, 300)) == np.arange(300)).all()


def test_of_a_large_file_stretches_spread_over_it(delta):
    rows = taken(measured(delta, 30_000))
    assert 0.9 * MOST < len(rows) <= MOST and (np.diff(rows) > 0).all()
    assert rows[0] == 0 and rows[-1] == 29_999 and np.diff(rows).max() <= 2 * 30_000 / MOST * 2
    assert np.mean(np.diff(rows) == 1) > 0.6
    ends = np.r_[0, np.flatnonzero(np.diff(rows) > 1) + 1, len(rows)]
    assert np.sum(np.diff(ends) >= STRETCH) >= 0.35 * MOST / STRETCH


def test_what_is_rare_is_among_them(delta):
    payload = np.zeros(30_000)
    payload[17_000:17_400] = 2.0
    rows = taken(measured(delta, 30_000, payload=payload))
    assert (payload[rows] > 0).sum() >= EACH


def test_stations_that_are_rare_are_among_them(delta):
    data = measured(delta, 30_000)
    readings = nothing(30_000)
    sensor, to = readings.sensor.astype(object), readings.to.astype(object)
    mine = np.arange(1, 30_000, 2000)
    sensor[mine], to[mine] = "distance", "B"
    data = replace(data, readings=replace(readings, sensor=sensor.astype(str), to=to.astype(str)))
    assert np.isin(mine, taken(data)).all()


def test_replicates_come_with_each_other(delta):
    """Every pose twice, the second time at the end: rows by themselves would show no noise."""
    half = np.random.default_rng(0).uniform(-0.3, 0.3, (15_000, 3))
    rows = taken(measured(delta, 30_000, q=np.tile(half, (2, 1)), pose_id=np.tile(np.arange(15_000), 2)))
    both = np.intersect1d(rows[rows < 15_000], rows[rows >= 15_000] - 15_000)
    assert len(both) >= REPEATED and len(rows) <= MOST + 2 * REPEATED


def test_few_readings_of_each_pose_are_taken_where_there_are_many(delta):
    q = np.repeat(np.random.default_rng(0).uniform(-0.3, 0.3, (600, 3)), 50, axis=0)
    data = measured(delta, 30_000, q=q, pose_id=np.repeat(np.arange(600), 50))
    some = data.take(taken(data))
    assert len(np.unique(some.pose_id)) > 550
    V = contrasts(some, some.mask, np.zeros((*some.mask.shape, 0)))
    assert V.shape[-1] <= 3 * CONTRASTS
    flat = V.reshape(-1, V.shape[-1])
    assert np.allclose(flat.T @ flat, np.eye(V.shape[-1]), atol=1e-12)


def test_what_was_set_aside_is_known_by_its_row(delta):
    """Rows of the file, where held-out rows lie between those that were fitted."""
    from pcalib.mechanics import kinematics

    n, rng = 60, np.random.default_rng(1)
    q = rng.uniform(-0.3, 0.3, (n, 3))
    x = kinematics.forward(delta.mechanism, delta.mechanism.nominal, q).pose.x + 2e-5 * rng.standard_normal((n, 3))
    check = np.arange(n) % 3 == 0
    x[31] += 0.05
    data = Measurements.create(delta, q, x, check=check, sigma_pos=2e-5)
    made = problem(Model.nominal(delta), data)
    assert list(made.rows[made.set_aside]) == [31] and made.of == len(made.given) == 40


@pytest.mark.parametrize("rows", [3, 50])
def test_readings_of_many_rows_say_what_their_normal_matrix_says(rows):
    """The Kalman update against the inverse of the sum of informations."""
    rng = np.random.default_rng(2)
    A, H = rng.standard_normal((6, 6)), rng.standard_normal((rows, 6))
    P, d = A @ A.T + np.eye(6), rng.standard_normal(6)
    expected = d @ np.linalg.inv(np.linalg.inv(P) + H.T @ H / 0.3**2) @ d
    assert trust._after(P, d, _Reading("", H, 0.3)) ** 2 == pytest.approx(expected, rel=1e-9)
