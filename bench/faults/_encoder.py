"""What a controller does with an encoder that errs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def invert(reading: Callable[[np.ndarray], np.ndarray], theta: np.ndarray) -> np.ndarray:
    """The shaft angles (nq,) [rad] that an encoder with small errors reads as theta: what the controller goes to."""
    shaft = theta.copy()
    for _ in range(60):
        off = reading(shaft) - theta
        shaft = shaft - off
        if np.abs(off).max() < 1e-16:
            break
    return shaft
