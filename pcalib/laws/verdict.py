"""Laws beside the verdict of a diagnosis: where no listed effect is the answer, and where a law does as well as one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np

from pcalib.diagnosis.diagnose import Diagnosis
from pcalib.diagnosis.verdict import Doubt, decide
from pcalib.laws import telling
from pcalib.laws.proposal import Proposals
from pcalib.laws.search import propose

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


def beside(found: Diagnosis, seed: int = 0) -> Beside | None:
    """Laws where a diagnosis is unexplained or has established an effect; None where nothing asks for them.

    Nothing is searched for unless the diagnosis has raised its alarm, so that proposals raise none of their own.
    """
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


def with_laws(found: Diagnosis) -> Diagnosis:
    """The diagnosis, in which no effect is established where a law explains the data better."""
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
