"""The sphere that contains a share of a normal deviate, against exact quantiles and Monte Carlo."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from pcalib.uncertainty import radius


@pytest.mark.parametrize("equal", [1, 2, 3])
def test_it_is_exact_where_the_eigenvalues_that_are_not_zero_are_equal(equal):
    covariance = 4e-12 * np.diag([1.0] * equal + [0.0] * (3 - equal))
    assert radius.containing(covariance) == pytest.approx(2e-6 * np.sqrt(chi2.ppf(0.95, equal)), rel=1e-9)
    assert radius.within(covariance, radius.containing(covariance)) == pytest.approx(0.95, abs=1e-9)


@pytest.mark.parametrize("sizes", [(1, 0.5, 0.1), (1, 1, 0.3), (1, 0.2, 0.2), (1, 0.7, 0.0)])
def test_it_agrees_with_monte_carlo_to_half_a_percent(sizes):
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    half = 1e-5 * turn * np.array(sizes)
    drawn = np.linalg.norm(rng.standard_normal((400_000, 3)) @ half.T, axis=1)
    assert radius.containing(half @ half.T) == pytest.approx(np.quantile(drawn, 0.95), rel=7e-3)
    assert radius.within(half @ half.T, np.quantile(drawn, 0.8)) == pytest.approx(0.8, abs=7e-3)


def test_a_pooled_radius_contains_its_share_of_a_mixture():
    covariances = np.stack([np.eye(3), 9 * np.eye(3)]) * 1e-12
    found = radius.pooled(covariances)
    assert np.mean(chi2.cdf(found**2 / np.array([1e-12, 9e-12]), 3)) == pytest.approx(0.95, abs=1e-4)


def test_no_doubt_has_no_radius():
    assert radius.containing(np.zeros((2, 3, 3))).tolist() == [0, 0]
    assert radius.within(np.zeros((3, 3)), 1e-9) == 1
    assert radius.containing(np.diag([1.0, 0, 0])) == pytest.approx(norm.ppf(0.975), rel=1e-9)
