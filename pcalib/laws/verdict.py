"""Laws beside the verdict of a diagnosis: where no listed effect is the answer, and where a law does as well as one.

Where the diagnosis finds nothing, a law may still show what no effect and no pattern shows. It has to be rare twice: by
its gain on the rows to fit, p₁ corrected for the whole grammar, and by the change that it predicts for the held-out
rows, p₂. Both are uniform where nothing is missing, and independent because the law is chosen on the rows to fit. Their
product w, looked at where p₁ ≤ τ only, has the p value

    p = w·(1 + ln(τ/w))        w = p₁·p₂ ≤ τ

(truncated product method: Zaykin, Zhivotovsky, Westfall & Weir 2002).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np

from pcalib.diagnosis.adequacy import ALPHA
from pcalib.diagnosis.diagnose import Diagnosis
from pcalib.diagnosis.held_out import HeldOut, refitted
from pcalib.diagnosis.hypothesis import Hypothesis, Kind
from pcalib.diagnosis.verdict import Against, Doubt, decide
from pcalib.effects.base import Contribution, Effect, Situation
from pcalib.laws import telling
from pcalib.laws.grammar import Law
from pcalib.laws.proposal import Proposals
from pcalib.laws.search import propose
from pcalib.laws.writing import names

SHOWN = 2
"""Laws that are named beside an established effect."""
CLEAR = 6.0
"""Difference of BIC from which on a law is no rival of a listed effect: strong evidence (Kass & Raftery 1995)."""


@dataclass(frozen=True)
class Beside:
    """What laws add to a diagnosis."""

    found: Diagnosis
    """The diagnosis, in which a listed effect is not established where a law explains the data better."""
    proposals: Proposals
    rivals: tuple[str, ...]
    """Laws in words that explain the data as well as the listed effects that were found, but for laws that are one of
    these effects under another name."""
    better: bool = False
    """Whether these laws explain the data better than the listed effects, by more than the search costs."""

    @property
    def sentence(self) -> str:
        """The simplest law, in words; empty where there is none to speak of."""
        return telling.sentence(self.proposals) if self.proposals.families else ""


class _AsEffect(Effect):
    """A law as an effect that a model may have."""

    linear = True

    def __init__(self, law: Law) -> None:
        self.law = law
        self.name = self.spec = names(law)[0]
        self.title, self.parameters, self.needs = law.words(), law.parameters, law.needs

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        """What the law adds at amplitudes theta (columns,) [SI]."""
        return self.law.contribution(at, theta)


def beside(found: Diagnosis, seed: int = 0) -> Beside | None:
    """Laws where a diagnosis is unexplained or has established an effect, and where a law alone shows that something is
    missing; None where nothing asks for them."""
    if found.verdict == "nothing_missing":
        return _alone(found, seed)
    doubted = bool(found.sets) and bool(found.sets[0].implausible)
    if not (found.verdict == "unexplained" or found.established or doubted) or found.problem.outliers.too_many:
        return None
    if found.verdict != "unexplained" and any(h.effect is None for h in found.sets[0].members):
        return None  # what a level of the geometry explains is no effect that a law could stand for
    proposals = propose(found.problem, seed=seed)
    if found.verdict == "unexplained":
        return Beside(found, proposals, ())
    named, bic = found.sets[0].names, _named_bic(found)
    others = [f.first for f in proposals.adequate]
    better = [law for law in others if law.bic < bic - chance(proposals.tried)]
    if better:
        return Beside(_with_doubt(found), proposals, tuple(law.words() for law in better[:SHOWN]), better=True)
    rivals = [
        law
        for law in others
        if not {*law.listed, *(c.name for c in law.beside)} & set(named) and law.bic < bic + CLEAR
    ]
    return Beside(found, proposals, tuple(law.words() for law in rivals[:SHOWN]))


def _alone(found: Diagnosis, seed: int) -> Beside | None:
    """The diagnosis as one that is unexplained, where a law shows what no effect and no pattern shows."""
    proposals = propose(found.problem, seed=seed, companions=0)
    given = replace(found.given, law_p=_p(found, proposals))
    if Against.LAW not in given.against:
        return None
    return Beside(replace(found, verdict="unexplained", sets=(), given=given), proposals, ())


def _p(found: Diagnosis, proposals: Proposals) -> float:
    """p of the first law, on rows to fit and held-out rows together."""
    if not proposals.families:
        return 1.0
    made, best = found.problem, proposals.families[0].first
    held = None if found.checked is None else HeldOut.of(made, found.checked)
    if held is None:
        return proposals.p
    added = [
        (Hypothesis.of(_AsEffect(law), Kind.LAW), theta) for law, theta in zip(best.laws, best.theta, strict=True)
    ]
    added += [(c.hypothesis, np.zeros(len(c.scale))) for c in best.beside]
    before, after = refitted(made.model, made.data, []), refitted(made.model, made.data, added)
    change = held.compared(before, after)
    return both(proposals.p, 1.0 if change is None else change.p)


def both(p: float, held: float) -> float:
    """p value of two independent ones, the first of which is ALPHA or less."""
    w = p * held
    return w * (1 + log(ALPHA / w)) if w > 0 else 0.0


def with_laws(found: Diagnosis) -> Diagnosis:
    """The diagnosis with what laws say of it: nothing is established where a law explains the data better, and
    something is missing where a law alone shows it."""
    laws = beside(found)
    return found if laws is None else laws.found


def chance(tried: int) -> float:
    """Reduction of χ² that the best of n wrong laws reaches by chance: the largest of n squared normal variates."""
    return 2 * log(max(tried, 1))


def _with_doubt(found: Diagnosis) -> Diagnosis:
    """The diagnosis with nothing established, because a law explains the data better."""
    best, *others = found.sets
    sets = (replace(best, doubts=(*best.doubts, Doubt.LAW)), *others)
    verdict, established = decide(sets)
    return replace(found, sets=sets, verdict=verdict, established=established)


def _named_bic(found: Diagnosis) -> float:
    """BIC of the best explanation on the scale of the laws: ln M per column, less the χ² that they explain."""
    made, best = found.problem, found.sets[0]
    specs = [c.spec for c in made.candidates]
    chosen = [specs.index(spec) for spec in best.specs if spec in specs]
    screen = made.screen(n_draws=1)
    Q = screen.joint(chosen)
    return Q.shape[1] * log(len(made.y)) - float(np.sum((Q.T @ screen.y) ** 2))
