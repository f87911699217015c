"""Correlation of the noise in time.

Everything here works on residuals y (M,) that are whitened by the noise level, and on what is left of them outside an
orthonormal basis Q (M, d) of everything that may explain them. In time, noise may be white in part and an
Ornstein–Uhlenbeck process in part,

    cov(y_i, y_j) = s²·[(1 − ρ)·δ_ij + ρ·exp(−|t_i − t_j|/τ)]    for readings of one component, ρ by class

and with K the off-diagonal exponentials and P = I − QQᵀ, the quadratic forms yᵀPy and yᵀPKPy have the means s²·[tr P +
ρ·tr PK] and s²·[tr PK + ρ·tr PKPK] (Rao 1971).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.data import replicates
from pcalib.data.measurement import Measurements

TIMES = (2.0, 4.0, 8.0, 16.0)
"""Correlation times that are tried, in rows: shorter ones are nearly white, longer ones a drift that patterns hold."""
SURE = 6.0
"""Standard errors of ρ, outside what the model has, from which residuals count as correlated."""
SOME = 2.5
"""Standard errors of ρ, outside everything slow that may be missing too, from which that is the noise: a missing slow
effect is correlated in the first sense, and in this one by chance alone."""
APART = 4.0
"""Rows by which replicates must lie apart to show noise that is correlated over some rows."""
LONGEST = 0.95
"""Largest ρ: of readings that are all one process nothing would be left to judge by."""
UNORDERED = 0.3
"""Correlation of commands from row to row below which the poses come in no order."""


@dataclass(frozen=True)
class Memory:
    """Correlation in time."""

    rows: float
    """Rows over which the correlation falls to 1/e, at the usual distance of rows in time."""
    tau: float
    """The same in units of `time_of`."""
    share: tuple[float, float]
    """ρ of positions and of rotations."""

    def whitener(self, data: Measurements) -> list[np.ndarray]:
        """Per component the inverse Cholesky factor (n, n) of the correlation of its measured rows."""
        time, out = time_of(data), []
        for c in range(6):
            rho, t = self.share[c // 3], time[data.mask[:, c]]
            if rho == 0:
                out.append(np.eye(len(t)))
                continue
            C = rho * np.exp(-np.abs(t[:, None] - t) / self.tau) + (1 - rho) * np.eye(len(t))
            out.append(np.linalg.inv(np.linalg.cholesky(C)))
        return out


def time_of(data: Measurements) -> np.ndarray:
    """(N,) time of each row [s]; its line in the file where no time was recorded."""
    time = data.columns.get("time")
    if time is None or not np.isfinite(time).all() or np.ptp(time) == 0:
        return data.lines.astype(float)
    return time


def close(data: Measurements) -> bool:
    """Whether replicates follow so fast on each other that they do not show noise which changes over some rows."""
    group, time = replicates.groups(data), time_of(data)
    apart = [np.ptp(time[group == g]) for g in range(int(group.max(initial=-1)) + 1)]
    return not apart or float(np.median(apart)) < APART * float(np.median(np.diff(np.sort(time))))


def unordered(data: Measurements) -> bool:
    """Whether commands jump from row to row, so that errors which depend on the pose are not correlated in time."""
    q = data.q[np.argsort(time_of(data), kind="stable")]
    steps = q - q.mean(axis=0)
    return bool(np.mean(np.sum(steps[1:] * steps[:-1], axis=0) / np.sum(steps**2, axis=0)) < UNORDERED)


def memory(
    data: Measurements, y: np.ndarray, U: np.ndarray, Q: np.ndarray, row: np.ndarray, component: np.ndarray
) -> Memory | None:
    """The correlation of what is left over; None where it is no more than chance gives.

    Args:
        y: (M,) whitened residuals.
        U: (M, r) orthonormal basis of what the model has.
        Q: (M, d) orthonormal basis of that and of all slow things that may be missing.
        row, component: (M,) of each reading.
    """
    time = time_of(data)
    spacing = float(np.median(np.diff(np.sort(time))))
    if spacing <= 0 or len(y) - Q.shape[1] < 30:
        return None
    pose = np.unique(np.round(data.q, 9), axis=0, return_inverse=True)[1].ravel()
    best, share = 0.0, [0.0, 0.0]
    rows = TIMES[0]
    for tried in TIMES:
        found, strength = [0.0, 0.0], 0.0
        for half in range(2):
            first, second = (
                _forms(y - B @ (B.T @ y), B, time / (tried * spacing), pose, row, component, half) for B in (U, Q)
            )
            if first is not None and second is not None and first[0] > SURE and second[0] > SOME:
                found[half] = second[1]
                strength += second[0]
        if strength > best:
            best, rows, share = strength, tried, found
    if best == 0:
        return None
    return Memory(rows, rows * spacing, (min(share[0], LONGEST), min(share[1], LONGEST)))


def _forms(
    rest: np.ndarray,
    Q: np.ndarray,
    time: np.ndarray,
    pose: np.ndarray,
    row: np.ndarray,
    component: np.ndarray,
    half: int,
) -> tuple[float, float] | None:
    """(z, ρ) of one class at one correlation time."""
    KQ, form, square, count = np.zeros(Q.shape), 0.0, 0.0, 0
    for c in range(3 * half, 3 * half + 3):
        mine = np.flatnonzero(component == c)
        t = time[row[mine]]
        other = pose[row[mine]][:, None] != pose[row[mine]]  # what depends on the pose is alike in its replicates
        K = np.exp(-np.abs(t[:, None] - t)) * other
        KQ[mine] = K @ Q[mine]
        form += float(rest[mine] @ K @ rest[mine])
        square += float(np.sum(K**2))
        count += len(mine)
    mine = component // 3 == half
    inner = Q.T @ KQ
    first, second = -np.trace(inner), square - 2 * np.sum(KQ**2) + np.sum(inner**2)
    free = count - float(np.sum(Q[mine] ** 2))
    if free < 15 or second <= 0:
        return None
    scale = float(np.sum(rest[mine] ** 2)) / free
    rho = (form / scale - first) / second
    rho = (form / (scale / max(1 + rho * first / free, 0.1)) - first) / second
    return float(rho * np.sqrt(second / 2)), float(np.clip(rho, 0.0, 1.0))
