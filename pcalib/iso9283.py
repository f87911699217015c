"""Pose performance of a robot after ISO 9283:1998, from measured positions.

A pose is commanded in n cycles and attained at positions p_j with barycentre p̄ = Σp_j/n. With l_j = |p_j − p̄|:

    pose accuracy                AP  = |p̄ − p_c|                               7.2.1
    pose repeatability           RP  = l̄ + 3·S_l,  S_l² = Σ(l_j − l̄)²/(n − 1)    7.2.2
    multi-directional variation  vAP = max |p̄_h − p̄_k| over approach paths h, k   7.2.3
    distance accuracy            AD  = D̄ − |p_c1 − p_c2|,  D_j = |p_1j − p_2j|    7.3.2
    distance repeatability       RD  = ±3·√(Σ(D_j − D̄)²/(n − 1))                  7.3.3
    drift of the pose            dAP = max |AP(t) − AP(0)|,  dRP = max |RP(t) − RP(0)|   7.6
    exchangeability              E   = max |p̄_h − p̄_k| over robots h, k           7.7

The distance of two poses is that of one cycle to the same cycle. Positions that were not attained are NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

CYCLES = 30
"""Cycles that the standard asks for in tests of pose accuracy, repeatability and distance (clause 6.10)."""
MAXWELL = float(np.sqrt(8 / np.pi) + 3 * np.sqrt(3 - 8 / np.pi))
"""RP over σ of normal noise of σ per component: mean and standard deviation of the Maxwell distribution, 3.616."""
INSET = 0.1
"""Share of a diagonal's length between its end and the test poses P2 … P5 (clause 6.8.4.1)."""


@dataclass(frozen=True, eq=False)
class PoseFigures:
    """Accuracy and repeatability of P poses in n cycles, over the cycles that attained the pose; NaN where none did."""

    ap: np.ndarray
    """(P,) [m] AP."""
    axes: np.ndarray
    """(P, 3) [m] p̄ − p_c: AP of every axis."""
    rp: np.ndarray
    """(P,) [m] RP; zero in a single cycle, which tells nothing of repeatability."""
    cycles: np.ndarray
    """(P,) int, cycles that attained the pose."""
    rms: float
    """[m] √(mean |p − p_c|²) over all poses and cycles."""
    max: float
    """[m]"""


def pose_figures(attained: np.ndarray, wanted: np.ndarray) -> PoseFigures:
    """AP and RP of attained positions (n, P, 3) [m] against wanted ones (P, 3) [m]."""
    cycles = (~np.isnan(attained[..., 0])).sum(axis=0)
    middle = barycentre(attained)
    distance = np.linalg.norm(attained - middle, axis=-1)
    mean = np.nansum(distance, axis=0) / np.where(cycles > 0, cycles, np.nan)
    spread = np.sqrt(np.nansum((distance - mean) ** 2, axis=0) / np.maximum(cycles - 1, 1))
    square = np.sum((attained - wanted) ** 2, axis=-1)
    square = square[~np.isnan(square)]
    return PoseFigures(
        ap=np.linalg.norm(middle - wanted, axis=-1),
        axes=middle - wanted,
        rp=mean + 3 * spread,
        cycles=cycles,
        rms=float(np.sqrt(square.mean())) if len(square) else float("nan"),
        max=float(np.sqrt(square.max())) if len(square) else float("nan"),
    )


def barycentre(attained: np.ndarray) -> np.ndarray:
    """(P, 3) [m] mean of attained positions (n, P, 3); NaN where a pose was never attained."""
    n = (~np.isnan(attained[..., 0])).sum(axis=0)
    return np.nansum(attained, axis=0) / np.where(n > 0, n, np.nan)[:, None]


def directional_variation(by_path: Sequence[np.ndarray]) -> np.ndarray:
    """vAP (P,) [m] from the attained positions (n, P, 3) of each approach path."""
    return _farthest([barycentre(attained) for attained in by_path])


def exchangeability(by_robot: Sequence[np.ndarray]) -> np.ndarray:
    """E (P,) [m] from the attained positions (n, P, 3) of each robot."""
    return directional_variation(by_robot)


def _farthest(points: Sequence[np.ndarray]) -> np.ndarray:
    """(P,) largest distance between any two of several sets of points (P, 3)."""
    stacked = np.stack(points)
    return np.linalg.norm(stacked[:, None] - stacked[None], axis=-1).max(axis=(0, 1))


@dataclass(frozen=True)
class DistanceFigures:
    """Distance accuracy and repeatability between two poses."""

    ad: float
    """[m] AD, positive where the attained distance is too long."""
    axes: np.ndarray
    """(3,) [m] AD of every axis: mean |component| of the attained distance less that of the commanded one."""
    rd: float
    """[m] RD; zero in a single cycle."""
    cycles: int


def distance_figures(first: np.ndarray, second: np.ndarray, wanted: np.ndarray) -> DistanceFigures:
    """AD and RD between two poses from their attained positions (n, 3) [m] and wanted ones (2, 3) [m]."""
    both = ~np.isnan(first[:, 0]) & ~np.isnan(second[:, 0])
    step = second[both] - first[both]
    if not len(step):
        return DistanceFigures(float("nan"), np.full(3, np.nan), float("nan"), 0)
    length = np.linalg.norm(step, axis=1)
    command = wanted[1] - wanted[0]
    spread = np.sqrt(np.sum((length - length.mean()) ** 2) / max(len(length) - 1, 1))
    axes = np.abs(step).mean(axis=0) - np.abs(command)
    return DistanceFigures(float(length.mean() - np.linalg.norm(command)), axes, float(3 * spread), len(length))


def drift(attained: np.ndarray, wanted: np.ndarray, block: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """dAP and dRP (P,) [m] between blocks of consecutive cycles and the first block; NaN with fewer than two blocks.

    Args:
        attained: (n, P, 3) [m], cycles in the order of time.
        block: cycles that make one measurement of AP and RP (clause 7.6 asks for ten).
    """
    blocks = [attained[i : i + block] for i in range(0, len(attained) - block + 1, block)]
    if len(blocks) < 2:
        nothing = np.full(len(wanted), np.nan)
        return nothing, nothing
    figures = [pose_figures(some, wanted) for some in blocks]
    ap, rp = np.stack([f.ap for f in figures]), np.stack([f.rp for f in figures])
    return np.abs(ap[1:] - ap[0]).max(axis=0), np.abs(rp[1:] - rp[0]).max(axis=0)


def cube_poses(edge: float, centre: np.ndarray) -> np.ndarray:
    """The five poses (5, 3) [m] in a cube's diagonal plane C1–C2–C7–C8: its centre, and a tenth in from each corner.

    Args:
        edge: [m] of the cube, edges parallel to the base frame.
        centre: (3,) [m].
    """
    corners = 0.5 * edge * np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, -1], [1, -1, -1]])
    inner = (1 - 2 * INSET) * corners
    return np.asarray(centre, float) + np.vstack([np.zeros(3), inner])


def largest_cube(radius: float, z_min: float, z_max: float) -> tuple[float, np.ndarray]:
    """Edge [m] and centre (3,) [m] of the largest cube with edges parallel to the axes in a working cylinder."""
    edge = min(z_max - z_min, np.sqrt(2.0) * radius)
    return float(edge), np.array([0.0, 0.0, 0.5 * (z_min + z_max)])


def by_pose(pose: np.ndarray, position: np.ndarray, count: int) -> np.ndarray:
    """Rows as cycles: (n, count, 3) of positions (N, 3) [m], in the order of each pose's rows; NaN where it has fewer.

    Args:
        pose: (N,) int, which pose each row attained.
        count: number of poses.
    """
    most = int(np.bincount(pose, minlength=count).max(initial=0))
    out = np.full((most, count, 3), np.nan)
    seen = np.zeros(count, int)
    for p, x in zip(pose, position, strict=True):
        out[seen[p], p] = x
        seen[p] += 1
    return out


@dataclass(frozen=True, eq=False)
class Record:
    """Everything that one file of measured cycles tells, with what could not be computed left out."""

    wanted: np.ndarray
    """(P, 3) [m]."""
    poses: PoseFigures
    distances: Mapping[tuple[int, int], DistanceFigures]
    """By pair of poses, counted from 0: each pose to the next."""
    variation: np.ndarray | None = None
    """(P,) [m] vAP; None with one approach path."""
    drift: tuple[np.ndarray, np.ndarray] | None = None
    """(P,) [m] dAP and dRP; None with fewer than two blocks of ten cycles."""
    exchange: np.ndarray | None = None
    """(P,) [m] E; None with one robot."""
    sigma: float = 0.0
    """[m] 1σ of the instrument per component; 0 where it is not stated."""

    @property
    def remarks(self) -> list[str]:
        """What the standard asks for and the data lack."""
        out = []
        if (few := int(self.poses.cycles.min(initial=CYCLES))) < CYCLES:
            out.append(f"The standard asks for {CYCLES} cycles; a pose of this file has {few}.")
        if len(self.wanted) != 5:
            out.append(f"The standard asks for five poses of a cube; this file has {len(self.wanted)}.")
        own = MAXWELL * self.sigma
        if own > 0.5 * float(np.nanmax(self.poses.rp)):
            out.append(
                f"RP contains the scatter of the instrument, which alone makes {own * 1e6:.3g} µm: the robot's own "
                "repeatability is better than RP says."
            )
        return out


def record(
    pose: np.ndarray,
    position: np.ndarray,
    wanted: np.ndarray,
    path: np.ndarray | None = None,
    others: Sequence[tuple[np.ndarray, np.ndarray]] = (),
    sigma: float = 0.0,
) -> Record:
    """All figures of measured rows.

    Args:
        pose: (N,) int, which pose each row attained.
        position: (N, 3) [m], rows in the order of time.
        wanted: (P, 3) [m].
        path: (N,) approach path of each row, any labels; None: one path.
        others: pose and position of the same poses attained by further robots.
        sigma: [m] 1σ of the instrument per component; 0 where it is not stated.
    """
    count = len(wanted)
    attained = by_pose(pose, position, count)
    pairs = [(i, i + 1) for i in range(count - 1)] + ([(count - 1, 0)] if count > 2 else [])
    labels = [] if path is None else [path == label for label in dict.fromkeys(path.tolist())]
    each = [by_pose(pose[rows], position[rows], count) for rows in labels]
    blocks = drift(attained, wanted)
    return Record(
        wanted=wanted,
        poses=pose_figures(attained, wanted),
        distances={(i, j): distance_figures(attained[:, i], attained[:, j], wanted[[i, j]]) for i, j in pairs},
        variation=directional_variation(each) if len(each) > 1 else None,
        drift=None if np.isnan(blocks[0]).all() else blocks,
        exchange=exchangeability([attained, *(by_pose(p, x, count) for p, x in others)]) if others else None,
        sigma=sigma,
    )
