"""Rows that no effect, pattern or noise explains: reported as a finding, and set aside for the other tests.

A row is judged by what is left of it outside everything smooth, so that a missing effect makes no outliers; rows are
taken out one at a time, the worst first, because a gross one drags its neighbours along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RARE = 1e-6
"""Chance that a good data set has a single row flagged."""
MOST = 0.05
"""Share of the rows up to which they are set aside; more are no outliers but a misfit."""


@dataclass(frozen=True)
class Outliers:
    """Rows far off, worst first."""

    rows: np.ndarray
    """(n,) indices into the fit rows."""
    size: np.ndarray
    """(n,) length of the row's residual, in robust noise units per component."""
    too_many: bool = False
    """More rows than outliers can be; none is set aside."""


def find(y: np.ndarray, Q: np.ndarray, row: np.ndarray, n_rows: int) -> Outliers:
    """Rows far off.

    Args:
        y: (M,) whitened residuals.
        Q: (M, d) orthonormal basis of everything that may explain them.
        row: (M,) pose of each reading.
        n_rows: N.
    """
    from scipy.special import chdtrc, chdtri

    rest = y - Q @ (Q.T @ y)
    members = [np.flatnonzero(row == n) for n in range(n_rows)]
    taken: list[int] = []
    sizes: list[float] = []
    limit = max(1, int(MOST * n_rows))
    while len(taken) <= limit:
        T, d = np.zeros(n_rows), np.zeros(n_rows, int)
        for n, rows in enumerate(members):
            if n in taken or len(rows) == 0:
                continue
            q = Q[rows]
            free, V = np.linalg.eigh(np.eye(len(rows)) - q @ q.T)
            keep = free > 0.1
            T[n], d[n] = np.sum((V[:, keep].T @ rest[rows]) ** 2 / free[keep]), keep.sum()
        known = d > 0
        if known.sum() < 10:
            break
        middle = np.median(T[known] / chdtri(d[known], 0.5))
        scale = max(float(middle), 1e-12)
        p = np.ones(n_rows)
        p[known] = chdtrc(d[known], T[known] / scale)
        # Rows of few readings are rarely far off; where p of several underflows, the farthest off is the worst.
        worst = int(np.lexsort((-T / np.maximum(d, 1), p))[0])
        if p[worst] * n_rows > RARE:
            break
        taken.append(worst)
        sizes.append(float(np.sqrt(T[worst] / scale / d[worst])))
        # From now on this row explains itself.
        own = np.zeros((len(y), len(members[worst])))
        own[members[worst], np.arange(len(members[worst]))] = 1.0
        own -= Q @ (Q.T @ own)
        U, s, _ = np.linalg.svd(own, full_matrices=False)
        Q = np.hstack([Q, U[:, s > 0.05]])
        rest = y - Q @ (Q.T @ y)
    return Outliers(np.array(taken, int), np.array(sizes), len(taken) > limit)
