"""Detection limits: an effect of the stated size is found nine times out of ten."""

from __future__ import annotations

import numpy as np
import pytest

from pcalib.diagnosis import adequacy
from pcalib.diagnosis.screen import Group, Known, Search, screen, smallest_seen, visible_size

M = 100


def made(dof=np.inf, d=1, y=None, trials=1.0):
    rng = np.random.default_rng(0)
    groups = [Group("x", rng.standard_normal((M, d)) * 7, np.ones(d), search=Search(trials))]
    groups += [Group(f"g{i}", rng.standard_normal((M, 3)), np.ones(3)) for i in range(6)]
    y = np.zeros(M) if y is None else y
    return screen(y, np.zeros((M, 0)), groups, Known(np.zeros(M, int), np.array([dof])), n_draws=2000)


def test_known_values():
    """s for 90 % power at p = 2e-3, by Monte Carlo of the noncentral distribution."""
    rng = np.random.default_rng(1)
    for d in (1, 3, 6):
        s = visible_size(made(), d, 2e-3)
        z = rng.standard_normal((40000, d))
        z[:, 0] += s
        found = made().p_value(np.sum(z * z, axis=1), d) < 2e-3
        assert np.mean(found) == pytest.approx(0.9, abs=0.01)


def test_doubt_about_the_noise_costs_power():
    sure, unsure = visible_size(made(), 3, 1e-3), visible_size(made(20.0), 3, 1e-3)
    assert 1.05 * sure < unsure < 2 * sure


@pytest.mark.parametrize("dof", [np.inf, 30.0])
def test_smallest_seen_is_seen_nine_times_in_ten(dof):
    base = made(dof)
    critical = float(np.quantile(adequacy.null_distribution(base), 0.05))
    size = smallest_seen(base, 0, critical)
    rng = np.random.default_rng(3)
    hits = 0
    column = np.random.default_rng(0).standard_normal((M, 1)) * 7
    for _ in range(400):
        level = np.sqrt(rng.chisquare(dof) / dof) if np.isfinite(dof) else 1.0
        y = (column[:, 0] * size[0] + rng.standard_normal(M)) / level
        T = float(np.sum((base.blocks[0].T @ (base.basis.T @ y)) ** 2))
        hits += base.p_value(T, 1) < critical
    assert hits / 400 == pytest.approx(0.9, abs=0.045)


def test_searching_raises_the_limit():
    assert smallest_seen(made(trials=100), 0, 1e-3)[0] > 1.1 * smallest_seen(made(), 0, 1e-3)[0]
