"""From adequate sets to a verdict in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcalib.diagnosis.held_out import Change
from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.diagnosis.plausibility import Implausible

VERDICTS = ("nothing_missing", "established", "ambiguous", "unexplained")
LOUD = 1.3
"""Times the stated noise from which residuals are a misfit where no replicates show a larger noise: instruments' σ are
stated to about a quarter."""
RARE = 1e-3
"""Chance of each test of the model as it stands: far below the rate of alarms, of which it takes nothing worth
mentioning."""
HELD_OUT = 5e-3
"""Chance of the test on held-out rows: with the α of the search on the rows to fit it makes the rate of alarms."""
LAW = 5e-3
"""Chance that the search for laws raises an alarm where nothing is missing; it adds to the same rate of alarms."""


class Doubt(StrEnum):
    """Why the one explanation that is left is not established."""

    NOTHING_HELD_OUT = "no rows are held out (set = check) that could confirm it"
    UNCONFIRMED = "held-out rows do not confirm it"
    EVENT = "one step or change of slope in the order of measurement explains as much"
    CORRELATED = "the noise is correlated in time, and held-out rows among the others share it"
    CLOSE = "replicates lie too close in time to stand for slow noise, which would look the same"
    FEW = "too few readings are left over to establish anything"
    LAW = "a law that is no listed effect explains these data better"
    EDGE = "a parameter lies at the edge of its physical range"
    SMALL = "the rows to fit alone show no more of it than noise would"


class Against(StrEnum):
    """Why something is missing although the rows to fit, refitted, look like noise."""

    STALE = "stale"
    """The model as it stands does not fit the rows to fit; a refit does."""
    HELD_OUT = "held_out"
    """Held-out rows are further off than the noise and the doubt of the fit explain."""
    STATED = "stated"
    """What is left over is larger than the stated noise, and no replicates show a larger one."""
    LAW = "law"
    """A law that is no listed effect explains more than noise would, on the rows to fit and on held-out rows."""


@dataclass(frozen=True)
class AsGiven:
    """The model as it stands, without a refit, against the noise."""

    fit: float
    """RMS of the readings of the rows to fit in noise units, rows set aside left out."""
    refit_p: float
    """Probability that noise alone lets χ² fall as far as it does by a refit."""
    check: float | None = None
    """RMS of the readings of the held-out rows in noise units, gross rows left out; None without such rows."""
    check_p: float = 1.0
    """Probability of a larger χ² of the held-out rows, with the whole covariance and the doubt of the fit."""
    stated: float = 1.0
    """Noise that is left over, over the stated one, where no replicates stand behind it; else 1."""
    law_p: float = 1.0
    """p of the best law that is no listed effect, corrected for all laws that were tried, on rows to fit and held-out
    rows together; 1 where none was looked for."""
    spent: float = 1.0
    """Share of the first round's chance of a false alarm that is spent in this round of measuring."""

    @property
    def against(self) -> tuple[Against, ...]:
        """What speaks against the model as it stands."""
        found = {
            Against.STALE: self.refit_p < RARE * self.spent, Against.HELD_OUT: self.check_p < HELD_OUT * self.spent,
            Against.STATED: self.stated > LOUD, Against.LAW: self.law_p < LAW * self.spent,
        }  # fmt: skip
        return tuple(reason for reason, holds in found.items() if holds)


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
    at_edge: bool = False
    """A parameter lies at the edge of its physical range."""
    implausible: tuple[Implausible, ...] = ()
    """What is odd about the fitted sizes."""
    held_out: Change | None = None
    """What held-out rows say after a full refit; None where it was not asked, or where no row is held out."""
    doubts: tuple[Doubt, ...] = ()
    """Why it is not established, even where no other explanation is left."""
    unconfirmed: tuple[str, ...] = ()
    """Names of members without which held-out rows are explained as well, of an explanation that they confirm."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the members, which variants of an effect share."""
        return tuple(h.name for h in self.members)

    @property
    def specs(self) -> tuple[str, ...]:
        """How a command line names the members."""
        return tuple(h.spec for h in self.members)

    @property
    def pairs(self) -> list[tuple[Hypothesis, np.ndarray]]:
        """Members and their parameters."""
        return list(zip(self.members, self.theta, strict=True))

    def words(self) -> str:
        """Its members with their sizes."""
        return "; ".join(h.sentence(theta) for h, theta in self.pairs)


NEARLY = 0.9
"""Share of the misfit from which on a set of effects that is not adequate is said to be nearly all of it."""


TRACE = 6.0
"""Noise units that such a set may leave: more than that is a cause of its own, which holds true from 6 on in nine sets
of ten."""


@dataclass(frozen=True)
class Nearly:
    """Effects that take up nearly everything where no set is adequate, and what they leave."""

    explanation: Explanation
    taken: float
    """Share of χ² above its degrees of freedom."""
    left: float
    """Norm of what is left in the pattern that shows it best, noise units."""
    where: int | None
    """Index of that pattern; None where what is left lies outside all."""


def decide(sets: Sequence[Explanation]) -> tuple[str, tuple[str, ...]]:
    """Verdict and established effects of the smallest adequate sets (one empty set: nothing is missing)."""
    if not sets:
        return "unexplained", ()
    if sets[0].names == ():
        return "nothing_missing", ()
    if sets[0].doubts or sets[0].implausible:
        return "ambiguous", ()
    sure = tuple(name for name in shared(sets) if name not in sets[0].unconfirmed)
    return "established" if len(sets) == 1 and sure == sets[0].names else "ambiguous", sure


def shared(sets: Sequence[Explanation]) -> tuple[str, ...]:
    """Names that all sets have in common, sorted."""
    return tuple(sorted(set.intersection(*(set(e.names) for e in sets))))


def refuted(tested: Sequence[str], sets: Sequence[Explanation]) -> tuple[str, ...]:
    """Effects that were visible and stand in no adequate set; none where nothing is missing or nothing fits, or where
    the rows to fit show no more than noise."""
    if not sets or sets[0].names == () or Doubt.SMALL in sets[0].doubts:
        return ()
    inside = {name for e in sets for name in e.names}
    return tuple(sorted(set(tested) - inside))
