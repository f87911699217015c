"""How data compare with the robot as drawn, without any fit but that of the measuring frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcalib import rotation, wording
from pcalib.data.measurement import Measurements
from pcalib.fitting.wild import Wild, wild
from pcalib.mechanics import kinematics
from pcalib.robot import Robot

ROWS = 200
"""Rows that are compared with the nominal robot."""
LARGE = 5e-3
"""[m] RMS from the nominal robot below which nothing is suspected without a quick fit."""
LARGE_TURN = np.radians(3.0)
"""[rad] median turn from the nominal robot below which nothing is suspected without a quick fit."""


@dataclass(frozen=True)
class Nominal:
    """How the data compare with the robot as drawn, without any fit but that of the measuring frame."""

    rms: float
    """[m] RMS position error of complete positions, after registration where the frame is a tracker's; NaN: none."""
    rows: np.ndarray
    """(n,) the rows behind it."""
    error: np.ndarray
    """(n,) [m] error of each."""
    unreachable: np.ndarray
    """Rows whose command the nominal robot cannot take."""
    aligned_rms: float
    """[m] RMS after the best rigid registration of the measuring frame."""
    turn: float = np.nan
    """[rad] median turn of the plate from the nominal robot, base frame only; NaN: none."""
    wild: tuple[Wild, ...] = ()
    """Readings of sensors that are far off where most are near."""

    @property
    def distance(self) -> str:
        """How far the data are from the nominal robot, in words; '' where that cannot be said."""
        turned = f"{np.rad2deg(self.turn):.3g}° (median)" if self.turn > LARGE_TURN else ""
        moved = f"{self.rms * 1e3:.3g} mm (RMS)" if self.rms > LARGE or not turned else ""
        return " and ".join(filter(None, (moved, turned))) if self.rms == self.rms else ""

    @property
    def typical(self) -> float:
        """[m] Median error."""
        return float(np.median(self.error)) if len(self.error) else 0.0

    @property
    def limit(self) -> float:
        """[m] Error above which a row counts as far off."""
        return max(8 * self.typical, LARGE)

    @property
    def far(self) -> bool:
        """Whether the data are further from the nominal robot than careful manufacture leaves."""
        return self.typical > LARGE or self.turn > LARGE_TURN

    @property
    def odd(self) -> np.ndarray:
        """Rows that are far off where most are near."""
        poses = np.zeros(0, int) if self.far else self.rows[self.error > self.limit]
        return np.concatenate([poses, *(each.rows for each in self.wild)])


def compare(data: Measurements, robot: Robot) -> Nominal:
    """Compare the data with the nominal robot."""
    return replace(_poses(data, robot), wild=wild(data, robot))


def _poses(data: Measurements, robot: Robot) -> Nominal:
    """The comparison of rows that read poses."""
    full = np.flatnonzero(data.mask[:, :3].all(axis=1))
    full = full[np.linspace(0, len(full) - 1, min(len(full), ROWS)).astype(int)] if len(full) else full
    nothing = np.zeros(0, int)
    if len(full) < (4 if data.frame == "tracker" else 1):
        return Nominal(np.nan, nothing, np.zeros(0), nothing, np.nan)
    some = data.take(full)
    solution = kinematics.forward(robot.mechanism, robot.mechanism.nominal, some.q)
    ok, pose = solution.ok, solution.pose
    unreachable = full[~ok]
    if ok.sum() < 4:
        return Nominal(np.nan, nothing, np.zeros(0), unreachable, np.nan)
    point = pose.tcp(some.tool)[ok]
    error = _error(point, some.position[ok], data.frame)
    turn = np.zeros(0)
    if data.frame == "base":
        turn = np.arccos(np.clip((np.einsum("nij,nij->n", some.rotation[ok], pose.R[ok]) - 1) / 2, -1, 1))
        turn = turn[~np.isnan(turn)]
    return Nominal(
        _rms(error), full[ok], error, unreachable, _rms(_error(point, some.position[ok], "tracker")),
        float(np.median(turn)) if len(turn) else np.nan,
    )  # fmt: skip


def rows_apart(found: Nominal, data: Measurements) -> str:
    """A message that names the rows that are far off where most are near; '' where none is."""
    size = {"length": wording.size, "angle": wording.angle}
    said = [
        f"{wording.capital(each.what)} more than {size[each.dimension](each.limit)} from those of the nominal robot, "
        f"where half of all are within {size[each.dimension](each.typical)}: {wording.lines(data.lines[each.rows])}."
        for each in found.wild
    ]
    odd = np.setdiff1d(found.odd, np.concatenate([np.zeros(0, int), *(each.rows for each in found.wild)]))
    if len(odd):
        where = wording.lines(data.lines[odd])
        said.append(
            f"More than {found.limit * 1e3:.3g} mm from the nominal robot, where half of all are within "
            f"{found.typical * 1e3:.2g} mm: {where}."
        )
    return " ".join([*said, "Do command and measurement belong together?"]) if said else ""


def _error(point: np.ndarray, position: np.ndarray, frame: str) -> np.ndarray:
    """(N,) [m] distances; in a tracker's frame after the best rigid registration (Kabsch) of rows that go together."""
    if frame == "base":
        return np.linalg.norm(position - point, axis=1)
    some = _together(point, position)
    R, t = rotation.registered(point[some], position[some])
    return np.linalg.norm(position - point @ R.T - t, axis=1)


def _together(point: np.ndarray, position: np.ndarray) -> np.ndarray:
    """(N,) Rows whose distances to half of the others are those of the robot; all rows where no half agrees.

    Distances need no registration, which a single gross row would spoil.
    """
    apart = np.linalg.norm(position[:, None] - position, axis=-1) - np.linalg.norm(point[:, None] - point, axis=-1)
    off = np.median(np.abs(apart), axis=1)
    some = off <= max(8 * float(np.median(off)), LARGE)
    return some if some.mean() > 0.5 else np.ones(len(point), bool)


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))
