"""What a fit leaves over: how noisy its readings were, and how far the model misses rows that it was not fitted to.

Three things make the residuals of a later session larger than the stated σ. The instrument may be worse than stated,
joints may repeat badly, which shows in all readings of a row together (`pcalib.fitting.noise_level`), and the model may
be wrong where it was not fitted. The last is seen on blocks of rows that are left out in turn. With whitened
residuals y and their hat matrix H, those of a block B that was left out have the covariance (I − H_BB)⁻¹, so that

    χ²_B = y_Bᵀ·(I − H_BB)⁻¹·y_B  ~  χ²(n_B)

where the model is right. Blocks are rows that follow each other, as a later session follows them: rows at random lie
between rows that were fitted, and the model is best there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.fitting import memory as memories
from pcalib.fitting import noise_level
from pcalib.fitting.identifiability import span
from pcalib.fitting.linearisation import ROWS, joint_response, linearise
from pcalib.fitting.noise_level import Blocks
from pcalib.fitting.unknowns import Unknowns
from pcalib.model import Model
from pcalib.posterior import Remaining

ENOUGH = 20
"""Degrees of freedom per class of readings from which on their scatter says how large the noise is: to a sixth."""
FOLDS = (3, 5, 7)
"""Numbers of blocks that are left out in turn; the worst counts. A later session may lie elsewhere as a third of the
first one does, and more blocks show better whether they differ."""
SMALLEST = 4
"""Rows of a block."""
CLEAR = 3.0
"""σ by which χ² of blocks that were left out must lie above the noise to be a misfit of the model."""
RARE = 0.01
"""Chance at which blocks count as different from each other."""
VISIBLE = 0.05
"""Noise units per prior σ below which a direction is held by its prior, as in a diagnosis."""


@dataclass(frozen=True, eq=False)
class Doubt:
    """What is left over after a fit, and how well its unknowns are known with that noise."""

    left: Remaining
    unknowns: np.ndarray
    """(n, r) factor of the covariance of the fit's unknowns [SI]."""


def remaining(model: Model, data: Measurements, unknowns: Unknowns, half: np.ndarray, noise: Noise) -> Doubt | None:
    """What is left over after a fit.

    Args:
        data: the fitted rows.
        half: (n, r) factor of the covariance as the stated noise has it.
        noise: of the fitted rows; `measured` holds the readings that count.

    None where there are so many rows that their Jacobian is not kept, or too few readings to say anything.
    """
    if len(data) > ROWS or not np.isfinite(half).all():
        return None
    data = replace(data, mask=noise.measured)
    linear = linearise(model, data, unknowns, noise=noise)
    row, component = linear.row, linear.component

    def scatter(columns: np.ndarray) -> np.ndarray:
        """(M, p) as (N, 6, p)."""
        out = np.zeros((len(data), 6, columns.shape[1]))
        out[row, component] = columns
        return out

    joints = noise.padded(np.nan_to_num(joint_response(model, data, linear.prediction.pose)))
    blocks = Blocks(noise.measured, scatter(linear.residual[:, None])[..., 0], joints)
    taken = span(linear.jacobian * unknowns.scale, VISIBLE)
    level = noise_level.from_rest(data, blocks, noise_level.left_over(blocks, scatter(taken)), ENOUGH)
    if level is None:
        return None
    whitener = noise_level.whitener(level, blocks)

    def turned(columns: np.ndarray) -> np.ndarray:
        return (whitener @ scatter(columns))[row, component]

    seen = linear.jacobian @ half
    inverse = np.eye(half.shape[1]) - seen.T @ seen  # of the prior, in the coordinates of `half`
    white, y = turned(seen), turned(linear.residual[:, None])[:, 0]
    normal, slope = white.T @ white + inverse, white.T @ y - seen.T @ linear.residual
    hat = white @ np.linalg.solve(normal, white.T)
    dof = float(np.sum(level.dof[np.isfinite(level.dof)]))
    rest = y - white @ np.linalg.solve(normal, slope)
    misfit, dof = _left_out(rest, hat, row, len(data), dof)

    # The fit's weights stay what they were: sandwich covariance.
    columns = scatter(seen)
    spread = np.einsum("nia,nij,njb->ab", columns, noise_level.covariance(level, blocks), columns)
    serial = memories.of_residuals(data, rest, np.linalg.qr(turned(taken))[0], row, component)
    if serial is not None:
        spread += serial.added_covariance(data, columns * np.repeat(level.ratio, 3)[:, None])
    values, vectors = np.linalg.eigh(0.5 * (inverse + spread + (inverse + spread).T))
    own = half @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return Doubt(Remaining(level.ratio, level.sigma_q, misfit, dof), own)


def _left_out(y: np.ndarray, hat: np.ndarray, row: np.ndarray, rows: int, dof: float) -> tuple[float, float]:
    """Variance of rows that were left out over that of the noise, that of the worst block where blocks differ, and 1
    where it is not clearly larger; and its degrees of freedom, fewer where blocks differ."""
    from scipy.special import chdtri

    misfit, differ = 1.0, 0.0
    for folds in FOLDS:
        if rows < SMALLEST * folds:
            continue
        each, size = np.zeros(folds), np.zeros(folds)
        for fold, block in enumerate(np.array_split(np.arange(rows), folds)):
            inside = np.flatnonzero(np.isin(row, block))
            size[fold] = max(len(inside), 1)
            each[fold] = y[inside] @ np.linalg.solve(np.eye(len(inside)) - hat[np.ix_(inside, inside)], y[inside])
        ratio = float(each.sum() / size.sum())
        chance = 2 * ratio**2 / size.mean()
        seen = float(np.var(each / size, ddof=1))
        if (folds - 1) * seen / chance > chdtri(folds - 1, RARE):  # a later session may lie where the worst block lies
            misfit, differ = max(misfit, float(np.max(each / size))), max(differ, (seen - chance) / ratio**2)
        elif ratio > 1 + CLEAR * np.sqrt(2 / dof):
            misfit = max(misfit, ratio)
    return misfit, float(2 / (differ + 2 / dof))
