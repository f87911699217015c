"""Steps by triangles: the same as by the rows themselves, with priors, damping and gaps in both."""

import numpy as np
import pytest

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
