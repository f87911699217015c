"""Whether residuals are larger than noise at all, before asking why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.screen import Screen


@dataclass(frozen=True)
class Misfit:
    """Residuals of the fit rows against the noise."""

    chi2_dof: float
    """Per degree of freedom left after geometry, frame and effects of the model."""
    dof: int
    p: float
    """Probability of a larger misfit from noise alone; with replicates the lack-of-fit F test."""

    @property
    def times_noise(self) -> float:
        """Residuals in units of the noise."""
        return float(np.sqrt(self.chi2_dof))


def misfit(screen: Screen) -> Misfit:
    """The misfit of a model against the noise level of its problem.

    Where that level was read off what no group holds, only what groups hold is tested against it: else the same
    residuals would stand above and below the line.
    """
    total, dof = float(screen.residual @ screen.residual), screen.free
    if dof < 1:
        return Misfit(float("nan"), 0, 1.0)
    T, d = (float(screen.y @ screen.y), len(screen.y)) if screen.left is None else (total, dof)
    return Misfit(total / dof, dof, float(screen.p_value(T, d)) if d else 1.0)
