"""Pose accuracy and repeatability against hand-computed numbers."""

import numpy as np
import pytest

from bench.jobs import iso9283
from pcalib import rotation


def test_by_hand():
    """Four cycles at 0, 2, 2, 0 µm on each side: barycentre at 1, all 1 µm from it, so that S_l = 0 and RP = 1."""
    wanted = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    attained = np.zeros((4, 2, 3))
    attained[:, 0, 0] = [0, 2e-6, 2e-6, 0]
    # Second pose: off by (3, 4, 0) µm on average; distances from the barycentre 1, 1, 3, 3 along x.
    attained[:, 1] = wanted[1] + [3e-6, 4e-6, 0]
    attained[:, 1, 0] += [1e-6, -1e-6, 3e-6, -3e-6]
    found = iso9283.accuracy(attained, wanted)
    assert found.ap == pytest.approx([1e-6, 5e-6])
    # l = 1, 1, 3, 3: mean 2, S² = (1 + 1 + 1 + 1)/3
    assert found.rp == pytest.approx([1e-6, 2e-6 + 3 * np.sqrt(4 / 3) * 1e-6])
    squares = [0, 4, 4, 0] + [(3 + d) ** 2 + 16 for d in (1, -1, 3, -3)]
    assert found.rms == pytest.approx(np.sqrt(np.mean(squares)) * 1e-6)
    assert found.max == pytest.approx(np.sqrt(52) * 1e-6)


def test_what_was_not_attained_is_left_out():
    wanted = np.zeros((3, 3))
    attained = np.full((2, 3, 3), np.nan)
    attained[:, 0] = [[1e-3, 0, 0], [3e-3, 0, 0]]
    attained[0, 1] = [0, 2e-3, 0]
    found = iso9283.accuracy(attained, wanted)
    assert found.ap[:2] == pytest.approx([2e-3, 2e-3]) and np.isnan(found.ap[2])
    assert found.rp[:2] == pytest.approx([1e-3, 0.0]) and np.isnan(found.rp[2])
    assert found.rms == pytest.approx(np.sqrt((1 + 9 + 4) / 3) * 1e-3)


def test_one_cycle_has_no_spread():
    found = iso9283.accuracy(np.ones((1, 2, 3)), np.zeros((2, 3)))
    assert found.rp == pytest.approx([0, 0]) and found.ap == pytest.approx(np.sqrt(3) * np.ones(2))


def test_repeatability_of_normal_noise():
    """Maxwell distributed distances: mean 1.596σ, standard deviation 0.673σ, so RP → 3.616σ."""
    attained = 1e-5 * np.random.default_rng(0).standard_normal((20000, 1, 3))
    assert iso9283.accuracy(attained, np.zeros((1, 3))).rp == pytest.approx([3.616e-5], rel=0.01)


def test_a_rigid_motion_is_taken_out_and_nothing_else():
    rng = np.random.default_rng(2)
    wanted = rng.uniform(-0.3, 0.3, (20, 3))
    motion = rotation.exp(np.array([0.01, -0.02, 0.4]))
    moved = wanted @ motion.T + [1.0, 2.0, 3.0]
    assert iso9283.align(moved[None], wanted)[0] == pytest.approx(wanted, abs=1e-12)
    mirrored = wanted * [1, 1, -1]
    assert np.abs(iso9283.align(mirrored[None], wanted)[0] - wanted).max() > 0.1
    grown = 1.01 * wanted
    left = iso9283.align(grown[None], wanted)[0] - wanted
    assert left == pytest.approx(0.01 * (wanted - wanted.mean(0)), abs=1e-12)
    with pytest.raises(ValueError, match="three poses"):
        iso9283.align(np.full((1, 20, 3), np.nan), wanted)
