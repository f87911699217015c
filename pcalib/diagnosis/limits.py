"""How small an effect could have been and still be seen: detection limits at 90 % power."""

from __future__ import annotations

import numpy as np

from pcalib.diagnosis.screen import KNOWN, Screen

POWER = 0.9


def visible_size(screen: Screen, d: int, critical: float) -> float:
    """s, in noise units, that d columns must have to be found with 90 % power at a critical p."""
    from scipy.special import chdtri, chndtrinc, fdtri, ncfdtrinc

    if screen.nu >= KNOWN:
        return float(np.sqrt(chndtrinc(chdtri(d, critical), d, 1 - POWER)))
    return float(np.sqrt(ncfdtrinc(d, screen.nu, 1 - POWER, fdtri(d, screen.nu, 1 - critical))))


def smallest_seen(screen: Screen, g: int, critical: float) -> np.ndarray:
    """(p,) [SI] size of each parameter of a group, acting alone, that would have been found; inf where invisible."""
    if screen.visible[g] == 0:
        return np.full(screen.parts[g].shape[1], np.inf)
    seen = screen.blocks[g].T @ screen.parts[g]
    size = np.linalg.norm(seen, axis=0)
    # The best of several tried must beat them all.
    needed = visible_size(screen, int(screen.visible[g]), critical / float(screen.trials[g]))
    with np.errstate(divide="ignore"):
        return np.where(size > 0, needed / np.where(size > 0, size, 1.0), np.inf)
