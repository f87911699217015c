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
class Remaining:
    """What a fit left over: how far readings of a later session may lie from what the model predicts."""

    ratio: np.ndarray
    """(2,) σ of positions and of rotations over the stated ones, without that of the joints; 1 where none are read."""
    sigma_q: float = 0.0
    """[rad or m] 1σ joint repeatability; 0 where it is not seen."""
    misfit: float = 1.0
    """Variance of rows that a fit to the others leaves out, over that of the noise; 1 where the model fits."""
    dof: float = np.inf
    """Degrees of freedom of all that."""

    def to_table(self) -> dict[str, Any]:
        """Keys of the section [posterior]."""
        out = {"sigma_q": self.sigma_q, "misfit": self.misfit, "dof": self.dof}
        kept = {key: float(f"{value:.6g}") for key, value in out.items() if np.isfinite(value)}
        return {"noise": [float(f"{ratio:.6g}") for ratio in self.ratio], **kept}

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Remaining:
        """The posterior in the section [posterior] of a model file; files of earlier versions have `noise` alone.

        Raises:
            InputError: a number is missing or makes no sense.
        """
        noise = table.get("noise")
        others = {key: table.get(key, default) for key, default in (("sigma_q", 0.0), ("misfit", 1.0), ("dof", np.inf))}
        pair = noise if isinstance(noise, list) and len(noise) == 2 else ["?"]
        if not all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in (*pair, *others.values())):
            raise InputError("posterior: noise, sigma_q, misfit or dof is missing or no number", remedy=REMEDY)
        made = cls(np.array(pair, float), *(float(v) for v in others.values()))
        inside = 0 < made.ratio.min() <= made.ratio.max() < 1e9 and 0 <= made.sigma_q < 1e3
        if not (inside and 0 < made.misfit < 1e9 and made.dof > 0):
            raise InputError("posterior: noise, sigma_q, misfit or dof makes no sense", remedy=REMEDY)
        return made


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior covariance of a fit, [SI]."""

    names: tuple[str, ...]
    """Coordinates of the model's level, then parameters of its effects, effect by effect."""
    factor: np.ndarray
    """(n, n) Lower triangular F with covariance F·Fᵀ."""
    left: Remaining
    """What the fit left over."""

    @classmethod
    def of(cls, names: tuple[str, ...], half: np.ndarray, left: Remaining) -> Posterior:
        """The posterior whose covariance has any factor `half` (n, r)."""
        n = len(names)
        padded = np.vstack([half.T, np.zeros((max(0, n - half.shape[1]), n))])
        triangle = np.asarray(np.linalg.qr(padded, mode="r"))
        return cls(names, triangle[:n].T, left)

    @property
    def covariance(self) -> np.ndarray:
        """(n, n)."""
        return self.factor @ self.factor.T

    def to_table(self) -> dict[str, Any]:
        """The section [posterior] of a model file."""
        below = self.factor[np.tril_indices(len(self.names))].astype("<f4")
        return {
            "unknowns": list(self.names),
            **self.left.to_table(),
            "factor_f32": base64.b64encode(below.tobytes()).decode("ascii"),
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any], names: tuple[str, ...]) -> Posterior:
        """The posterior in the section [posterior] of a model file.

        Args:
            names: the unknowns that the model has.

        Raises:
            InputError: it belongs to other unknowns, or is damaged.
        """
        if table.get("unknowns") != list(names):
            raise InputError("posterior: its unknowns are not those of the model", remedy=REMEDY)
        text, left = table.get("factor_f32"), Remaining.from_table(table)
        if not isinstance(text, str):
            raise InputError("posterior: factor_f32 is missing", remedy=REMEDY)
        try:
            below = np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(float)
        except (binascii.Error, ValueError):
            raise InputError("posterior: factor_f32 is damaged", remedy=REMEDY) from None
        n = len(names)
        if len(below) != n * (n + 1) // 2 or not np.isfinite(below).all():
            raise InputError("posterior: factor_f32 does not fit the model", remedy=REMEDY)
        factor = np.zeros((n, n))
        factor[np.tril_indices(n)] = below
        return cls(names, factor, left)
