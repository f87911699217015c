"""Whether residuals are larger than noise at all, before asking why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.screen import KNOWN, NUISANCE, project_out, span


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


def misfit(made: Problem) -> Misfit:
    """The misfit of a model against the noise level of its problem."""
    from scipy.special import chdtrc, fdtrc

    U = span(made.nuisance, NUISANCE)
    rest = project_out(made.y, U)
    dof = len(rest) - U.shape[1]
    if dof < 1:
        return Misfit(float("nan"), 0, 1.0)
    T = float(rest @ rest)
    nu = float(np.sum(made.noise.dof[np.unique(made.classes)]))
    p = chdtrc(dof, T) if not nu < KNOWN else fdtrc(dof, nu, T / dof)
    return Misfit(T / dof, dof, float(p))
