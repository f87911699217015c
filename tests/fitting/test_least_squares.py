"""Steps by triangles: the same as by the rows themselves, with priors, damping and gaps in both."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from pcalib.fitting import least_squares


@pytest.mark.parametrize("n_rows", [40, 6, 3])
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_triangle_says_what_all_rows_say(n_rows, damping):
    rng = np.random.default_rng(0)
    J, y = rng.standard_normal((n_rows, 5)), rng.standard_normal(n_rows)
    prior, pull = np.array([1.0, 0.1, np.inf, 2.0, 0.5]), rng.standard_normal(5)
    precision = 1 / prior**2
    information = J.T @ J + np.diag(precision + damping)
    slope = J.T @ y + pull * precision
    rows = np.column_stack([J, y])
    T = least_squares.triangle(J, y)
    assert T.shape == (min(n_rows, 6), 6)
    np.testing.assert_allclose(T.T @ T, rows.T @ rows, atol=1e-12)
    for given in (rows, T):
        step, R = least_squares.solve(given, pull, prior, damping)
        np.testing.assert_allclose(step, np.linalg.solve(information, slope), atol=1e-12)
        np.testing.assert_allclose(R.T @ R, information, atol=1e-12)
        np.testing.assert_allclose(least_squares.descend(R, slope), step, atol=1e-12)


def test_nothing_to_solve_for():
    rows = least_squares.triangle(np.zeros((4, 0)), np.ones(4))
    step, R = least_squares.solve(rows, np.zeros(0), np.zeros(0))
    assert len(step) == 0 and R.shape == (0, 0) and len(least_squares.descend(R, np.zeros(0))) == 0


@pytest.mark.parametrize("seed", range(20))
def test_bounded_minima_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    n = 1 + seed % 8
    A, y = rng.standard_normal((20, n)) * 10.0 ** rng.uniform(-3, 3, n), rng.standard_normal(20)
    x = np.linalg.lstsq(A, y, rcond=None)[0]
    low, high = x - np.abs(x) * rng.uniform(-1, 1, n), x + np.abs(x) * rng.uniform(1, 2, n)
    high[rng.random(n) < 0.2] = np.inf
    found = least_squares.bounded(A, y, low, high)
    assert np.all((low <= found) & (found <= high))
    expected = lsq_linear(A, y, (low, high), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(A @ found, A @ expected, atol=1e-9)


def test_bounds_at_one_value_and_columns_that_are_alike():
    A = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = least_squares.bounded(A, np.array([3.0, 5.0]), np.array([0.0, 0.0, 2.0]), np.array([1.0, 1.0, 2.0]))
    np.testing.assert_allclose(found, [1.0, 1.0, 2.0])
