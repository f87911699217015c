"""Correlation of the noise in time.

Everything here works on residuals y (M,) that are whitened by the noise level, and on what is left of them outside an
orthonormal basis Q (M, d) of everything that may explain them. In time, noise may be white in part and an
Ornstein–Uhlenbeck process in part,

    cov(y_i, y_j) = s²·[(1 − ρ)·δ_ij + ρ·exp(−|t_i − t_j|/τ)]    for readings of one component, ρ by class

Whether there is any is asked of the quadratic form yᵀPKPy with K the off-diagonal exponentials and P = I − QQᵀ, whose
mean is s²·[tr PK + ρ·tr PKPK] (Rao 1971). How much there is says the restricted likelihood (Patterson & Thompson 1971),
with only the model allowed for: smooth patterns of time would take most of what is correlated with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.data import replicates
from pcalib.data.measurement import Measurements

TIMES = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Correlation times that are tried, in rows: shorter ones are nearly white, longer ones a drift that patterns hold."""
SURE = 6.0
"""Standard errors of ρ, outside what the model has, from which residuals count as correlated."""
SOME = 2.2
"""Standard errors of ρ, outside everything slow that may be missing too, from which that is the noise: a missing slow
effect is correlated in the first sense, and in this one by chance alone. Noise half of which is correlated over six
rows reaches 2.2–6.4 in 120 rows."""
FOLLOWING = 3.0
"""Standard errors of the sum of products of consecutive residuals from which the full test is worth its time."""
ROUNDS = 12
"""Most scoring steps; four to eight are usual."""
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
    """Time over which the correlation falls to 1/e, in units of `time_of`."""
    share: tuple[float, float]
    """ρ of positions and of rotations."""

    def added_covariance(self, data: Measurements, columns: np.ndarray) -> np.ndarray:
        """What the correlation adds to the covariance (p, p) of the sums Fᵀz, z the noise of unit variance: the sum of
        ρ·Fᵀ(K − I)·F over the components.

        Args:
            columns: (N, 6, p) F, zero where a reading is not measured.
        """
        time = time_of(data)
        K = np.exp(-np.abs(time[:, None] - time) / self.tau)
        np.fill_diagonal(K, 0.0)
        return np.sum([self.share[c // 3] * columns[:, c].T @ K @ columns[:, c] for c in range(6)], axis=0)

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
    return not apart or float(np.median(apart)) < APART * _spacing(time)


def unordered(data: Measurements) -> bool:
    """Whether commands jump from row to row, so that errors which depend on the pose are not correlated in time."""
    q = data.q[np.argsort(time_of(data), kind="stable")]
    steps = q - q.mean(axis=0)
    return bool(np.mean(np.sum(steps[1:] * steps[:-1], axis=0) / np.sum(steps**2, axis=0)) < UNORDERED)


def memory(
    data: Measurements, y: np.ndarray, U: np.ndarray, Q: np.ndarray, row: np.ndarray, component: np.ndarray,
    excess: float = 0.0,
) -> Memory | None:  # fmt: skip
    """The correlation of the residuals in time; None where it is no more than chance gives.

    Args:
        y: (M,) whitened residuals.
        U: (M, r) orthonormal basis of what the model has.
        Q: (M, d) orthonormal basis of that and of all slow things that may be missing.
        row, component: (M,) of each reading.
        excess: by how much what is left outside Q scatters more than replicates, in standard errors: replicates that
            follow on each other share what is correlated.
    """
    time = time_of(data)
    spacing = _spacing(time)
    if spacing <= 0 or len(y) - Q.shape[1] < 30:
        return None
    more = excess if close(data) else -np.inf
    if not _correlated(y, U, Q, time / spacing, np.stack([row, component]), data, more):
        return None
    # What depends on the pose is correlated too where commands follow a path: it is allowed for with the rest.
    basis = U if unordered(data) else Q
    return _most_likely(y, basis, time[row], spacing, component)


def of_residuals(
    data: Measurements, y: np.ndarray, U: np.ndarray, row: np.ndarray, component: np.ndarray
) -> Memory | None:
    """The correlation of the residuals of a fit; None where it may be chance.

    Noise and a slow effect that is missing are not told apart: with either, the unknowns of the fit are less certain
    than independent readings would make them.

    Args:
        y: (M,) whitened residuals of the fitted rows.
        U: (M, r) orthonormal basis of what the fit has taken up.
        row, component: (M,) of each reading.
    """
    time = time_of(data)
    if not _follows(y, time, np.stack([row, component])) or not stands_out(data, y, U, row, component):
        return None
    return _most_likely(y, U, time[row], _spacing(time), component)


def stands_out(data: Measurements, y: np.ndarray, U: np.ndarray, row: np.ndarray, component: np.ndarray) -> bool:
    """Whether the residuals of a fit are correlated in time by more than chance, whatever the cause.

    Args:
        y, U, row, component: as in :func:`of_residuals`.
    """
    time = time_of(data)
    spacing = _spacing(time)
    if spacing <= 0 or len(y) - U.shape[1] < 30:
        return False
    pose, where = _poses(data), np.stack([row, component])
    return any(_beyond(y, U, time / (rows * spacing), pose, where) > SURE for rows in TIMES)


def _follows(y: np.ndarray, time: np.ndarray, where: np.ndarray) -> bool:
    """Whether residuals of consecutive rows are correlated at all: a cheap test before the full one."""
    values = np.zeros((len(time), 6))
    values[where[0], where[1]] = y
    values = values[np.argsort(time, kind="stable")]
    return bool(np.sum(values[1:] * values[:-1]) > FOLLOWING * np.sqrt(np.sum(values[1:] ** 2 * values[:-1] ** 2)))


def _most_likely(
    y: np.ndarray, basis: np.ndarray, time: np.ndarray, spacing: float, component: np.ndarray
) -> Memory | None:
    """The correlation of the largest likelihood over all correlation times; None where its share of the noise is 0.

    Args:
        basis: (M, r) orthonormal basis of what is allowed for.
        time: (M,) of each reading.
        spacing: usual time between rows.
    """
    fits = [_fitted(y, basis, time / (rows * spacing), component) for rows in TIMES]
    best = int(np.argmax([likelihood for likelihood, _ in fits]))
    share = fits[best][1]
    return Memory(TIMES[best], TIMES[best] * spacing, (float(share[0]), float(share[1]))) if share.any() else None


def _beyond(y: np.ndarray, basis: np.ndarray, time: np.ndarray, pose: np.ndarray, where: np.ndarray) -> float:
    """ρ outside a basis in its standard errors, positions and rotations taken together, at one correlation time."""
    rest = y - basis @ (basis.T @ y)
    some = [_standing_out(rest, basis, time, pose, where, half) for half in range(2)]
    known = [value for value in some if value is not None]
    return sum(known) / float(np.sqrt(max(len(known), 1)))


def _spacing(time: np.ndarray) -> float:
    """Usual time between rows."""
    return float(np.median(np.diff(np.sort(time))))


def _poses(data: Measurements) -> np.ndarray:
    """(N,) number of the commanded pose of each row; replicates share one."""
    return np.unique(np.round(data.q, 9), axis=0, return_inverse=True)[1].ravel()


def _correlated(
    y: np.ndarray, U: np.ndarray, Q: np.ndarray, time: np.ndarray, where: np.ndarray, data: Measurements, more: float
) -> bool:
    """Whether residuals are correlated in time, positions and rotations taken together.

    Args:
        time: (N,) in rows.
        where: (2, M) row and component of each reading.
        more: standard errors by which replicates speak for it too; −inf where they say nothing.
    """
    pose = _poses(data)
    for rows in TIMES:
        z = [_beyond(y, basis, time / rows, pose, where) for basis in (U, Q)]
        if z[0] > SURE and max(z[1], (z[1] + more) / np.sqrt(2)) > SOME:
            return True
    return False


def _fitted(y: np.ndarray, basis: np.ndarray, time: np.ndarray, component: np.ndarray) -> tuple[float, np.ndarray]:
    """Restricted log-likelihood and ρ (2,) of positions and rotations at one correlation time, by scoring (REML).

    The covariance of one component is a·I + b·K with K the exponentials, and diagonal in the eigenbasis of K, so that
    a step costs no more than a few products with the basis.

    Args:
        basis: (M, r) of what is allowed for.
        time: (M,) of each reading, in correlation times.
    """
    y, basis, eigen = y.copy(), basis.copy(), np.zeros(len(y))
    at, values, vectors = np.zeros(0), np.zeros(0), np.zeros((0, 0))
    for c in np.unique(component):
        mine = np.flatnonzero(component == c)
        if not np.array_equal(at, time[mine]):  # most files have all components in the same rows
            at = time[mine]
            values, vectors = np.linalg.eigh(np.exp(-np.abs(at[:, None] - at)))
        eigen[mine] = np.maximum(values, 0.0)
        y[mine], basis[mine] = vectors.T @ y[mine], vectors.T @ basis[mine]
    half = component // 3
    parts = np.stack([(half == h) * v for h in range(2) for v in (np.ones(len(y)), eigen)])  # white and OU, by class
    here = [k for k in range(4) if (half == k // 2).any()]
    theta, total, likelihood = np.full(4, 0.5), np.ones(2), -np.inf
    for _ in range(ROUNDS):
        variance = theta @ parts
        root = 1 / np.sqrt(variance)
        inside, upper = np.linalg.qr(root[:, None] * basis)
        rest = root * y - inside @ (inside.T @ (root * y))
        likelihood = -0.5 * float(np.sum(np.log(variance)) + 2 * np.sum(np.log(np.abs(np.diag(upper)))) + rest @ rest)
        scaled = parts[here] / variance
        inner = np.stack([inside.T @ (s[:, None] * inside) for s in scaled])
        leverage = np.sum(inside**2, axis=1)
        fisher = scaled @ ((1 - 2 * leverage)[:, None] * scaled.T) + np.einsum("kij,mij->km", inner, inner)
        before = theta.copy()
        theta[here] = np.linalg.lstsq(fisher, scaled @ rest**2, rcond=None)[0]
        total = theta[0::2] + theta[1::2]
        theta = np.maximum(theta, np.repeat(np.maximum(total, 1e-3), 2) * np.tile([1 - LONGEST, 0.0], 2))
        if np.all(np.abs(theta - before) < 1e-2 * np.repeat(np.maximum(total, 1e-3), 2)):
            break
    share = np.where(total > 0, theta[1::2] / np.maximum(theta[0::2] + theta[1::2], 1e-12), 0.0)
    seen = np.array([(half == h).any() for h in range(2)])
    return likelihood, np.where(seen, np.clip(share, 0.0, LONGEST), 0.0)


def _standing_out(
    rest: np.ndarray, Q: np.ndarray, time: np.ndarray, pose: np.ndarray, where: np.ndarray, half: int
) -> float | None:
    """ρ of one class in its standard errors, at one correlation time; None where too little is known."""
    (row, component), KQ, form, square, count = where, np.zeros(Q.shape), 0.0, 0.0, 0
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
    return float(rho * np.sqrt(second / 2))
