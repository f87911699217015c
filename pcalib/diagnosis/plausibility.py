"""Whether fitted parameters are ones that working robots have, and as alike as parts of one make are.

An effect states for each of its parameters what working robots have, and by what share the arms or rods of one robot
differ (:class:`pcalib.effects.base.EffectParameter`). An explanation that needs other values may still be right,
because parts break; but something else is as likely behind them, so that it is never established.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.effects.base import Effect, EffectParameter

SIGMAS = 2.0
"""σ of the fit that are allowed for before a value counts as beyond what robots have."""
CHANCE = 0.01
"""Chance at which arms that are alike are said to differ."""
SHARES = 2.0 ** np.arange(-12, 4.5, 0.25)
"""Common values that are tried, as multiples of the largest fitted one, with either sign."""


class Oddity(StrEnum):
    """What is odd about fitted parameters."""

    FAR = "far"
    """One is larger than working robots have."""
    UNLIKE = "unlike"
    """Arms or rods differ by more than parts of one make do."""


@dataclass(frozen=True)
class Implausible:
    """An odd value of an effect, and what is usual."""

    effect: str
    oddity: Oddity
    words: str


def judge(
    members: Sequence[Hypothesis],
    theta: Sequence[np.ndarray],
    sigma: Sequence[np.ndarray],
    widened: Mapping[str, float] | None = None,
) -> tuple[Implausible, ...]:
    """What is odd about the parameters of an explanation; nothing where they are plausible.

    Args:
        theta, sigma: (p,) [SI] fitted parameters of each member and their 1σ.
        widened: effect → factor by which its plausible range and the share that arms differ by are widened.
    """
    out: list[Implausible] = []
    for member, values, spread in zip(members, theta, sigma, strict=True):
        if member.effect is not None and len(values):
            by = (widened or {}).get(member.name, 1.0)
            out += _far(member.effect, values, spread, by) + _unlike(member.effect, values, spread, by)
    return tuple(out)


def _far(effect: Effect, theta: np.ndarray, sigma: np.ndarray, by: float) -> list[Implausible]:
    """The value that is furthest beyond what working robots have."""
    low, high = (by * np.array([p.plausible[i] for p in effect.parameters]) for i in (0, 1))
    beyond = np.maximum(theta - high, low - theta) - SIGMAS * np.nan_to_num(sigma, nan=np.inf)
    j = int(np.argmax(beyond / np.array([p.prior for p in effect.parameters])))
    if beyond[j] <= 0:
        return []
    parameter = effect.parameters[j]
    most = high[j] if theta[j] > high[j] else low[j]
    what = f"{_spoken(parameter)} would be {effect.say(parameter, theta[j])}"
    return [
        Implausible(effect.name, Oddity.FAR, f"{what}, and working robots have up to {effect.say(parameter, most)}")
    ]


def _unlike(effect: Effect, theta: np.ndarray, sigma: np.ndarray, by: float) -> list[Implausible]:
    """Quantities of which the values of the arms or rods scatter by more than parts of one make do."""
    out = []
    quantities = dict.fromkeys(p.quantity for p in effect.parameters if np.isfinite(p.alike) and p.quantity)
    for quantity in quantities:
        mine = [j for j, p in enumerate(effect.parameters) if p.quantity == quantity]
        parameters = [effect.parameters[j] for j in mine]
        if len(mine) < 2 or not np.isfinite(sigma[mine]).all():
            continue
        if chance_of_alike(theta[mine], sigma[mine], by * parameters[0].alike) < CHANCE:
            said = ", ".join(effect.say(p, v) for p, v in zip(parameters, theta[mine], strict=True))
            words = f"{quantity.replace('_', ' ')} would be {said}, and parts of one make do not differ so much"
            out.append(Implausible(effect.name, Oddity.UNLIKE, words))
    return out


def chance_of_alike(theta: np.ndarray, sigma: np.ndarray, alike: float) -> float:
    """Probability that values scatter by more than these where every part has the same one, give or take a share.

    The values are θ_i ~ N(m, σ_i² + (alike·m)²), with the common m that suits them best.

    Args:
        theta, sigma: (p,) values and their 1σ.
        alike: 1σ by which parts differ, as a share of m.
    """
    from scipy.special import chdtrc

    largest = float(np.max(np.abs(theta)))
    if largest == 0.0:
        return 1.0
    m = largest * np.concatenate([-SHARES, [0.0], SHARES])[:, None]
    variance = sigma**2 + (alike * m) ** 2 + 1e-12 * largest**2
    return float(chdtrc(len(theta) - 1, np.min(np.sum((theta - m) ** 2 / variance, axis=1))))


def _spoken(parameter: EffectParameter) -> str:
    return parameter.name.replace("_", " ").replace(".", " of ")
