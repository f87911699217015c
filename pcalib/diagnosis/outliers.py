"""Rows that no effect, pattern or noise explains: reported as a finding, and set aside for the other tests.

Gross rows first, as what the model has leaves them: among hundreds of patterns they would hide behind one another. Then
every row is judged by what is left of it outside everything smooth, so that a missing effect makes no outliers. Rows
are taken out one at a time, the worst first, because one drags its neighbours along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.screen import outside

RARE = 1e-6
"""Chance that a good data set has a single row flagged."""
GROSS = 10.0
"""Times the size of half of all rows from which a row is gross, whatever is missing from the model."""
MOST = 0.05
"""Share of the rows up to which they are the odd ones out; more are a finding beside which nothing passes for right."""
MANY = 0.2
"""Share of the rows up to which they are set aside; more are no outliers but a misfit."""


@dataclass(frozen=True)
class Outliers:
    """Rows far off, worst first."""

    rows: np.ndarray
    """(n,) indices into the fit rows."""
    size: np.ndarray
    """(n,) length of the row's residual, in robust noise units per component."""
    too_many: bool = False
    """More rows than may go wrong by chance."""
    kept: bool = False
    """More rows than outliers can be: none is set aside."""

    @property
    def single(self) -> bool:
        """Whether they are few and no two stand side by side: wild rows, and not a time at which something happened."""
        return not self.too_many and bool(np.all(np.diff(np.sort(self.rows)) > 1))


def find(y: np.ndarray, Q: np.ndarray, row: np.ndarray, n_rows: int, nuisance: np.ndarray | None = None) -> Outliers:
    """Rows far off.

    Args:
        y: (M,) whitened residuals.
        Q: (M, d) orthonormal basis of everything that may explain them.
        row: (M,) pose of each reading.
        n_rows: N.
        nuisance: (M, r) orthonormal basis of what the model has already; gross rows are not looked for where absent.
    """
    from scipy.special import chdtrc

    most, limit = (max(1, int(share * n_rows)) for share in (MOST, MANY))
    taken: list[int] = []
    sizes: list[float] = []
    for basis, gross in ((nuisance, True), (Q, False)):
        if basis is None:
            continue
        for r in taken:
            basis = _with(basis, row == r)
        while len(taken) <= limit:
            T, d, scale = _left(y, basis, row, n_rows)
            T[taken] = d[taken] = 0
            if (d > 0).sum() < 10:
                break
            size = np.sqrt(T / np.maximum(d, 1) / scale)
            # Rows of few readings are rarely far off; where p of several underflows, the farthest off is the worst.
            p = np.where(d > 0, chdtrc(np.maximum(d, 1), T / scale), 1.0)
            worst = int(np.lexsort((-size, p))[0])
            if not (size[worst] > GROSS if gross else p[worst] * n_rows < RARE):
                break
            taken.append(worst)
            sizes.append(float(size[worst]))
            basis = _with(basis, row == worst)  # from now on this row explains itself
    return Outliers(np.array(taken, int), np.array(sizes), len(taken) > most, len(taken) > limit)


def _with(basis: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """The basis (M, d) and whatever some readings (M,) bool show by themselves."""
    mine = np.flatnonzero(readings)
    each = np.zeros((len(readings), len(mine)))
    each[mine, np.arange(len(mine))] = 1.0
    return np.hstack([basis, outside(each, basis)])


def _left(y: np.ndarray, Q: np.ndarray, row: np.ndarray, n_rows: int) -> tuple[np.ndarray, np.ndarray, float]:
    """By row: the square sum T (N,) outside Q as if the row had not been fitted, and its degrees of freedom d (N,); and
    the scale of the noise for which half of all rows look like noise."""
    from scipy.special import chdtri

    rest = y - Q @ (Q.T @ y)
    T, d = np.zeros(n_rows), np.zeros(n_rows, int)
    for n in range(n_rows):
        rows = np.flatnonzero(row == n)
        if not len(rows):
            continue
        q = Q[rows]
        free, V = np.linalg.eigh(np.eye(len(rows)) - q @ q.T)
        keep = free > 0.1
        T[n], d[n] = np.sum((V[:, keep].T @ rest[rows]) ** 2 / free[keep]), keep.sum()
    known = d > 0
    scale = float(np.median(T[known] / chdtri(d[known], 0.5))) if known.any() else 1.0
    return T, d, max(scale, 1e-12)
