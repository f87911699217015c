"""Where a controller brings a shaft whose encoder errs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def invert(reading: Callable[[np.ndarray], np.ndarray], theta: np.ndarray) -> np.ndarray:
    """Return the shaft angles (nq,) [rad] at which encoders with small errors read theta."""
    shaft = theta.copy()
    for _ in range(60):
        off = reading(shaft) - theta
        shaft = shaft - off
        if np.abs(off).max() < 1e-16:
            break
    return shaft
