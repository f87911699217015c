"""Heavy tails of the noise: whether residuals have them, and how residuals are clipped then.

Residuals beyond 1.5 robust σ are clipped as robust regression does it (Huber's pseudo-values); what is left is then
tested as normal noise would be, which single wild readings do not allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.screen import INVISIBLE, NUISANCE, Group, joint_span, outside, project_out, span

HEAVY = 4.0
"""Standard errors of the kurtosis from which residuals have heavy tails: of normal noise one set in 30,000."""
CLIP = 1.5
"""Robust σ beyond which residuals of heavy tails are clipped (Huber 1981: 96 % efficiency in normal noise)."""
NORMAL = 1.4826
"""σ of normal noise over the median of its size."""
STANDING = 3
"""Groups that may explain residuals before their tails are looked at: one more than the largest explanations have."""
MIXED = 0.1
"""Share of a reading's variance below which what is left of it is another reading's."""


@dataclass(frozen=True)
class Tails:
    """Residuals of heavy tails are clipped and scaled, so that they have a standard deviation of 1."""

    widened: float
    """Variance of the χ² of readings that are not clipped, over that of normal noise."""
    most: np.ndarray
    """(2,) noise units beyond which positions and rotations are clipped."""
    size: np.ndarray
    """(2,) factor by which clipped positions and rotations are multiplied."""

    def clipped(self, z: np.ndarray, classes: np.ndarray) -> np.ndarray:
        """Residuals z (M,) of classes (M,) 0 and 1, clipped and scaled, so that tests for normal noise hold."""
        most = self.most[classes]
        return np.clip(z, -most, most) * self.size[classes]


def tails_of(z: np.ndarray, dof: int, sure: float) -> float:
    """Variance of Σz² over that of normal noise of the same size: 1 + γ/2 with the excess kurtosis γ (Box 1953).

    Args:
        z: residuals in noise units.
        dof: their degrees of freedom.
        sure: standard errors above 0 from which on γ counts; below, the ratio is 1.
    """
    if dof < 1 or not len(z):
        return 1.0
    excess = float(np.mean(z**4) / max(np.mean(z**2), 1e-300) ** 2 - 3)
    return 1 + excess / 2 if excess > sure * np.sqrt(24 / dof) else 1.0


def find(y: np.ndarray, nuisance: np.ndarray, groups: Sequence[Group], classes: np.ndarray) -> Tails | None:
    """The tails of residuals y (M,) in noise units, what may be missing left out; None where they are normal.

    Whether there are heavy tails is asked of the part of the residuals that no group can take up. Each number of that
    part is a mixture of many readings, so that heavy tails look lighter there. How heavy they are is therefore measured
    on what the groups leave that the data need.

    Args:
        nuisance: (M, n) columns of what the model has.
        classes: (M,) 0 for positions, 1 for rotations.
    """
    U = span(nuisance, NUISANCE)
    rest = project_out(y, U)
    if tails_of(_left(y, U, classes), len(y) - U.shape[1], HEAVY) == 1 or not groups:
        return None
    if tails_of(_left(y, joint_span(nuisance, groups), classes), len(y), 0.0) == 1:
        return None
    bases = [span(project_out(g.columns, U) * g.furthest, INVISIBLE) for g in groups]
    for _ in range(STANDING):
        left = project_out(y, U)
        gain = [float(np.sum((b.T @ left) ** 2)) - b.shape[1] * np.log(len(y)) for b in bases]
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        U = np.hstack([U, outside(bases[best], U)])
        bases = [outside(b, U) for b in bases]
    widened = tails_of(_left(y, U, classes), len(y) - U.shape[1], HEAVY)
    if widened == 1:
        return None
    most, size = np.full(2, np.inf), np.ones(2)
    for c in np.unique(classes):
        far = np.abs(rest[classes == c])
        most[c] = CLIP * NORMAL * float(np.median(far))
        size[c] = 1 / max(float(np.mean(far < most[c])), MIXED)
    return Tails(widened, most, size)


def _left(y: np.ndarray, Q: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """What is left of y (M,) outside span(Q), each with a variance of 1 within its class."""
    free = 1 - np.sum(Q**2, axis=1)
    own = free > MIXED
    z = (y - Q @ (Q.T @ y))[own] / np.sqrt(free[own])
    for c in np.unique(classes[own]):
        mine = classes[own] == c
        z[mine] /= max(float(np.sqrt(np.mean(z[mine] ** 2))), 1e-300)
    return z
