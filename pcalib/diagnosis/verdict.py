"""From adequate sets to a verdict in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.candidates import Candidate

VERDICTS = ("nothing_missing", "established", "ambiguous", "unexplained")


@dataclass(frozen=True)
class Explanation:
    """One adequate set, with the simplest variant of each of its effects."""

    names: tuple[str, ...]
    """Effects and levels, sorted."""
    specs: tuple[str, ...]
    """How a command line names them, in the order of `names`."""
    candidates: tuple[Candidate, ...]
    theta: tuple[np.ndarray, ...]
    sigma: tuple[np.ndarray, ...]
    """[SI] least-squares parameters of each and their 1σ, linearised; empty arrays for levels."""
    bic: float
    """Bayesian information criterion; it orders, and never decides."""
    held_out: tuple[float, float] | None = None
    """χ² of the check rows before and after a full refit; None without check rows."""

    def words(self) -> str:
        """Its effects with their sizes."""
        return "; ".join(in_words(c, theta) for c, theta in zip(self.candidates, self.theta, strict=True))


def in_words(candidate: Candidate, theta: np.ndarray) -> str:
    """An effect with its size, or a level, as people say it."""
    if candidate.effect is None:
        return f"geometry of level {candidate.name}"
    return f"{candidate.effect.title} [{candidate.spec}]: {candidate.effect.describe(theta)}"


def decide(sets: Sequence[Explanation]) -> tuple[str, tuple[str, ...]]:
    """Verdict and established effects of the smallest adequate sets (one empty set: nothing is missing)."""
    if not sets:
        return "unexplained", ()
    if sets[0].names == ():
        return "nothing_missing", ()
    shared = set(sets[0].names)
    for other in sets[1:]:
        shared &= set(other.names)
    established = tuple(sorted(shared))
    if len(sets) == 1 and not _contradicted(sets[0]):
        return "established", established
    return "ambiguous", () if len(sets) == 1 else established


def _contradicted(explanation: Explanation) -> bool:
    """Whether held-out rows speak against it: their error has to fall."""
    if explanation.held_out is None:
        return False
    before, after = explanation.held_out
    return after >= before


def refuted(tested: Sequence[str], sets: Sequence[Explanation]) -> tuple[str, ...]:
    """Effects that were visible and stand in no adequate set; none where nothing is missing or nothing fits."""
    if not sets or sets[0].names == ():
        return ()
    inside = {name for e in sets for name in e.names}
    return tuple(sorted(set(tested) - inside))
