"""What has to be searched for: the cycles of a gear ripple, the row at which something steps or begins to creep.

The best of many tries fits noise too. Each search is repeated on draws of pure noise, to learn what it finds there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcalib import effects
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.screen import NUISANCE, Search, project_out, span
from pcalib.effects.base import Contribution
from pcalib.effects.gear_ripple import SCANNED, GearRipple

DRAWS = 256
"""Draws of pure noise on which the search is repeated, to learn what it finds by chance."""
NEIGHBOUR = 0.95
"""Weight of the two neighbours of a place in the sum of three probabilities. It is below one, so that the place itself
is chosen where its neighbours have no probability of their own."""
MARGIN = 3
"""Rows that must lie on either side of a step: one or two rows apart are outliers."""
ROWS = 1500
"""Rows among which a step is searched for at most; of more, every so many are places."""


@dataclass(frozen=True)
class Break:
    """Where something steps, or begins to creep, in the order of measurement."""

    channel: str
    """'actuator' or 'body'."""
    member: int
    """Index of the actuator; −1 for the body."""
    shape: str
    """'step', or 'slope': what begins to grow evenly with time."""
    row: int
    """First row after the break."""
    columns: np.ndarray
    """(N, 6, p) derivative of the readings [m, rad] by the size of the step, or of the slope at its end [rad or m]."""
    search: Search
    clear: bool
    """Whether the break alone is larger than chance allows."""


def breaks(
    point: Point, y: np.ndarray, nuisance: np.ndarray, row: np.ndarray, seen: np.ndarray, whiten: Callable
) -> list[Break]:
    """The best break of each channel: of one actuator, and of the measuring frame.

    Rows are ordered by time where it was recorded, else as they stand in the file.

    Args:
        y, nuisance, whiten: as for :func:`scanned`.
        row: (M,) pose of each reading.
        seen: (6,) bool, which of x y z rx ry rz is measured at all.
    """
    at = point.situation
    N = len(at)
    time = np.asarray(at.columns.get("time", np.arange(N)), float)
    time = time if np.isfinite(time).all() and np.ptp(time) > 0 else np.arange(N, dtype=float)
    order = np.argsort(time, kind="stable")
    if N < 2 * MARGIN + 2:
        return []
    tau = (time[order] - time[order[0]]) / max(np.ptp(time), 1e-12)
    places = np.arange(MARGIN, N - MARGIN + 1)[:: max(1, N // ROWS)]
    U = span(nuisance, NUISANCE)
    noise = np.random.default_rng(1).standard_normal((len(y), DRAWS), dtype=np.float32)
    targets = np.column_stack([project_out(noise, U.astype(np.float32)), project_out(y, U)])
    rank = np.empty(N, int)
    rank[order] = np.arange(N)
    twist = point.columns([Contribution(base=np.tile(axis, (N, 1))) for axis in np.eye(6)]) * seen[:, None]
    response = point.response().actuator
    channels = [("actuator", i, response[:, :, [i]]) for i in range(response.shape[-1])] + [("body", -1, twist)]
    best: dict[str, tuple[np.ndarray, float, int, str, int, np.ndarray]] = {}
    for channel, member, columns in channels:
        gains = _gains(whiten(columns), targets, U, rank[row], tau, places)
        for shape, gain in zip(("step", "slope"), gains, strict=True):
            by_chance, place = gain[:, :-1].max(axis=0), places[_most_probable(gain[:, -1])]
            found = by_chance, float(gain[:, -1].max()), member, shape, int(place), columns
            if channel not in best:
                best[channel] = found
                continue
            chance = np.maximum(best[channel][0], by_chance)
            kept = found if found[1] > best[channel][1] else best[channel]
            best[channel] = (chance, kept[1], kept[2], kept[3], kept[4], kept[5])
    out = []
    for channel, (by_chance, gain, member, shape, place, columns) in best.items():
        weight = (np.arange(N) >= place) * (1.0 if shape == "step" else (tau - tau[place]) / max(1 - tau[place], 1e-9))
        free = int(np.count_nonzero(columns.any(axis=(0, 1))))  # heights show three of the body's
        search = Search.of(by_chance, free)
        chosen = columns * weight[rank][:, None, None]
        clear = gain > 1.5 * by_chance.max()
        out.append(Break(channel, member, shape, int(order[place]), chosen, search, clear))
    return out


def _most_probable(gain: np.ndarray) -> int:
    """Index of the place of a break that is most probably right within one place.

    The probability of a place is proportional to exp(gain/2). The answer is the middle of the three neighbouring places
    with the largest sum. In 200 data sets with a tracker bump of 6 to 20 noise units the bump lies within one row of
    that middle in 84 %, and within one row of the single most probable place in 80 %.

    Args:
        gain: (n,) by how much a break at each place lowers χ², in the order of measurement.
    """
    probable = np.exp(0.5 * (gain - gain.max()))
    return int(np.argmax(np.convolve(probable, [NEIGHBOUR, 1.0, NEIGHBOUR], "same")))


def _gains(
    C: np.ndarray, targets: np.ndarray, U: np.ndarray, rank: np.ndarray, tau: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(places, targets) square sum that a step, and a slope, from each place on takes of targets (M, T).

    With H the indicator of rows from the place on, all that is needed of the columns C·H, projected off U (M, r), is
    their Gram matrix and their products with the targets: sums over rows, which running sums give for all places.

    Args:
        C: (M, p) whitened columns.
        rank: (M,) place of each reading in the order of measurement.
        tau: (N,) time in that order, from 0 to 1.
    """
    N, p = len(tau), C.shape[1]
    each = np.zeros((N, p, p + U.shape[1] + targets.shape[1]))
    order = np.argsort(rank, kind="stable")
    rows, first = np.unique(rank[order], return_index=True)
    factors = np.hstack([C, U, targets])[order]
    for j in range(p):
        each[rows, j] = np.add.reduceat(C[order, j, None] * factors, first)
    moments = []  # of τ⁰, τ¹, τ², over rows from each place on
    for power in range(3):
        sums = np.cumsum((each * (tau**power)[:, None, None])[::-1], axis=0)[::-1]
        moments.append(sums[np.minimum(places, N - 1)])
    start = tau[np.minimum(places, N - 1)][:, None, None]
    gram, rest = slice(0, p), slice(p, None)
    out = []
    for A, BH in (
        (moments[0][..., gram], moments[0][..., rest]),
        (
            moments[2][..., gram] - 2 * start * moments[1][..., gram] + start**2 * moments[0][..., gram],
            moments[1][..., rest] - start * moments[0][..., rest],
        ),
    ):
        B, h = BH[..., : U.shape[1]], BH[..., U.shape[1] :]
        E = A - B @ np.swapaxes(B, 1, 2)
        small = 1e-6 * np.trace(A, axis1=1, axis2=2)[:, None, None] * np.eye(p) + 1e-12 * np.eye(p)
        out.append(np.einsum("spt,spt->st", h, np.linalg.solve(E + small, h)))
    return out[0], out[1]


def scanned(point: Point, y: np.ndarray, nuisance: np.ndarray, whiten: Callable) -> list[tuple[GearRipple, Search]]:
    """The best ripple of each variant, common and by arm, and what the search costs.

    Args:
        y: (M,) whitened residuals.
        nuisance: (M, n) whitened columns of what the model has.
        whiten: (N, 6, p) columns → (M, p).
    """
    robot = point.model.robot
    U = span(nuisance, NUISANCE)
    noise = np.random.default_rng(0).standard_normal((len(y), DRAWS), dtype=np.float32)
    rest = project_out(y, U)
    draws = project_out(noise, U.astype(np.float32))
    response = point.response().actuator
    q = point.situation.q
    gains: dict[str, list[np.ndarray]] = {"common": [], "arm": []}
    columns = {"common": 2, "arm": 2 * q.shape[1]}
    for n in SCANNED:
        waves = np.concatenate([response * np.sin(n * q)[:, None], response * np.cos(n * q)[:, None]], axis=-1)
        each = project_out(whiten(waves), U)
        half = each.shape[1] // 2
        together = np.stack([each[:, :half].sum(axis=1), each[:, half:].sum(axis=1)], axis=1)
        for per, E in (("common", together), ("arm", each)):
            Q, _ = np.linalg.qr(E)
            by_chance = Q.astype(np.float32).T @ draws
            gains[per].append(np.append(np.sum(by_chance**2, axis=0), np.sum((Q.T @ rest) ** 2)))
    out = []
    for per, gain in gains.items():
        best = SCANNED[int(np.argmax([g[-1] for g in gain]))]
        effect = effects.get("gear_ripple", per, robot, cycles=[best])
        assert isinstance(effect, GearRipple)
        out.append((effect, Search.of(np.max(gain, axis=0)[:-1], columns[per])))
    return out
