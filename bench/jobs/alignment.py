"""The rigid motion that best lays attained positions on wanted ones, for models of an unknown measuring frame."""

from __future__ import annotations

import numpy as np

from pcalib import rotation
from pcalib.iso9283 import barycentre


def align(attained: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Attained positions (n, P, 3) after the rigid :func:`motion` that fits them best to the wanted ones (P, 3)."""
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
    return rotation.registered(barycentre(attained[:, seen]), wanted[seen])
