"""What a fit takes up of an error that all readings share: a metre of the instrument that is not a metre.

An instrument whose metre is too long by κ reads lengths L as (1 + κ)·L. A fit of whitened residuals y with
derivatives J and information RᵀR then moves by (RᵀR)⁻¹·Jᵀ·∂y/∂κ·κ, mostly into a robot that is larger by the same
ratio, and no residual is left that would show it. So it has to be known from elsewhere: from the certificate of the
instrument, which a file states as `sigma_scale_ppm` (a type B component, JCGM 100:2008 4.3).
"""

from __future__ import annotations

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.fitting import least_squares
from pcalib.fitting.linearisation import chunks, linearise
from pcalib.fitting.minimisation import Task
from pcalib.model import Model


def of_scale(task: Task, model: Model, R: np.ndarray, data: Measurements, noise: Noise) -> np.ndarray:
    """(n, 1) change of all unknowns [SI] by one σ of the instrument's scale; (n, 0) where none is stated.

    Args:
        R: triangular factor of the information of the chosen unknowns in natural sizes.
        data, noise: the fitted rows.
    """
    unknowns, chosen = task.unknowns, task.chosen
    if not data.sigma_scale:
        return np.zeros((len(unknowns.names), 0))
    slope = np.zeros(len(chosen))
    for part in chunks(len(data)):
        rows, now = data.take(part), noise.take(part)
        linear = linearise(model, rows, unknowns, noise=now)
        longer = np.nan_to_num(rows.values) * ([1.0] * 3 + [0.0] * 3)
        slope += task.scale * (linear.jacobian[:, chosen].T @ now.whiten(data.sigma_scale * longer))
    out = np.zeros((len(unknowns.names), 1))
    out[chosen, 0] = task.scale * least_squares.descend(R, slope)
    return out
