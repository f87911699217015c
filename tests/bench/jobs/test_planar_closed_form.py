"""Closed form, circle intersection and Newton are three ways to one pose; S_C against differences; rank and base."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.jobs.savoure2006 import closed_form as closed
from pcalib import robot as robots
from pcalib.mechanics import kinematics

MECHANISM = robots.load(Path(__file__).parents[3] / "models" / "planar.toml").mechanism
NOMINAL = MECHANISM.nominal
Q = np.radians(np.linspace(-45, 45, 91))
TABLE_2 = np.array([np.radians(0.01), *np.array([1, 0, 3, 0, -2, 0, 1, -1]) * 1e-3])


def by_circles(k, q):
    """x of O_p (N, 2) and α (N,), by intersecting the circle of rod 2 with that of the plate's side."""
    q0, a1x, a2x, a2y, b1x, b2x, b2y, l1, l2 = k
    B1 = np.stack([-a1x + l1 * np.sin(q + q0), -l1 * np.cos(q + q0)], axis=-1)
    A2, side = np.array([a2x, a2y]), np.array([b1x + b2x, b2y])
    gap = A2 - B1
    D = np.linalg.norm(gap, axis=1)
    along = (side @ side - l2**2 + D**2) / (2 * D)
    across = np.sqrt(side @ side - along**2)
    e = gap / D[:, None]
    right = np.stack([e[:, 1], -e[:, 0]], axis=-1)  # the point on the right of B1 → A2 is the open parallelogram
    B2 = B1 + along[:, None] * e + across[:, None] * right
    turned = B2 - B1
    alpha = np.arctan2(turned[:, 1], turned[:, 0]) - np.arctan2(side[1], side[0])
    return B1 + b1x * np.stack([np.cos(alpha), np.sin(alpha)], axis=-1), alpha


perturbed = st.lists(st.floats(-1, 1).filter(lambda e: abs(e) > 0.05), min_size=9, max_size=9).map(
    lambda e: NOMINAL + np.array([0.1, *[5e-3] * 8]) * e
)


@settings(max_examples=60, deadline=None)
@given(k=perturbed)
def test_closed_form_circles_and_newton_agree(k):
    assert k[0] != 0 and k[6] != 0
    pose, newton = closed.forward(k, Q), kinematics.forward(MECHANISM, k, Q[:, None])
    x, alpha = by_circles(k, Q)
    assert newton.ok.all()
    assert np.abs(pose.x[:, :2] - x).max() <= 1e-10
    assert np.abs(closed.plate_angle(k, Q) - alpha).max() <= 1e-10
    assert np.abs(pose.x - newton.pose.x).max() <= 1e-10
    assert np.abs(pose.R - newton.pose.R).max() <= 1e-10


def test_a_loop_that_cannot_close_is_nan():
    k = NOMINAL + np.array([0, 0, 0, 0, 0, 0, 0, 0.2, -0.2])
    assert np.isnan(closed.plate_angle(k, Q)).any()


def perfect(q0, width, rise):
    """A perfect parallelogram whose plate is off centre and inclined: S_C of the paper holds there exactly."""
    return np.array([q0, 0.13, width - 0.13, rise, 0.11, width - 0.11, rise, 0.95, 0.95])


@pytest.mark.parametrize("h", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("k", [NOMINAL, perfect(0.06, 0.26, 0.04)], ids=["nominal", "q0, b2y, off centre"])
def test_sensitivity_against_differences(k, h):
    S, tool = closed.sensitivity(k, Q, h), np.array([0.0, -h, 0.0])
    assert np.abs(closed.plate_angle(k, Q)).max() < 1e-12

    def reading(k):
        return np.column_stack([closed.forward(k, Q).tcp(tool)[:, :2], closed.plate_angle(k, Q)])

    for j in range(9):
        step = np.eye(9)[j]
        slope = sum(c * (reading(k + n * 1e-4 * step) - reading(k - n * 1e-4 * step)) for n, c in DIFFERENCE) / 1e-4
        assert np.abs(S[:, :, j] - slope).max() <= 1e-7
    core = kinematics.sensitivity(MECHANISM, k, Q[:, None], closed.forward(k, Q), tool)
    assert np.abs(core - S).max() < 1e-11


DIFFERENCE = [(1, 2 / 3), (2, -1 / 12)]
"""Central differences of fourth order."""


def test_simplified_model_inverts_and_differentiates():
    x = closed.forward_simplified(Q, 0.03, 0.95)
    assert closed.inverse_simplified(x, 0.03, 0.95) == pytest.approx(Q, abs=1e-13)
    assert np.isnan(closed.inverse_simplified(np.array([0.96]), 0.0, 0.95)).all()
    e = 1e-6
    slope_q0 = (closed.forward_simplified(Q, 0.03 + e, 0.95) - closed.forward_simplified(Q, 0.03 - e, 0.95)) / (2 * e)
    slope_l = (closed.forward_simplified(Q, 0.03, 0.95 + e) - closed.forward_simplified(Q, 0.03, 0.95 - e)) / (2 * e)
    S = closed.sensitivity_simplified(Q, 0.03, 0.95)
    assert S == pytest.approx(np.stack([slope_q0, slope_l], axis=-1), abs=1e-9)
    assert closed.rate_simplified(Q, 0.03, 0.95) == pytest.approx(slope_q0, abs=1e-9)


@pytest.mark.parametrize("h", [0.0, 0.1, 0.2])
def test_rank_is_six_of_nine_and_the_base_is_that_of_73(h):
    S = closed.sensitivity(NOMINAL, np.radians(np.arange(-45, 46, 5.0)), h).reshape(-1, 9)
    s = np.linalg.svd(S, compute_uv=False)
    assert s[5] > 1e-1 and s[6] < 1e-12
    columns = [MECHANISM.index(name) for name in closed.BASE]
    assert np.linalg.matrix_rank(S[:, columns]) == 6
    assert np.abs(S - S[:, columns] @ closed.to_base()).max() < 1e-12


def test_table_2_in_the_base():
    merged = dict(zip(closed.BASE, closed.to_base() @ TABLE_2, strict=True))
    assert merged == pytest.approx(
        {"q0": np.radians(0.01), "a2x": 2e-3, "a2y": 3e-3, "b1x": -1e-3, "l1": 1e-3, "l2": -1e-3}, abs=1e-15
    )
