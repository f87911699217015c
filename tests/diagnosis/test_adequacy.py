"""Adequacy sets: false alarms, rivals kept, pairs found, the unlisted left unexplained."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pcalib.diagnosis import adequacy
from pcalib.diagnosis.screen import Group, Known, screen

M = 120
LEVEL = adequacy.AGAINST[0]


def build(seed, theta=None, dof=np.inf, noise=1.0, n_draws=600):
    """Six effects (two nearly aliased), two patterns; the truth is a mixture by name."""
    fixed = np.random.default_rng(12345)
    names = ["a", "b", "c", "d", "e", "alias of a"]
    columns = {n: fixed.standard_normal((M, 1)) for n in names}
    columns["alias of a"] = columns["a"] + 0.1 * fixed.standard_normal((M, 1))
    columns["pattern 1"] = np.hstack([columns["a"], fixed.standard_normal((M, 5))])
    columns["pattern 2"] = fixed.standard_normal((M, 8))
    columns["unlisted"] = columns["pattern 2"] @ fixed.standard_normal((8, 1))
    nuisance = fixed.standard_normal((M, 6)) * 10
    rng = np.random.default_rng(seed)
    y = noise * rng.standard_normal(M) + nuisance @ rng.standard_normal(6)
    U = np.linalg.qr(nuisance)[0]
    for name, s in (theta or {}).items():
        visible = columns[name] - U @ (U.T @ columns[name])
        y = y + s * (columns[name] / np.linalg.norm(visible))[:, 0]
    level = np.sqrt(rng.chisquare(dof) / dof) * noise if np.isfinite(dof) else 1.0
    groups = [Group(n, c / level, np.ones(c.shape[1])) for n, c in columns.items() if n != "unlisted"]
    made = screen(
        y / level, nuisance / level, groups, Known(np.zeros(M, int), np.array([dof])), n_draws=n_draws, seed=seed
    )
    return made


def sets(made, largest=2):
    """The smallest ones."""
    if adequacy.is_adequate(made, ()):
        return {()}
    for size in range(1, largest + 1):
        if found := adequacy.adequate_sets(made, range(6), size, adequacy.AGAINST[size > 1]):
            return {tuple(made.names[g] for g in s) for s in found}
    return set()


def limit(n, rate=0.05):
    """Three standard deviations of a binomial count above its mean."""
    return n * rate + 3 * np.sqrt(n * rate * (1 - rate))


@pytest.mark.parametrize(("dof", "noise"), [(np.inf, 1.0), (15.0, 3.0)], ids=["known", "from replicates, misstated"])
def test_false_alarms_are_five_percent(dof, noise):
    n = 200
    alarms = sum(not adequacy.is_adequate(build(seed, dof=dof, noise=noise), ()) for seed in range(n))
    assert 0 < alarms <= limit(n)


def test_naive_testing_would_alarm_far_more_often():
    n = 200
    naive = sum(adequacy.p_values(build(seed, n_draws=2)).smallest < 0.05 for seed in range(n))
    assert naive > 0.2 * n


def test_single_effect_is_found_and_alone():
    n, inside, alone = 60, 0, 0
    for seed in range(n):
        found = sets(build(seed, {"c": 7.0}))
        inside += ("c",) in found
        alone += found == {("c",)}
    assert inside >= 0.95 * n - 3 * np.sqrt(n * 0.05 * 0.95)
    assert alone >= 0.85 * n


def test_rivals_that_data_cannot_tell_apart_stand_side_by_side():
    found = [sets(build(seed, {"a": 7.0})) for seed in range(20)]
    assert sum({("a",), ("alias of a",)} <= f for f in found) >= 15
    far = [sets(build(seed, {"a": 70.0})) for seed in range(20)]
    assert sum(f == {("a",)} for f in far) >= 15  # ten times larger, the tenth of a difference tells


def test_pairs_are_found_where_stepwise_would_stop():
    found = [sets(build(seed, {"c": 8.0, "d": 8.0})) for seed in range(20)]
    assert sum(("c", "d") in f for f in found) >= 17
    assert not any(len(s) == 1 for f in found for s in f)


def test_the_unlisted_is_unexplained():
    found = [sets(build(seed, {"unlisted": 12.0})) for seed in range(20)]
    assert sum(f == set() for f in found) >= 18


def test_shortcuts_decide_as_the_full_monte_carlo_does():
    for seed in range(12):
        made = build(seed, {"a": 4.0, "d": 3.0}, n_draws=1500)
        reference = adequacy.critical_value(made)
        for size in (0, 1, 2):
            for chosen in combinations(range(6), size):
                p = adequacy.p_values(made, chosen).smallest
                full = p > np.quantile(adequacy.null_distribution(made, chosen), 0.05)
                assert adequacy.is_adequate(made, chosen) == full
                assert adequacy.is_adequate(made, chosen, reference=reference) == full


def test_corrected_p_values_are_uniform_under_noise():
    made = build(0, n_draws=4000)
    null = adequacy.null_distribution(made)
    fresh = [adequacy.corrected(adequacy.p_values(build(s, n_draws=2)).smallest, null) for s in range(300)]
    assert abs(np.mean(np.array(fresh) < 0.2) - 0.2) < 3 * np.sqrt(0.2 * 0.8 / 300)
    assert adequacy.corrected(0.0, null) == pytest.approx(1 / 4001)


def test_the_best_of_many_tried_is_held_to_more():
    made = build(3)
    g = made.names.index("c")
    single = adequacy.p_values(made).p[g]
    trials = made.trials.copy()
    trials[g] = 50
    searched = type(made)(**{**made.__dict__, "trials": trials})
    assert adequacy.p_values(searched).p[g] == pytest.approx(1 - (1 - single) ** 50)


def test_infeasible_sets_are_left_out_and_of_variants_the_first_is_kept():
    made = build(0, {"a": 7.0})
    a, alias = made.names.index("a"), made.names.index("alias of a")
    assert {(a,), (alias,)} <= set(adequacy.adequate_sets(made, range(6), 1, LEVEL))
    assert (a,) not in adequacy.adequate_sets(made, range(6), 1, LEVEL, feasible=lambda s: a not in s)
    variants = ["a" if name.endswith("a") else name for name in made.names]
    assert [s for s in adequacy.adequate_sets(made, range(6), 1, LEVEL, names=variants) if s[0] in (a, alias)] == [(a,)]
    assert not any({a, alias} <= set(s) for s in adequacy.adequate_sets(made, range(6), 2, LEVEL, names=variants))


def test_what_takes_up_nothing_explains_nothing():
    """However little speaks against it: else any effect would explain a misfit that is barely significant."""
    made = build(2, {"c": 7.0})
    c, d = made.names.index("c"), made.names.index("d")
    assert adequacy.explains(made, (c,))
    assert not adequacy.explains(made, (d,)) and not adequacy.explains(made, (c, d))
    assert adequacy.is_adequate(made, (c, d), LEVEL)
    kept = adequacy.adequate_sets(made, range(6), 2, LEVEL)
    assert (c, d) not in kept
    both = build(2, {"c": 7.0, "d": 7.0})
    assert adequacy.explains(both, (c, d))


def test_few_draws_go_on_in_proportion_where_many_would_count():
    """The smallest p of k independent ones: its distribution is known, 1 − (1 − p)ᵏ."""
    k, rng = 1000, np.random.default_rng(1)
    found = []
    for _ in range(200):
        null = np.sort(rng.uniform(size=(256, k)).min(axis=1))
        found.append([adequacy.corrected_far(p, null) for p in (1e-4, 2e-5, 1e-7)])
    truth = -np.expm1(k * np.log1p(-np.array([1e-4, 2e-5, 1e-7])))
    assert np.mean(found, axis=0) == pytest.approx(truth, rel=0.15)
    assert np.std(found, axis=0)[2] < 0.5 * truth[2]  # ten of 256 draws say it to a third
