"""What a fit knows of a robot and how well: the posterior covariance that a model keeps, in factors.

The covariance of geometry and effects, the measuring frame allowed for, is F·Fᵀ. The factor F is lower triangular and
is kept with seven digits, which is far more than a covariance is known to.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib.errors import InputError

REMEDY = "fit the model anew, or delete the section [posterior]: the model then has no uncertainty"


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior covariance of a fit, [SI]."""

    names: tuple[str, ...]
    """Coordinates of the model's level, then parameters of its effects, effect by effect."""
    factor: np.ndarray
    """(n, n) Lower triangular F with covariance F·Fᵀ."""
    noise: np.ndarray
    """(2,) σ of positions and of rotations that the fit left, over the stated ones; 1 where none were measured."""

    @classmethod
    def of(cls, names: tuple[str, ...], half: np.ndarray, noise: np.ndarray) -> Posterior:
        """From any factor `half` (n, r) of the covariance."""
        n = len(names)
        padded = np.vstack([half.T, np.zeros((max(0, n - half.shape[1]), n))])
        return cls(names, np.linalg.qr(padded, mode="r")[:n].T, noise)

    @property
    def covariance(self) -> np.ndarray:
        """(n, n)."""
        return self.factor @ self.factor.T

    def to_table(self) -> dict[str, Any]:
        """The section [posterior] of a model file."""
        below = self.factor[np.tril_indices(len(self.names))].astype("<f4")
        return {
            "unknowns": list(self.names),
            "noise": [float(f"{ratio:.6g}") for ratio in self.noise],
            "factor_f32": base64.b64encode(below.tobytes()).decode("ascii"),
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any], names: tuple[str, ...]) -> Posterior:
        """From the section [posterior] of a model file.

        Args:
            names: the unknowns that the model has.

        Raises:
            InputError: it belongs to other unknowns, or is damaged.
        """
        if table.get("unknowns") != list(names):
            raise InputError("posterior: its unknowns are not those of the model", remedy=REMEDY)
        noise, text = table.get("noise"), table.get("factor_f32")
        numbers = isinstance(noise, list) and len(noise) == 2 and all(isinstance(v, (int, float)) for v in noise)
        if not numbers or not isinstance(text, str):
            raise InputError("posterior: noise or factor_f32 is missing", remedy=REMEDY)
        try:
            below = np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(float)
        except (binascii.Error, ValueError):
            raise InputError("posterior: factor_f32 is damaged", remedy=REMEDY) from None
        n = len(names)
        if len(below) != n * (n + 1) // 2 or not np.isfinite(below).all() or not 0 < min(noise) <= max(noise) < 1e9:
            raise InputError("posterior: factor_f32 or noise does not fit the model", remedy=REMEDY)
        factor = np.zeros((n, n))
        factor[np.tril_indices(n)] = below
        return cls(names, factor, np.array(noise, float))
