"""Laws beside the verdict of a diagnosis: where no listed effect is the answer, and where a law does as well as one."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

from pcalib.diagnosis.diagnose import Diagnosis
from pcalib.laws import telling
from pcalib.laws.proposal import Proposals
from pcalib.laws.search import propose

SHOWN = 2
"""Laws that are named beside an established effect."""
CLEAR = 6.0
"""Difference of BIC from which on a law is no rival of a listed effect: strong evidence (Kass & Raftery 1995)."""


@dataclass(frozen=True)
class Beside:
    """What laws add to a verdict."""

    proposals: Proposals
    rivals: tuple[str, ...]
    """Laws, in words, that do as well as the established effect without being that effect under another name."""

    @property
    def sentence(self) -> str:
        """The simplest law, in words; empty where there is none to speak of."""
        return telling.sentence(self.proposals) if self.proposals.families else ""


def beside(found: Diagnosis, seed: int = 0) -> Beside | None:
    """Laws where a diagnosis is unexplained or has established an effect; None where nothing asks for them.

    Nothing is searched for unless the diagnosis has raised its alarm, so that proposals raise none of their own.
    """
    doubted = bool(found.sets) and bool(found.sets[0].implausible)
    if not (found.verdict in ("unexplained", "established") or doubted) or found.problem.outliers.too_many:
        return None
    proposals = propose(found.problem, seed=seed)
    if found.verdict == "unexplained":
        return Beside(proposals, ())
    named = found.sets[0]
    rivals = [
        f.first.words()
        for f in proposals.adequate
        if not {*f.first.listed, *(c.name for c in f.first.beside)} & set(named.names)
        and f.first.bic < _named_bic(found) + CLEAR
    ]
    return Beside(proposals, tuple(rivals[:SHOWN]))


def _named_bic(found: Diagnosis) -> float:
    """BIC of the established effect on the scale of the laws: gain of its signal less ln M for each of its columns."""
    made, best = found.problem, found.sets[0]
    columns = sum(len(theta) for theta in best.theta)
    gain = sum(f.s**2 for f in found.findings if f.candidate.spec in best.specs)
    return columns * log(len(made.y)) - gain
