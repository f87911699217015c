"""Colours for error sizes: one logarithmic scale for all steps, so that a smaller error is always another colour.

Blue → pale → red, distinguishable with any common colour blindness; all of it is readable on black and on white.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

ANCHORS = ("#3b78d8", "#5fb4e5", "#bfe3dc", "#f8e08e", "#f79d52", "#dc3b2f", "#8f1233")
"""From the smallest error to the largest, evenly spaced on the logarithmic scale."""
NO_VALUE = (120, 124, 132)
"""RGB where there is no error to show."""
SERIES = ("#4c9be8", "#f2a53c", "#e8605a", "#5bbf8a", "#b58be0", "#c9c14e")
"""Colours of tools (or other series) in plots, on black and on white."""


@dataclass(frozen=True)
class LogScale:
    """Sizes from `low` to `high` [any unit], mapped to colours by their logarithm."""

    low: float
    high: float

    @classmethod
    def of(cls, values: np.ndarray) -> LogScale:
        """Whole decades around all positive values: 1e-5…1e-2 for 12 µm to 6 mm."""
        seen = values[np.isfinite(values) & (values > 0)]
        if len(seen) == 0:
            return cls(1e-6, 1e-3)
        low = math.floor(math.log10(seen.min()) + 1e-9)
        high = math.ceil(math.log10(seen.max()) - 1e-9)
        return cls(10.0**low, 10.0 ** max(high, low + 1))

    def share(self, values: np.ndarray) -> np.ndarray:
        """Position of values on the scale, from 0 at `low` to 1 at `high`; NaN stays NaN."""
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (np.log10(values) - math.log10(self.low)) / (math.log10(self.high) - math.log10(self.low))
        return np.clip(at, 0.0, 1.0)

    def rgb(self, values: np.ndarray) -> np.ndarray:
        """(...) → (..., 3) uint8; grey where there is no value."""
        values = np.asarray(values, float)
        at = self.share(values)
        anchors = _anchors()
        place = np.linspace(0, 1, len(anchors))
        out = np.stack([np.interp(np.nan_to_num(at), place, anchors[:, c]) for c in range(3)], axis=-1)
        out[np.isnan(at)] = NO_VALUE
        return np.round(out).astype(np.uint8)

    @property
    def decades(self) -> np.ndarray:
        """Powers of ten from low to high."""
        first, last = round(math.log10(self.low)), round(math.log10(self.high))
        return 10.0 ** np.arange(first, last + 1)


@lru_cache(maxsize=1)
def _anchors() -> np.ndarray:
    return np.array([rgb(colour) for colour in ANCHORS], float)


def rgb(colour: str) -> tuple[int, int, int]:
    """'#rrggbb' → three numbers 0…255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
