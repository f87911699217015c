"""Pose accuracy and repeatability of position, ISO 9283:1998, 7.2.1 and 7.2.2.

A pose is commanded in n cycles and attained at positions p_j with barycentre p̄ = Σp_j/n:

    accuracy       AP = |p̄ − wanted|
    repeatability  RP = l̄ + 3·S_l,   l_j = |p_j − p̄|,   S_l² = Σ(l_j − l̄)²/(n − 1)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib import rotation


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Figures of P poses in n cycles, over the cycles that attained the pose; NaN where none did."""

    ap: np.ndarray
    """(P,) [m]."""
    rp: np.ndarray
    """(P,) [m]; zero in a single cycle, which has nothing to tell of repeatability."""
    rms: float
    """[m] sqrt(mean |p − wanted|²) over all poses and cycles."""
    max: float
    """[m]."""


def accuracy(attained: np.ndarray, wanted: np.ndarray) -> Accuracy:
    """Figures of attained positions (n, P, 3), NaN where a pose was not attained, against wanted ones (P, 3)."""
    n = (~np.isnan(attained[..., 0])).sum(axis=0)
    some = n > 0
    middle = np.nansum(attained, axis=0) / np.where(some, n, np.nan)[:, None]
    distance = np.linalg.norm(attained - middle, axis=-1)
    mean = np.nansum(distance, axis=0) / np.where(some, n, np.nan)
    spread = np.sqrt(np.nansum((distance - mean) ** 2, axis=0) / np.maximum(n - 1, 1))
    missed2 = np.sum((attained - wanted) ** 2, axis=-1)
    missed2 = missed2[~np.isnan(missed2)]
    return Accuracy(
        ap=np.linalg.norm(middle - wanted, axis=-1),
        rp=mean + 3 * spread,
        rms=float(np.sqrt(missed2.mean())) if len(missed2) else float("nan"),
        max=float(np.sqrt(missed2.max())) if len(missed2) else float("nan"),
    )


def align(attained: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Attained positions (n, P, 3) after the :func:`motion` that best lays them on the wanted ones (P, 3)."""
    R, t = motion(attained, wanted)
    return attained @ R.T + t


def motion(attained: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R (3, 3) and t (3,) [m]: R·p + t best lays the barycentres of attained positions (n, P, 3) on wanted ones (P, 3).

    Raises:
        ValueError: fewer than three poses were attained.
    """
    seen = ~np.isnan(attained[..., 0]).all(axis=0)
    if seen.sum() < 3:
        raise ValueError("a rigid motion needs three poses at least")
    middle = np.nanmean(attained[:, seen], axis=0)
    a, b = middle.mean(axis=0), wanted[seen].mean(axis=0)
    R = rotation.laying(middle - a, wanted[seen] - b)
    return R, b - R @ a
