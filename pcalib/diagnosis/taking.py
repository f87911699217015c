"""Which rows of a large file a diagnosis looks at.

Its tests weigh every reading against everything that may be missing: some 250 columns. A few thousand rows show what is
a thirtieth of their noise; of more rows those are taken that stand for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pcalib.data import replicates
from pcalib.data.measurement import Measurements
from pcalib.fitting.drawing import spaced

MOST = 2000
"""Rows that are looked at, about: 12,000 readings, in which 3 % of the noise is seen with five standard errors."""
STRETCH = 40
"""Rows that follow on each other, so that noise which is correlated in time is seen: more than twice the longest time
that is tried."""
LONG = 0.4
"""Share of the rows in such stretches. The others are pairs: where an instrument reads each pose a hundred times, long
stretches would show few poses."""
EACH = 50
"""Rows of every station, payload, tool or direction: a tenth of that tells whether it differs by its noise."""
FEW = 20
"""Values of a column up to which it is taken for a condition that was chosen, and not for something that varies."""
REPEATED = 200
"""Replicate groups that are taken whole: they give the noise to 4 %."""


def taken(data: Measurements, most: int = MOST) -> np.ndarray:
    """Rows to look at, ascending; all of them where there are no more than `most`.

    Long stretches and pairs of rows that are spread evenly over the file, some of every condition that is rare, and the
    replicates that belong to them. Most of them follow on each other, which tells how far apart rows are in time.
    """
    n = len(data)
    if n <= most:
        return np.arange(n)
    long, short = int(LONG * most) // STRETCH, int((1 - LONG) * most) // 2
    rows = np.union1d(_stretches(n, max(long, 1), STRETCH), _stretches(n, max(short, 1), 2))
    for kind in _conditions(data):
        values, which, counts = np.unique(kind, axis=0, return_inverse=True, return_counts=True)
        if 1 < len(values) <= FEW:
            which, have = which.ravel(), np.bincount(which.ravel()[rows], minlength=len(values))
            for value in np.flatnonzero(have < np.minimum(EACH, counts)):
                rows = np.union1d(rows, spaced(np.flatnonzero(which == value), EACH))
    group = replicates.groups(data)
    repeated = spaced(np.unique(group[rows][group[rows] >= 0]), REPEATED)
    members = np.flatnonzero(np.isin(group, repeated))
    order = members[np.argsort(group[members], kind="stable")]
    first = np.searchsorted(group[order], group[order])
    return data.whole(np.union1d(rows, order[np.arange(len(order)) - first < 3]))


def _conditions(data: Measurements) -> Iterator[np.ndarray]:
    """(N,) or (N, m) what may be different for a few rows only."""
    yield data.mask
    yield data.tool
    yield data.payload
    yield from data.columns.values()
    if data.readings is not None:
        place = np.zeros(len(data), int)
        for i, (_, _, rows) in enumerate(data.readings.parts):
            place[rows] = i + 1
        yield place


def _stretches(n: int, count: int, length: int) -> np.ndarray:
    """Rows in stretches that are evenly spread over n rows, ascending."""
    first = np.linspace(0, n - length, count).astype(int)
    return np.unique(first[:, None] + np.arange(length))
