"""One step of a regularised linear least-squares problem, by QR."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgeqrf, dgeqrt, dtrtri, dtrtrs  # pyright: ignore[reportAttributeAccessIssue]

_BLOCK = 8
"""Columns at a time; on tall matrices of some hundred rows dgeqrt takes half of dgeqrf's time."""
_TURNS = 10
"""Changes of the active set per unknown after which a bounded search ends: only rounding makes so many."""
_FLAT = 1e-12
"""Share of |y| that counts as no slope: some rounding."""


def triangle(J: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Triangular factor of [J y], (min(M, n + 1), n + 1): what least squares can learn of all M rows."""
    if not J.shape[0]:
        return np.zeros((0, J.shape[1] + 1))
    A = np.empty((J.shape[0], J.shape[1] + 1), order="F")
    A[:, :-1], A[:, -1] = J, y
    return np.triu(dgeqrt(min(_BLOCK, *A.shape), A, overwrite_a=True)[0][: A.shape[1]])


def with_priors(rows: np.ndarray, pull: np.ndarray, prior: np.ndarray, damping: float = 0.0) -> np.ndarray:
    """The rows (M, n + 1) and, below them, one for each of the first unknowns that has a prior, and damping of all."""
    M, n = len(rows), rows.shape[1] - 1
    held = np.flatnonzero(np.isfinite(prior))
    A = np.zeros((M + len(held) + (n if damping else 0), n + 1), order="F")
    A[:M] = rows
    beside = M + np.arange(len(held))
    A[beside, held] = 1 / prior[held]
    A[beside, n] = pull[held] / prior[held]
    if damping:
        A[M + len(held) + np.arange(n), np.arange(n)] = np.sqrt(damping)
    return A


def solve(rows: np.ndarray, pull: np.ndarray, prior: np.ndarray, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Minimise |y − J·s|² + Σ((pull − s)/prior)² + damping·|s|²; returns the step s and the triangular factor R.

    RᵀR = JᵀJ + diag(1/prior²) + damping·I is the information matrix, which is never formed.

    Args:
        rows: (M, n + 1) [J y], whitened, or their :func:`triangle`.
        pull: (n,) where the priors draw the step to.
        prior: (n,) 1σ; inf where there is none.
    """
    n = len(pull)
    if n == 0:
        return np.zeros(0), np.zeros((0, 0))
    QR = dgeqrf(with_priors(rows, pull, prior, damping), overwrite_a=True)[0]
    R = np.triu(QR[:n, :n])
    step, info = dtrtrs(R, QR[:n, n])
    return (step if info == 0 else np.full(n, np.nan)), R


def descend(R: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The Gauss–Newton step (RᵀR)⁻¹·slope, from a factor R of the information found elsewhere nearby."""
    if len(slope) == 0:
        return slope
    half, info = dtrtrs(R, slope, trans=1)
    return dtrtrs(R, half)[0] if info == 0 else np.full_like(slope, np.nan)


def within(R: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The least-squares step within bounds, from the triangular factor and the free step; `low` ≤ 0 ≤ `high`."""
    return bounded(R, R @ step, np.minimum(low, 0.0), np.maximum(high, 0.0))  # a start may be a rounding outside


def bounded(A: np.ndarray, y: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimise |y − A·x|² over low ≤ x ≤ high by active sets (Stark & Parker 1995); returns x (n,).

    SciPy's optimisers do the same, and take twice as long to import as NumPy.

    Args:
        A: (M, n), y: (M,), low, high: (n,), -inf and inf where there is no bound.
    """
    x = np.clip(np.linalg.lstsq(A, y, rcond=None)[0], low, high)
    free = (low < x) & (x < high)
    size = np.linalg.norm(A, axis=0)
    for _ in range(_TURNS * len(x)):
        move = np.zeros(len(x))
        move[free] = np.linalg.lstsq(A[:, free], y - A @ x, rcond=None)[0]
        bound = np.where(move > 0, high, low)
        share = np.divide(bound - x, move, out=np.ones(len(x)), where=move != 0)
        least = share.min(initial=1.0)
        stopped = (share == least) & (least < 1)
        x = np.where(stopped, bound, x + least * move)
        free &= ~stopped
        if stopped.any():
            continue
        slope = A.T @ (y - A @ x)  # of what moving inward from a bound gains
        gain = np.where(free | (low == high), 0.0, np.where(x >= high, -slope, slope))
        if np.all(gain <= _FLAT * size * np.linalg.norm(y)):
            break
        free[np.argmax(gain)] = True
    return x


def variances(R: np.ndarray) -> np.ndarray:
    """Diagonal of (RᵀR)⁻¹ (n,)."""
    return np.sum(root(R) ** 2, axis=1)


def root(R: np.ndarray) -> np.ndarray:
    """R⁻¹, a square root of the covariance: (RᵀR)⁻¹ = root·rootᵀ. NaN where R is singular."""
    if R.size == 0:
        return R
    inverse, info = dtrtri(R)
    return np.triu(inverse) if info == 0 else np.full_like(R, np.nan)
