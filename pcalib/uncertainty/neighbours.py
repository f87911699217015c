"""What is unexplained and alike in neighbouring conditions.

A missing effect is a smooth function of commands, loads and tool, and noise is not: residuals z of rows that are close
to each other go together. With K the closeness of rows, its diagonal 0, and P = I − H the covariance of the residuals
where nothing is missing, zᵀKz has the mean tr PK and the variance 2·tr PKPK, and a misfit of covariance s²·K adds
s²·tr PKPK to its mean (MINQUE, Rao 1971). The form zᵀKz shows effects that are too small for χ², in which the noise of
all readings counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.data.noise import Noise
from pcalib.fitting.identification import Fit
from pcalib.fitting.linearisation import linearise

FEWEST, MOST = 20, 200
"""Rows from which on neighbours are compared, and how many are at most: the time grows with their square."""
CLOSE = 0.35
"""Length scale of K, as a share of the range of commands, payload and tool: every row of a random plan of a few dozen
has some neighbours within it, and effects of loads and places are smooth over it."""


@dataclass(frozen=True)
class Shared:
    """What neighbours share of the residuals of positions."""

    errors: float
    """zᵀKz beyond its mean, in standard errors; 0 with too few rows."""
    sigma: float
    """[m] 1σ per component of the misfit s that explains zᵀKz; 0 where zᵀKz lies below its mean."""


def shared(fit: Fit, noise: Noise, usable: np.ndarray) -> Shared:
    """What neighbouring rows of those that were fitted share.

    Args:
        noise: of all rows (N), as it is stated or as replicates show it.
        usable: (N,) bool, rows that are predicted and not gross.
    """
    data = fit.data
    whole = noise.measured[:, :3].all(axis=1) & np.isfinite(fit.error[:, :3]).all(axis=1)
    rows = np.flatnonzero(~data.check & usable & whole)
    if len(rows) < FEWEST:
        return Shared(0.0, 0.0)
    rows = rows[:: -(-len(rows) // MOST)]
    now, some = noise.take(rows), data.take(rows)
    z = now.padded(np.nan_to_num(fit.error[rows]))[:, :3]
    P = _covariance(fit, rows)
    there = np.column_stack([some.q, some.payload, some.tool])
    spread = np.ptp(there, axis=0)
    there = there[:, spread > 0] / spread[spread > 0]
    K = np.exp(-0.5 * np.sum((there[:, None] - there) ** 2, axis=-1) / CLOSE**2)
    np.fill_diagonal(K, 0.0)
    PK = np.stack([P[:, c::3] @ K for c in range(3)], axis=-1).reshape(P.shape)
    square = float(np.sum(PK * PK.T))
    if not square > 0:
        return Shared(0.0, 0.0)
    more = float(np.sum(z * (K @ z)) - np.trace(PK))
    size = np.sqrt(max(more, 0.0) / square) * np.sqrt(np.mean(now.sigma[:, :3] ** 2))
    return Shared(more / np.sqrt(2 * square), float(size))


def _covariance(fit: Fit, rows: np.ndarray) -> np.ndarray:
    """(3n, 3n) covariance of the whitened residuals of positions at some rows (n,) where nothing is missing."""
    now = fit.noise.scaled(fit.scale.ratio).take(rows)
    linear = linearise(fit.candidate, fit.data.take(rows), fit.unknowns, noise=now)
    B = linear.padded[:, :3].reshape(3 * len(rows), -1)
    return np.eye(len(B)) - B @ fit.covariance @ B.T
