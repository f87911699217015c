"""D-optimal plans are made with the instrument that measures."""

from __future__ import annotations

import numpy as np
import pytest

from bench.instrument import MEASURED, Instrument
from bench.jobs import optimal
from pcalib import planning

ROT = np.radians(0.005)


def planned(delta, **settings) -> np.ndarray:
    return optimal.make(delta, Instrument(sigma_rot=ROT, **settings), 12, candidates=80, seed=2).commands.q


@pytest.mark.parametrize("kind", ["position", "probe"])
def test_a_plan_is_for_what_the_instrument_sees(delta, kind):
    """No plan of a kind that sees other components tells this one more."""

    def information(q: np.ndarray) -> float:
        sigma = np.r_[np.full(3, 2e-5), np.full(3, ROT)]
        B = planning.information_blocks(delta, q, np.zeros(3), sigma, np.array(MEASURED[kind]))
        B = B.reshape(-1, B.shape[-1])
        return np.linalg.slogdet(np.eye(B.shape[1]) + B.T @ B)[1]

    told = {other: information(planned(delta, sigma_pos=2e-5, kind=other)) for other in MEASURED}
    assert all(told[kind] > told[other] for other in MEASURED if MEASURED[other] != MEASURED[kind])


def test_noise_that_grows_with_distance_counts_as_in_the_middle_of_the_workspace(delta):
    far = np.array([0.0, 3.0, -4.8])  # 5 m from there
    with_distance = planned(delta, sigma_pos=3e-5, sigma_distance=8e-5, position=far)
    assert np.array_equal(with_distance, planned(delta, sigma_pos=np.hypot(3e-5, 4e-4)))
    assert not np.array_equal(with_distance, planned(delta, sigma_pos=3e-5))
