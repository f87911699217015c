"""The arithmetic of a diagnosis against textbook least squares and distributions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from pcalib.diagnosis import adequacy
from pcalib.diagnosis.screen import Group, Known, misfit, outside, project_out, screen, span

M = 150


def arrays(seed=0, n_groups=5, width=3):
    rng = np.random.default_rng(seed)
    nuisance = rng.standard_normal((M, 8)) * 30
    groups = [Group(f"g{i}", rng.standard_normal((M, width)) * 5, np.ones(width)) for i in range(n_groups)]
    return rng, nuisance, groups


def known(classes=None):
    classes = np.zeros(M, int) if classes is None else classes
    return Known(classes, np.full(classes.max() + 1, np.inf))


def rss(columns, y):
    return float(np.sum((y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) ** 2))


def test_gain_of_a_group_is_the_fall_of_the_residual_sum_of_squares():
    rng, nuisance, groups = arrays()
    y = rng.standard_normal(M)
    found = screen(y, nuisance, groups, known(), n_draws=10)
    for g, group in enumerate(groups):
        want = rss(nuisance, y) - rss(np.hstack([nuisance, group.columns]), y)
        np.testing.assert_allclose(np.sum((found.blocks[g].T @ found.y) ** 2), want, rtol=1e-8)
    given = [groups[1].columns, groups[3].columns]
    test = adequacy.p_values(found, (1, 3))
    base = np.hstack([nuisance, *given])
    for g in (0, 2, 4):
        want = rss(base, y) - rss(np.hstack([base, groups[g].columns]), y)
        np.testing.assert_allclose(test.p[g], stats.chi2.sf(want, 3), rtol=1e-6)
    assert test.p[1] == test.p[3] == 1.0


def test_estimate_is_least_squares_with_the_nuisance_free():
    rng, nuisance, groups = arrays()
    theta = np.array([0.3, -0.2, 0.1])
    y = rng.standard_normal(M) + groups[2].columns @ theta + nuisance @ rng.standard_normal(8)
    found = screen(y, nuisance, groups, known(), n_draws=10)
    got, sigma = (a[0] for a in found.estimate((2,)))
    J = np.hstack([groups[2].columns, nuisance])
    np.testing.assert_allclose(got, np.linalg.lstsq(J, y, rcond=None)[0][:3], rtol=1e-7)
    np.testing.assert_allclose(sigma, np.sqrt(np.diag(np.linalg.inv(J.T @ J)))[:3], rtol=1e-7)


def test_kappa_by_hand():
    nuisance = np.eye(M)[:, :2] * 100
    groups = [Group("half", np.eye(M)[:, [0]] * 10 + np.eye(M)[:, [5]] * 10, np.ones(1))]
    found = screen(np.zeros(M), nuisance, groups, known(), n_draws=4)
    assert found.kappa(0) == pytest.approx(np.sqrt(0.5))


def test_what_the_largest_possible_effect_shows_is_visible():
    """An effect may be a hundred times its usual size: what it does then must not count as something else."""
    columns = np.eye(M)[:, :2] * [5.0, 0.01]
    usual = Group("effect", columns, np.ones(2))
    possible = Group("effect", columns, np.ones(2), limit=np.full(2, 400.0))
    y = columns @ [1.0, 300.0]
    for group, seen in ((usual, 1), (possible, 2)):
        found = screen(y, np.zeros((M, 0)), [group], known(), n_draws=4)
        assert found.visible.tolist() == [seen]
        theta, sigma = (a[0] for a in found.estimate((0,)))
        assert theta[0] == pytest.approx(1.0)
        assert sigma[1] == (np.inf if seen == 1 else pytest.approx(100.0))
        assert theta[1] == pytest.approx(0.0 if seen == 1 else 300.0)


def test_what_the_nuisance_absorbs_is_invisible():
    rng, nuisance, groups = arrays()
    hidden = Group("hidden", nuisance[:, :2] @ rng.standard_normal((2, 2)), np.ones(2))
    faint = Group("faint", rng.standard_normal((M, 1)) * 1e-3, np.ones(1))
    found = screen(rng.standard_normal(M), nuisance, [*groups, hidden, faint], known(), n_draws=4)
    assert found.visible.tolist() == [3] * 5 + [0, 0]
    test = adequacy.p_values(found)
    assert test.p[5] == test.p[6] == 1.0
    _, sigma = found.estimate((6,))
    assert np.isinf(sigma[0]).all()


def test_aliases_have_nothing_of_their_own():
    rng, nuisance, groups = arrays()
    twin = Group("twin", groups[0].columns @ rng.standard_normal((3, 3)) + nuisance[:, :3], np.ones(3))
    found = screen(rng.standard_normal(M) * 3, nuisance, [*groups, twin], known(), n_draws=4)
    assert adequacy.p_values(found, (0,)).p[5] == 1.0
    assert adequacy.p_values(found, (5,)).p[0] == 1.0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(1, 5))
def test_outside_is_orthonormal_and_orthogonal(seed, a, b):
    rng = np.random.default_rng(seed)
    Q, block = (np.linalg.qr(rng.standard_normal((20, n)))[0] for n in (a, b))
    block[:, 0] = Q[:, 0]  # one direction shared
    block = np.linalg.qr(block)[0]
    rest = outside(block, Q)
    np.testing.assert_allclose(rest.T @ rest, np.eye(rest.shape[1]), atol=1e-6)
    assert np.abs(Q.T @ rest).max(initial=0) < 1e-6
    both = np.hstack([Q, block])
    assert rest.shape[1] == np.linalg.matrix_rank(both, 1e-6) - a


def test_draws_have_the_covariance_of_white_noise():
    _, nuisance, groups = arrays()
    found = screen(np.zeros(M), nuisance, groups, known(), n_draws=20000)
    np.testing.assert_allclose(np.cov(found.draws.T), np.eye(len(found.y)), atol=0.05)
    assert found.left is not None
    dof = found.left[1]
    assert dof == M - 8 - 15
    np.testing.assert_allclose(found.left_draws.mean(), dof, rtol=0.01)
    np.testing.assert_allclose(found.left_draws.var(), 2 * dof, rtol=0.05)


def test_draws_carry_the_doubt_about_the_noise_level():
    """With ν degrees of freedom per class a draw's T/d follows F(d, ν) within one class."""
    _, nuisance, groups = arrays()
    noise = Known(np.zeros(M, int), np.array([12.0]))
    found = screen(np.zeros(M), nuisance, groups, noise, n_draws=20000)
    T = np.sum((found.draws @ found.blocks[0]) ** 2, axis=1)
    assert stats.kstest(T / 3, stats.f(3, 12).cdf).pvalue > 0.01
    assert found.nu == 12.0
    np.testing.assert_allclose(found.p_value(9.0, 3), stats.f.sf(3.0, 3, 12))


def test_interpolated_p_values_are_near_the_exact_ones():
    _, nuisance, groups = arrays()
    found = screen(np.zeros(M), nuisance, groups, Known(np.zeros(M, int), np.array([30.0])), n_draws=10)
    T = np.random.default_rng(0).chisquare(3, (500, 4)) * 2
    d = np.array([1, 3, 3, 12])
    np.testing.assert_allclose(found.p_of_draws(T, d), found.p_value(T, d), rtol=2e-3)


def test_span_and_projection():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((30, 4)) @ np.diag([1, 1, 1, 1e-6])
    U = span(A, 1e-3)
    assert U.shape == (30, 3)
    assert np.abs(U.T @ project_out(rng.standard_normal((30, 5)), U)).max() < 1e-12


@pytest.mark.parametrize("from_rest", [False, True], ids=["from replicates", "from what is left"])
def test_the_misfit_of_pure_noise_is_uniform(from_rest):
    """Also where the level was read off the same residuals: its directions are not tested against themselves."""
    rng, nuisance, groups = arrays()
    U = np.linalg.qr(np.hstack([nuisance, *(g.columns for g in groups)]))[0]
    nu, p = M - U.shape[1], []
    for _ in range(300):
        y = rng.standard_normal(M)
        rest = project_out(y, U)
        level = np.sqrt((rest @ rest if from_rest else rng.chisquare(nu)) / nu)
        noise = Known(np.zeros(M, int), np.array([float(nu)]))
        scaled = [Group(g.name, g.columns / level, g.scale) for g in groups]
        p.append(misfit(screen(y / level, nuisance / level, scaled, noise, from_rest=from_rest, n_draws=2)).p)
    assert stats.kstest(p, "uniform").pvalue > 0.001


def test_a_level_of_each_class_alone_is_known_less_well():
    classes = np.repeat([0, 1], 9)
    assert Known(classes, np.array([40.0, 60.0])).nu == 100 and Known(classes, np.array([40.0, np.inf])).nu == np.inf
    assert Known(classes, np.array([40.0, 60.0]), pooled=False).nu == 40
    assert Known(classes[:9], np.array([40.0, 12.0]), pooled=False).nu == 40  # a class without readings does not count
