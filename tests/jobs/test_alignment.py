"""A rigid motion between attained and wanted positions."""

import numpy as np
import pytest

from bench.jobs import alignment
from pcalib import rotation


def test_a_rigid_motion_is_taken_out_and_nothing_else():
    rng = np.random.default_rng(2)
    wanted = rng.uniform(-0.3, 0.3, (20, 3))
    motion = rotation.exp(np.array([0.01, -0.02, 0.4]))
    moved = wanted @ motion.T + [1.0, 2.0, 3.0]
    assert alignment.align(moved[None], wanted)[0] == pytest.approx(wanted, abs=1e-12)
    mirrored = wanted * [1, 1, -1]
    assert np.abs(alignment.align(mirrored[None], wanted)[0] - wanted).max() > 0.1
    grown = 1.01 * wanted
    left = alignment.align(grown[None], wanted)[0] - wanted
    assert left == pytest.approx(0.01 * (wanted - wanted.mean(0)), abs=1e-12)
    with pytest.raises(ValueError, match="three poses"):
        alignment.align(np.full((1, 20, 3), np.nan), wanted)
