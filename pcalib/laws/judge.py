"""Whether a law explains all of what is left: the adequacy test of the diagnosis, for laws beside what it lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib.diagnosis import adequacy
from pcalib.diagnosis.candidates import Candidate
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.screen import Group, Screen, screen
from pcalib.laws.grammar import Law
from pcalib.laws.proposal import ALIKE, Proposal

TESTED = 32
"""Laws that are put to the adequacy test, one per channel, sharing and function: the true one is nearly always among
the first ten by BIC."""
BEHIND = 80.0
"""BIC behind the best explanation from which on another is not put to the test: odds of e^40 against it."""
ENOUGH = 8
"""Adequate explanations after which no further ones are tested: nobody would read more rivals."""


@dataclass(frozen=True)
class Judge:
    """The adequacy test of the diagnosis, for laws beside what it lists."""

    made: Problem
    p: float
    level: float
    seed: int
    reference: float
    """Critical value with nothing chosen, of the listed effects and the patterns."""

    @classmethod
    def of(cls, made: Problem, p: float, level: float, seed: int) -> Judge:
        null = adequacy.null_distribution(made.screen(seed=seed))
        return cls(made, p, level, seed, float(np.quantile(null, level)))

    def all(self, wanted: Sequence[tuple[tuple[Law, ...], tuple[Candidate, ...], float]]) -> list[Proposal]:
        """Explanations (laws, listed effects beside them, BIC) with what the data say of them, the best BIC first."""
        made, n = self.made, len(self.made.groups)
        wanted = sorted(wanted, key=lambda w: w[2])[:TESTED]
        wanted = [w for w in wanted if w[2] < wanted[0][2] + BEHIND]
        every = list(dict.fromkeys(law for some, _, _ in wanted for law in some))
        groups = [
            Group(law.words(), made.whitened(columns(made, law)), np.full(law.columns, law.channel.size))
            for law in every
        ]
        noise = made.known
        from_rest = made.noise.source == "residuals" or made.noise.pooled
        whole = screen(made.y, made.nuisance, [*made.groups, *groups], noise, from_rest=from_rest, seed=self.seed)
        named = {id(c): i for i, c in enumerate(made.candidates)}
        out = []
        for chosen_laws, beside, bic in wanted:
            if sum(f.adequate for f in out) >= ENOUGH:
                break
            mine = [n + every.index(law) for law in chosen_laws]
            chosen = [*mine, *(named[id(c)] for c in beside)]
            tested = _keeping(whole, [*range(n), *mine])
            places = [*range(n, n + len(mine)), *chosen[len(mine) :]]
            theta, sigma = whole.estimate(chosen)
            Q = whole.joint(chosen)
            signal = Q @ (Q.T @ whole.y)
            out.append(
                Proposal(
                    laws=chosen_laws,
                    beside=beside,
                    theta=tuple(theta[: len(chosen_laws)]),
                    sigma=tuple(sigma[: len(chosen_laws)]),
                    s=float(np.linalg.norm(signal)),
                    p=self.p,
                    bic=bic,
                    adequate=adequacy.is_adequate(tested, places, self.level, self.reference),
                    rest=float(adequacy.p_values(tested, places).smallest),
                    listed=_as_listed(made, whole, signal),
                    signal=whole.basis @ signal,
                )
            )
        return out


def _as_listed(made: Problem, whole: Screen, signal: np.ndarray) -> tuple[str, ...]:
    """Names of the listed effects that can make a signal (D,) within what the data can tell."""
    blocks = whole.blocks[: len(made.candidates)]
    near = [np.linalg.norm(signal - block @ (block.T @ signal)) < ALIKE for block in blocks]
    return tuple(dict.fromkeys(c.name for c, close in zip(made.candidates, near, strict=True) if close))


def _keeping(whole: Screen, keep: Sequence[int]) -> Screen:
    """A screen with some of its groups, in the same coordinates."""

    def some(values: tuple) -> tuple:
        return tuple(values[g] for g in keep)

    return replace(
        whole, names=some(whole.names), blocks=some(whole.blocks), parts=some(whole.parts),
        trials=whole.trials[list(keep)], full=some(whole.full), scale=some(whole.scale), limit=some(whole.limit),
    )  # fmt: skip


def columns(made: Problem, law: Law) -> np.ndarray:
    at = made.point.situation
    return made.point.columns([law.contribution(at, row) for row in np.eye(law.columns)])
