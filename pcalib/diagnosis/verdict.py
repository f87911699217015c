"""From adequate sets to a verdict in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.hypothesis import Hypothesis

VERDICTS = ("nothing_missing", "established", "ambiguous", "unexplained")


@dataclass(frozen=True)
class Explanation:
    """One adequate set, with the simplest variant of each of its effects."""

    members: tuple[Hypothesis, ...]
    """In the simplest variant of each, sorted by name."""
    theta: tuple[np.ndarray, ...]
    sigma: tuple[np.ndarray, ...]
    """[SI] least-squares parameters of each and their 1σ, linearised; empty arrays for levels of the geometry."""
    bic: float
    """Bayesian information criterion; it orders, and never decides."""
    held_out: tuple[float, float] | None = None
    """χ² of the check rows before and after a full refit; None without check rows."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the members, which variants of an effect share."""
        return tuple(h.name for h in self.members)

    @property
    def specs(self) -> tuple[str, ...]:
        """How a command line names the members."""
        return tuple(h.spec for h in self.members)

    def words(self) -> str:
        """Its members with their sizes."""
        return "; ".join(h.sentence(theta) for h, theta in zip(self.members, self.theta, strict=True))


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
