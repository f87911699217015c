"""What a search of the grammar proposes: explanations that hold laws, in classes that the data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.candidates import Candidate
from pcalib.diagnosis.problem import Problem
from pcalib.laws.grammar import Law

ALIKE = 3.0
"""Noise units between the fitted signals of two laws below which the data cannot tell one from the other: a difference
of 3 would be found with a power of 60 % if nothing else were in question."""


@dataclass(frozen=True)
class Proposal:
    """One explanation that holds a law, and what the data say of it."""

    laws: tuple[Law, ...]
    """One law, or two where one is not enough."""
    beside: tuple[Candidate, ...]
    """The listed effect beside which the law stands, where there is one."""
    theta: tuple[np.ndarray, ...]
    """[SI] fitted amplitudes, one array (p,) for each law."""
    sigma: tuple[np.ndarray, ...]
    """[SI] 1σ of these amplitudes."""
    s: float
    """Norm of the fitted signal, noise units."""
    p: float
    """p of the best law of the grammar, corrected for all laws that were tried."""
    bic: float
    adequate: bool
    """Whether no listed effect and no pattern improves the fit further."""
    rest: float
    """Smallest p of all listed effects and patterns that could still improve the fit."""
    listed: tuple[str, ...]
    """Listed effects that fit this signal as well."""
    signal: np.ndarray
    """(M,) Fitted signal, whitened, outside the nuisance."""

    @property
    def complexity(self) -> int:
        """Number of amplitudes and searched constants."""
        return sum(law.complexity for law in self.laws) + sum(len(c.scale) for c in self.beside)

    def words(self) -> str:
        """The laws and the listed effects beside them in words, without their fitted sizes."""
        return " and ".join([*(law.words() for law in self.laws), *(f"{c.name} (listed)" for c in self.beside)])


@dataclass(frozen=True)
class Family:
    """Explanations that these data cannot tell apart, the simplest first."""

    members: tuple[Proposal, ...]

    @property
    def first(self) -> Proposal:
        """The simplest explanation, which represents the class."""
        return self.members[0]

    @property
    def rivals(self) -> tuple[Proposal, ...]:
        """The other explanations of the class."""
        return self.members[1:]


@dataclass(frozen=True)
class Proposals:
    """What a search of the grammar found."""

    families: tuple[Family, ...]
    """Adequate classes first, then by BIC; empty where no law gains more than chance."""
    tried: int
    """Laws that were tried."""
    p: float
    """p of the best law, corrected for the whole grammar."""
    problem: Problem

    @property
    def adequate(self) -> tuple[Family, ...]:
        """The classes of laws after which no candidate and no pattern improves the fit significantly."""
        return tuple(f for f in self.families if f.first.adequate)


def families(found: Sequence[Proposal]) -> list[Family]:
    """Classes of explanations with nearly one signal: adequate ones first, the simplest of each class in front."""
    left = sorted(found, key=lambda p: (not p.adequate, p.bic))
    out = []
    while left:
        head, *others = left
        mine = [p for p in others if np.linalg.norm(p.signal - head.signal) < ALIKE and p.adequate == head.adequate]
        members = sorted([head, *mine], key=lambda p: (p.complexity, p.bic))
        out.append(Family(tuple(members)))
        left = [p for p in others if all(p is not m for m in mine)]
    return out
