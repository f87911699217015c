"""Adequacy sets: every smallest combination of effects after which nothing else improves the fit.

Stepwise selection takes one of an aliased pair and stops; an adequacy set is kept wherever the data do not speak
against it, so that rivals that these poses cannot tell apart stand side by side. Such collections are known as model
selection confidence sets (Ferrari & Yang 2015; Zheng, Ferrari & Yang 2019).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pcalib.diagnosis.screen import Screen, outside

ALPHA = 0.05
"""Share of false alarms that is allowed for, over everything that was looked at."""
SEARCH = 0.04
"""The part of it for the search on the rows to fit; the rest is for the tests of the model as it stands and for a noise
level that is never known exactly: with 0.05 white noise raised 26 alarms in 400 sets."""
AGAINST = (0.02, 0.05)
"""Levels at which data speak against an explanation, a single one and a larger one: the share of true ones that may be
dropped. A single rival that stays for nothing costs a few more poses, a cause that is dropped costs the truth. Pairs
are ten times as many, and each is one more chance to pass for what no library lists."""


TAIL = 0.01
"""Level below which limits are continued in proportion: of 4,096 draws, 41 lie beyond it."""
RESOLVED = 10
"""Draws that must lie below a p value for their number to say how rare it is: ten give it to a third."""
RANKED = 20
"""Sets that are tried in the order of their BIC until one is possible; those behind take up clearly less."""


@dataclass(frozen=True)
class Test:
    """What still improves on a set of effects."""

    chosen: tuple[int, ...]
    p: np.ndarray
    """(G,) p of every group beside the chosen ones; 1 where a group adds nothing to them."""
    smallest: float
    """Smallest p, what lies outside every group included."""
    hottest: int
    """Group of the smallest p; −1: outside every group."""


def p_values(screen: Screen, chosen: Sequence[int] = ()) -> Test:
    """Single p values of all groups, the chosen ones allowed for."""
    blocks = screen.allowing(chosen)
    d = np.array([b.shape[1] for b in blocks])
    T = np.array([float(np.sum((screen.y @ b) ** 2)) for b in blocks])
    p = np.where(d > 0, screen.p_value(T, np.maximum(d, 1)), 1.0)
    p = best_of(p, screen.trials)
    hottest = int(np.argmin(p)) if len(p) else -1
    smallest = float(p[hottest]) if len(p) else 1.0
    if screen.left is not None and (rest := float(screen.p_value(*screen.left))) < smallest:
        smallest, hottest = rest, -1
    return Test(tuple(chosen), p, smallest, hottest)


def best_of(p: np.ndarray, trials: np.ndarray) -> np.ndarray:
    """p values (…) of the best of so many independent tries, from those of one try."""
    return np.where(trials > 1, -np.expm1(trials * np.log1p(-np.minimum(p, 1 - 1e-15))), p)


def null_distribution(screen: Screen, chosen: Sequence[int] = ()) -> np.ndarray:
    """Smallest p of each noise draw with the chosen groups allowed for, (n,) ascending."""
    allowed = screen.allowing(chosen)
    blocks = [b for b, trials in zip(allowed, screen.trials, strict=True) if b.shape[1] and trials == 1]
    smallest = np.ones(len(screen.draws))
    if blocks:
        square = (screen.draws @ np.hstack(blocks).astype(np.float32)) ** 2
        d = np.array([b.shape[1] for b in blocks])
        T = np.add.reduceat(square, np.r_[0, np.cumsum(d)[:-1]], axis=1)
        smallest = screen.p_of_draws(T, d).min(axis=1)
    searched = sum(b.shape[1] > 0 and trials > 1 for b, trials in zip(allowed, screen.trials, strict=True))
    if searched:
        # The best of many has, once corrected, a uniform p of its own; draws need not repeat the search.
        uniform = np.random.default_rng(searched).random((len(smallest), searched))
        smallest = np.minimum(smallest, uniform.min(axis=1))
    if screen.left is not None:
        smallest = np.minimum(smallest, screen.p_value(screen.left_draws, screen.left[1]))
    return np.sort(smallest)


def corrected(p: np.ndarray | float, null: np.ndarray) -> np.ndarray:
    """p values (…) corrected for all that was looked at, by the distribution of the smallest one."""
    return (1.0 + np.searchsorted(null, p, side="right")) / (len(null) + 1.0)


def corrected_far(p: float, null: np.ndarray) -> float:
    """A p value corrected as by :func:`corrected`; below the tenth smallest of few draws (n,) it is continued in
    proportion to p, as :func:`limit` continues the limit."""
    edge = float(null[min(RESOLVED, len(null)) - 1])
    if p >= edge:
        return float(corrected(p, null))
    return RESOLVED / (len(null) + 1.0) * p / edge


def limit(null: np.ndarray, level: float) -> float:
    """Smallest p that noise stays above with probability 1 − `level`, of its distribution (n,).

    Far out, the chance that one of many groups stands out grows in proportion to p.
    """
    known = max(level, TAIL)
    return float(np.quantile(null, known)) * level / known


def critical_value(screen: Screen, chosen: Sequence[int] = (), alpha: float = ALPHA) -> float:
    """Smallest p below which something counts as found with the chosen groups allowed for."""
    return limit(null_distribution(screen, chosen), alpha)


def is_adequate(screen: Screen, chosen: Sequence[int], alpha: float = ALPHA, reference: float | None = None) -> bool:
    """Whether nothing improves significantly on the chosen groups, by their own Monte-Carlo critical value.

    Args:
        reference: critical value with nothing chosen. Those of other sets lie close to it, so that only p values
            within a factor of two of it need a Monte Carlo of their own.
    """
    if reference is None:
        tests = int(np.sum(screen.visible > 0)) + 1
        sure, safe = 0.1 * alpha / tests, alpha  # Bonferroni below, no correction at all above
    else:
        sure, safe = 0.5 * reference, 2.0 * reference
    if _rejected_early(screen, chosen, sure):
        return False
    smallest = p_values(screen, chosen).smallest
    if smallest > safe:
        return True
    return smallest > sure and smallest >= critical_value(screen, chosen, alpha)


def _rejected_early(screen: Screen, chosen: Sequence[int], sure: float) -> bool:
    """Whether some group alone already speaks against the chosen ones; the hottest at the start are asked first."""
    Q = screen.joint(chosen) if chosen else np.zeros((len(screen.y), 0))
    rest = screen.y - Q @ (Q.T @ screen.y)
    # What is left within a group bounds what it can still gain from below only; but it orders the questions well.
    gain = np.array([float(np.sum((rest @ block) ** 2)) - block.shape[1] for block in screen.blocks])
    for g in np.argsort(-gain)[:12]:
        block = outside(screen.blocks[g], Q)
        T = float(np.sum((screen.y @ block) ** 2))
        if block.shape[1] and screen.trials[g] * screen.p_value(T, block.shape[1]) < sure:
            return True
    return False


def explains(screen: Screen, chosen: Sequence[int]) -> bool:
    """Whether each of the chosen groups takes up more than chance would, the others allowed for."""
    for g in chosen:
        others = [other for other in chosen if other != g]
        block = outside(screen.blocks[g], screen.joint(others)) if others else screen.blocks[g]
        T = float(np.sum((screen.y @ block) ** 2))
        if not block.shape[1] or best_of(screen.p_value(T, block.shape[1]), screen.trials[g]) > ALPHA:
            return False
    return True


def adequate_sets(
    screen: Screen,
    candidates: Sequence[int],
    size: int,
    level: float,
    reference: float | None = None,
    names: Sequence[str] | None = None,
    feasible: Callable[[tuple[int, ...]], bool] = lambda chosen: True,
) -> list[tuple[int, ...]]:
    """All sets of exactly `size` groups that explain something and that data do not speak against.

    Args:
        candidates: groups that may explain; the first of two that share a name goes first, and the second is left out.
        level: share of true sets that may be dropped.
        reference: critical value with nothing chosen, see :func:`is_adequate`.
        names: name of every group; variants of one effect share it, and do not make a set together.
        feasible: whether the fitted parameters of a set are physically possible.
    """
    names = screen.names if names is None else names
    found: dict[tuple[str, ...], tuple[int, ...]] = {}
    for chosen in combinations([g for g in candidates if screen.visible[g] > 0], size):
        called = tuple(sorted({names[g] for g in chosen}))
        if len(called) < size or called in found or not explains(screen, chosen):
            continue
        if is_adequate(screen, chosen, level, reference) and feasible(chosen):
            found[called] = chosen
    return list(found.values())


def nearest_set(
    screen: Screen,
    candidates: Sequence[int],
    largest: int,
    names: Sequence[str],
    feasible: Callable[[tuple[int, ...]], bool] = lambda chosen: True,
) -> tuple[int, ...]:
    """The set that takes up most for its size where none is adequate: the best pair by BIC, then what improves on it.

    Each member explains something beside the others. Empty where none does.
    """
    cost = float(np.log(max(len(screen.residual), 2)))
    seen = [g for g in candidates if screen.visible[g] > 0]

    def worth(chosen: tuple[int, ...]) -> float:
        Q = screen.joint(chosen)
        return float(np.sum((Q.T @ screen.y) ** 2)) - Q.shape[1] * cost

    best: tuple[int, ...] = ()
    for size in range(1, largest + 1):
        if size <= 2:
            tried = list(combinations(seen, size))
        else:
            tried = [(*best, g) for g in seen if best and g not in best]
        tried = [c for c in tried if len({names[g] for g in c}) == size]
        ranked = sorted(((worth(c), c) for c in tried), reverse=True)
        before = worth(best) if best else 0.0
        for value, chosen in ranked[:RANKED]:
            if value <= before:
                break
            if explains(screen, chosen) and feasible(chosen):
                best = chosen
                break
    return best
