"""What is said about a new session: the verdict, its explanations, and every part on its own."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcalib.changes.session import LinearisedSession
from pcalib.diagnosis.candidates import Candidate
from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.diagnosis.patterns import Cell


class Verdict(StrEnum):
    """The answer to the question what changed."""

    NOTHING = "nothing_changed"
    ESTABLISHED = "established"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Slip:
    """A part that slipped between two rows."""

    hypothesis: Hypothesis
    row: int
    """First row after the slip, counted from 0."""


@dataclass(frozen=True)
class Changed:
    """One thing that may have changed, with its size."""

    candidate: Candidate
    theta: np.ndarray
    """(p,) [SI] fitted change along the directions of the hypothesis."""
    sigma: np.ndarray
    """(p,) [SI] 1σ of the change; inf where these poses cannot see it."""
    s: float
    """Norm of what it takes up on its own, noise units."""
    p: float
    """p of the candidate, corrected for everything that was looked at."""
    smallest: np.ndarray
    """(p,) [SI] Smallest change that would have been seen with 90 % power; inf where none would."""
    slip: Slip | None = None
    before: np.ndarray | None = None
    """(p,) [SI] Parameters of an effect that the model has already, of which `theta` is the change."""

    @property
    def name(self) -> str:
        """The part's, effect's or slip's name."""
        return self.candidate.name


@dataclass(frozen=True)
class ChangeSet:
    """One smallest set of changes that explains the session."""

    members: tuple[Changed, ...]
    bic: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what changed, sorted."""
        return tuple(sorted(m.name for m in self.members))

    @property
    def slips(self) -> bool:
        """Whether one of these changes is a slip within the session."""
        return any(m.slip is not None for m in self.members)


@dataclass(frozen=True)
class Changes:
    """What changed between the session of the model and this one."""

    verdict: Verdict
    sets: tuple[ChangeSet, ...]
    """The smallest adequate sets, by BIC; empty where nothing changed, or nothing explains what did."""
    findings: tuple[Changed, ...]
    """Every part, effect and slip on its own, hottest first."""
    cells: tuple[Cell, ...]
    """Where the change shows, hottest first."""
    frame: np.ndarray
    """(0 or 6) [m, rad] Change of the measuring frame: displacement of the readings' centroid, and rotation."""
    chi2_dof: float
    """χ² per degree of freedom of the new session under the old model, the frame allowed for."""
    p: float
    """Smallest p of all that was looked at, corrected for the looking."""
    critical: float
    session: LinearisedSession

    @property
    def established(self) -> tuple[str, ...]:
        """What changed for certain: the single answer, or what every adequate set has in common."""
        if not self.sets:
            return ()
        if self.verdict is Verdict.ESTABLISHED:
            return self.sets[0].names
        shared = set(self.sets[0].names)
        for other in self.sets[1:]:
            shared &= set(other.names)
        return tuple(sorted(shared))
