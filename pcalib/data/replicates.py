"""Replicates: rows that measure one command again under the same conditions, and the noise that they show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.data.columns import TEMPERATURES
from pcalib.data.measurement import Measurements

COMMAND_AGREES = 1e-6
"""[rad or m] commands closer than this are one command: less than a micrometre at the plate."""
TEMPERATURE_AGREES = 0.5
"""[°C] closer than this, growth stays below the noise of a good instrument (4 µm on a 350 mm aluminium arm)."""


@dataclass(frozen=True)
class ReplicateScatter:
    """Scatter of replicates about their own mean, pooled over all of them; NaN where nothing was repeated."""

    sigma_pos: float
    """[m] per component."""
    sigma_rot: float
    """[rad] per component."""
    dof_pos: int
    dof_rot: int
    ratio_pos: float
    """Scatter over stated σ."""
    ratio_rot: float
    groups: int
    rows: int


def groups(data: Measurements) -> np.ndarray:
    """(N,) int, number of the replicate group of each row; −1 where a row is no replicate.

    Rows of one `pose_id` are replicates only where command, payload, tool, direction and temperature agree, and one
    sensor read them.
    """
    n = len(data)
    read = () if data.readings is None else (data.readings.sensor, data.readings.to)
    directions = (data.columns[c] for c in sorted(data.columns) if c.startswith("dir") and c[3:].isdigit())
    exact = [data.pose_id, *read, *directions]
    near = [(values, COMMAND_AGREES) for values in (*data.q.T, *data.tool.T)] + [(data.payload, 1e-6)]
    near += [(data.columns[c], TEMPERATURE_AGREES) for c in TEMPERATURES if c in data.columns]
    keys = list(zip(*(values.tolist() for values in exact), strict=True))
    values = list(zip(*(values.tolist() for values, _ in near), strict=True))
    slack = [s for _, s in near]
    # Rows that agree differ by less than one here; rows that do not agree hardly ever share a cell or neighbour one.
    weights = np.random.default_rng(0).uniform(0.5, 1.0, len(near))
    cell = np.floor(0.999 / weights.sum() * sum(w * v / s for w, (v, s) in zip(weights, near, strict=True))).tolist()
    out = np.full(n, -1)
    found: dict[tuple, list[int]] = {}  # key and cell → first row of every group
    for row in range(n):
        if keys[row][0] < 0:
            continue
        for first in sorted(f for c in (-1, 0, 1) for f in found.get((keys[row], cell[row] + c), ())):
            if all(abs(a - b) <= s for a, b, s in zip(values[first], values[row], slack, strict=True)):
                out[row] = out[first]
                break
        else:
            found.setdefault((keys[row], cell[row]), []).append(row)
            out[row] = row
    names, index, counts = np.unique(out, return_inverse=True, return_counts=True)
    keep = (counts > 1) & (names >= 0)
    number = np.where(keep, np.cumsum(keep) - 1, -1)
    return number[index]


def noise(data: Measurements) -> ReplicateScatter:
    """The noise that the replicates of a file show, component by component, in the measuring frame."""
    group = groups(data)
    rows = np.flatnonzero(group >= 0)
    sub, group = data.take(rows), group[rows]
    count = int(group.max(initial=-1)) + 1

    first = np.zeros(count, int)
    first[group[::-1]] = np.arange(len(group))[::-1]
    apart = sub.beside(sub.take(first[group]))

    pos, dof_pos, ratio_pos = _pooled(apart[:, :3], sub.sigma[:, :3], group, count)
    rot, dof_rot, ratio_rot = _pooled(apart[:, 3:], sub.sigma[:, 3:], group, count)
    return ReplicateScatter(pos, rot, dof_pos, dof_rot, ratio_pos, ratio_rot, count, len(rows))


def _pooled(values: np.ndarray, sigma: np.ndarray, group: np.ndarray, count: int) -> tuple[float, int, float]:
    """Scatter about the group means of all components, its degrees of freedom, and its ratio to σ."""
    square = weighed = 0.0
    dof = 0
    for component, s in zip(values.T, sigma.T, strict=True):
        seen = ~np.isnan(component)
        g, v = group[seen], component[seen]
        n = np.bincount(g, minlength=count)
        mean = np.bincount(g, v, minlength=count) / np.maximum(n, 1)
        error2 = (v - mean[g]) ** 2
        square += float(error2.sum())
        weighed += float((error2 / s[seen] ** 2).sum())
        dof += int((n[n > 0] - 1).sum())
    if dof == 0:
        return np.nan, 0, np.nan
    return float(np.sqrt(square / dof)), dof, float(np.sqrt(weighed / dof))
