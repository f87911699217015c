"""Every quantity of ISO 9283 against examples worked by hand."""

import numpy as np
import pytest

from pcalib import iso9283

UM = 1e-6


def test_accuracy_and_repeatability_by_hand():
    """Four cycles; distances from the barycentre are 1, 1, 1, 1 µm at the first pose and 1, 1, 3, 3 at the second."""
    wanted = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    attained = np.zeros((4, 2, 3))
    attained[:, 0, 0] = np.array([0, 2, 2, 0]) * UM
    attained[:, 1] = wanted[1] + np.array([3, 4, 0]) * UM
    attained[:, 1, 0] += np.array([1, -1, 3, -3]) * UM
    found = iso9283.pose_figures(attained, wanted)
    assert found.ap == pytest.approx([1 * UM, 5 * UM])
    assert found.axes == pytest.approx(np.array([[1, 0, 0], [3, 4, 0]]) * UM, abs=1e-15)
    assert found.rp == pytest.approx([1 * UM, (2 + 3 * np.sqrt(4 / 3)) * UM])  # l̄ = 2, S² = (1 + 1 + 1 + 1)/3
    squares = [0, 4, 4, 0] + [(3 + d) ** 2 + 16 for d in (1, -1, 3, -3)]
    assert found.rms == pytest.approx(np.sqrt(np.mean(squares)) * UM)
    assert found.max == pytest.approx(np.sqrt(52) * UM)


def test_cycles_that_miss_a_pose_are_left_out():
    attained = np.full((2, 3, 3), np.nan)
    attained[:, 0] = [[1e-3, 0, 0], [3e-3, 0, 0]]
    attained[0, 1] = [0, 2e-3, 0]
    found = iso9283.pose_figures(attained, np.zeros((3, 3)))
    assert found.ap[:2] == pytest.approx([2e-3, 2e-3]) and np.isnan(found.ap[2])
    assert found.rp[:2] == pytest.approx([1e-3, 0.0]) and np.isnan(found.rp[2])
    assert found.cycles.tolist() == [2, 1, 0]


def test_repeatability_of_normal_noise():
    """Distances are Maxwell distributed: mean 1.596σ, standard deviation 0.673σ, so RP tends to 3.616σ."""
    attained = 1e-5 * np.random.default_rng(0).standard_normal((20000, 1, 3))
    assert iso9283.pose_figures(attained, np.zeros((1, 3))).rp == pytest.approx([3.616e-5], rel=0.01)


def test_directional_variation_and_exchangeability_by_hand():
    """Barycentres at 0, (3, 4, 0) and (0, −12, 0) µm: distances 5, 12 and √(9 + 256) = 16.279 µm."""
    paths = [np.zeros((2, 1, 3)) + np.array(x) * UM for x in ([0, 0, 0], [3, 4, 0], [0, -12, 0])]
    paths[1] = paths[1] + np.array([[[1, 0, 0]], [[-1, 0, 0]]]) * UM  # scatter moves no barycentre
    assert iso9283.directional_variation(paths) == pytest.approx([np.sqrt(265) * UM])
    assert iso9283.exchangeability(paths[:2]) == pytest.approx([5 * UM])


def test_distance_by_hand():
    """Commanded 100 mm along x; attained 100.001, 100.003 and 100.002 mm: AD = 2 µm, S = 1 µm, RD = 3 µm."""
    first = np.zeros((3, 3))
    second = np.array([[100.001, 0, 0], [100.003, 0, 0], [100.002, 0, 0]]) * 1e-3
    found = iso9283.distance_figures(first, second, np.array([[0, 0, 0], [0.1, 0, 0]]))
    assert found.ad == pytest.approx(2 * UM) and found.rd == pytest.approx(3 * UM)
    assert found.axes == pytest.approx([2 * UM, 0, 0], abs=1e-15)


def test_drift_by_hand():
    """Thirty cycles in blocks of ten, barycentres 10, 14 and 13 µm off: dAP = 4 µm; RP rises from 0 to 2 µm."""
    attained = np.zeros((30, 1, 3))
    attained[:, 0, 0] = np.repeat([10, 14, 13], 10) * UM
    attained[20:, 0, 1] = np.tile([2, -2], 5) * UM
    ap, rp = iso9283.drift(attained, np.zeros((1, 3)))
    assert ap == pytest.approx([4 * UM]) and rp == pytest.approx([2 * UM])
    assert np.isnan(iso9283.drift(attained[:15], np.zeros((1, 3)))[0]).all()


def test_poses_of_the_cube_by_hand():
    """A cube of 200 mm: the diagonals are 346.4 mm long, and a tenth of that from a corner is 20 mm on every axis."""
    poses = iso9283.cube_poses(0.2, np.array([0.0, 0.0, -0.8]))
    assert poses[0] == pytest.approx([0, 0, -0.8])
    assert poses[1] == pytest.approx([0.08, 0.08, -0.72])
    corner = np.array([0.1, 0.1, -0.7])
    assert np.linalg.norm(poses[1] - corner) == pytest.approx(0.1 * np.sqrt(3) * 0.2)
    edge, centre = iso9283.largest_cube(0.4, -0.925, -0.675)
    assert edge == pytest.approx(0.25) and centre == pytest.approx([0, 0, -0.8])
    assert iso9283.largest_cube(0.1, -1.0, 0.0)[0] == pytest.approx(0.1 * np.sqrt(2))


def test_a_record_computes_what_the_rows_allow():
    rng = np.random.default_rng(1)
    wanted = iso9283.cube_poses(0.2, np.zeros(3))
    pose = np.tile(np.arange(5), 30)
    position = wanted[pose] + 1e-5 * rng.standard_normal((150, 3))
    found = iso9283.record(pose, position, wanted)
    assert found.poses.cycles.tolist() == [30] * 5 and not found.remarks
    assert found.variation is None and found.exchange is None and found.drift is not None
    assert set(found.distances) == {(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)}
    other = iso9283.record(pose[:50], position[:50], wanted, np.repeat(["up", "down"], 25), [(pose, position)])
    assert other.variation is not None and other.exchange is not None
    assert "asks for 30 cycles" in other.remarks[0]


def test_the_scatter_of_the_instrument_is_named():
    wanted, pose = np.zeros((5, 3)), np.tile(np.arange(5), 30)
    position = 1e-5 * np.random.default_rng(1).standard_normal((150, 3))
    found = iso9283.record(pose, position, wanted, sigma=1e-5)
    assert iso9283.MAXWELL == pytest.approx(3.616, abs=1e-3)
    assert "the instrument, which alone makes 36.2 µm" in found.remarks[-1]
    assert not iso9283.record(pose, position, wanted, sigma=1e-6).remarks
