"""Mix-ups that only the nominal robot can see: columns swapped, axes mirrored, radians for degrees, other rows.

Errors of manufacture move the plate by millimetres and turn it by a fraction of a degree; a swapped column or a wrong
unit moves it by decimetres, and reading it the other way round makes the data fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from pcalib import rotation
from pcalib.data.measurement import Measurements
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.robot import Robot

ROWS = 200
"""Rows that are looked at: enough for a mix-up of whole columns."""
LARGE = 5e-3
"""[m] RMS from the nominal robot below which nothing is suspected."""
LARGE_TURN = np.radians(3.0)
"""[rad] median turn from the nominal robot below which nothing is suspected."""
ALONE = 7.0
"""Turn times lever over displacement from which on the turn is read wrong. Errors of parts do both alike (about 1);
degrees taken for radians multiply the turn alone, by 57."""
GAIN = 0.25
"""A reading that explains the data must bring the error below this share."""


@dataclass(frozen=True)
class Nominal:
    """How the data compare with the robot as drawn."""

    rms: float
    """[m] RMS position error of complete positions, after registration where the frame is a tracker's; NaN: none."""
    rows: np.ndarray
    """(n,) the rows behind it."""
    error: np.ndarray
    """(n,) [m] error of each."""
    unreachable: np.ndarray
    """Rows whose command the nominal robot cannot take."""
    explanations: tuple[str, ...]
    """Readings of the columns under which the data would fit, best first."""
    aligned_rms: float
    """[m] RMS after the best rigid registration of the measuring frame."""
    turn: float = np.nan
    """[rad] median turn of the plate from the nominal robot, base frame only; NaN: none."""

    @property
    def distance(self) -> str:
        """How far the data are from the nominal robot, in words."""
        turned = f"{np.rad2deg(self.turn):.3g}° (median)" if self.turn > LARGE_TURN else ""
        moved = f"{self.rms * 1e3:.3g} mm (RMS)" if self.rms > LARGE or not turned else ""
        return " and ".join(filter(None, (moved, turned)))


def compare(data: Measurements, robot: Robot) -> Nominal:
    """Compare the data with the nominal robot, and look for a mix-up where they are far apart."""
    full = np.flatnonzero(data.mask[:, :3].all(axis=1))
    full = full[np.linspace(0, len(full) - 1, min(len(full), ROWS)).astype(int)] if len(full) else full
    nothing = np.zeros(0, int)
    if len(full) < (4 if data.frame == "tracker" else 1):
        return Nominal(np.nan, nothing, np.zeros(0), nothing, (), np.nan)
    some = data.take(full)
    pose, ok = _poses(some, robot, some.q)
    point = pose.tcp(some.tool)
    unreachable = full[~ok]
    if ok.sum() < 4:
        return Nominal(np.nan, nothing, np.zeros(0), unreachable, (), np.nan)
    error = _error(point[ok], some.position[ok], data.frame, mirrored=False)
    rms = _rms(error)
    explanations: tuple[str, ...] = ()
    turn = _turns(some.rotation[ok], pose.R[ok]) if data.frame == "base" else np.full(len(error), np.nan)
    turn = float(np.median(turn[~np.isnan(turn)])) if (~np.isnan(turn)).any() else np.nan
    # The median keeps a few wrong rows from being taken for a mix-up of all.
    if np.median(error) > LARGE:
        found = sorted((value, text) for value, text in _readings(some, robot, point, ok) if value < GAIN * rms)
        explanations = tuple(text for value, text in found if value < 1.5 * found[0][0])
    elif turn > LARGE_TURN and turn * _lever(robot) > ALONE * np.median(error):
        seen = ok & some.mask[:, 3]
        readings = [(_turns(R, pose.R[seen]), text) for R, text in _other_rotations(some.take(seen))]
        limit = min(GAIN * turn, LARGE_TURN)
        explanations = tuple(text for value, text in readings if np.median(value) < limit)
    aligned = _rms(_error(point[ok], some.position[ok], "tracker", mirrored=False))
    return Nominal(rms, full[ok], error, unreachable, explanations, aligned, turn)


def _lever(robot: Robot) -> float:
    """[m] what turns a plate when it moves: the spread of its anchors."""
    points = robot.mechanism.plate_points(robot.mechanism.nominal)
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=-1))))


def _poses(data: Measurements, robot: Robot, q: np.ndarray) -> tuple[Pose, np.ndarray]:
    """Nominal poses at commands (N, nq), and which of them close."""
    solution = kinematics.forward(robot.mechanism, robot.mechanism.nominal, q)
    return solution.pose, solution.ok


def _turns(R: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """(N,) [rad] angles between rotations; NaN where one is unknown."""
    return np.arccos(np.clip((np.einsum("nij,nij->n", R, nominal) - 1) / 2, -1, 1))


def _other_rotations(data: Measurements) -> Iterator[tuple[np.ndarray, str]]:
    """The rotations (N, 3, 3) read in another way, and what that reading says."""
    vector = rotation.log(data.rotation)
    mean = vector.mean(axis=0)
    if np.linalg.norm(mean) < 3 * np.linalg.norm(vector - mean, axis=1).mean():  # else the target sits askew
        yield rotation.exp(np.radians(vector)), "the rotation is in degrees, not radians"
    yield rotation.exp(np.degrees(vector)), "the rotation is in radians, not degrees"
    yield np.swapaxes(data.rotation, 1, 2), "the rotation is that of the base seen from the plate"
    scalar_last = rotation.to_quaternion(data.rotation)[:, [3, 0, 1, 2]]
    yield rotation.from_quaternion(scalar_last), "the quaternion's columns are in the order x, y, z, w"


def _readings(
    data: Measurements, robot: Robot, point: np.ndarray, ok: np.ndarray
) -> Iterator[tuple[float, str]]:
    """RMS under every other reading of the columns, and what that reading says."""
    names, n = data.actuators, len(data.actuators)
    orders = list(permutations(range(n))) if n <= 3 else _transpositions(n)
    for order in orders:
        if list(order) == list(range(n)):
            continue
        said = ", ".join(f"{names[j]} is what stands in {names[i]}" for j, i in enumerate(order) if i != j)
        yield from _commanded(data, robot, data.q[:, list(order)], said)
    if data.actuator_dimension == "angle":
        yield from _commanded(data, robot, np.degrees(data.q), f"{', '.join(names)} are in radians, not degrees")
        yield from _commanded(data, robot, np.radians(data.q), f"{', '.join(names)} are in degrees, not radians")
    if data.frame == "tracker":
        yield _rms(_error(point[ok], data.position[ok], "tracker", mirrored=True)), "the tracker's frame is left-handed"
        return
    for order in permutations(range(3)):
        for signs in np.ndindex(2, 2, 2):
            sign = 1 - 2 * np.array(signs)
            if order == (0, 1, 2) and (sign > 0).all():
                continue
            read = data.position[ok][:, order] * sign
            said = ", ".join(
                f"{'xyz'[j]} has the wrong sign" if i == j
                else f"{'xyz'[j]} is {'minus ' if sign[j] < 0 else ''}what stands in {'xyz'[i]}"
                for j, i in enumerate(order)
                if i != j or sign[j] < 0
            )
            yield _rms(_error(point[ok], read, "base", mirrored=False)), said


def _commanded(data: Measurements, robot: Robot, q: np.ndarray, said: str) -> Iterator[tuple[float, str]]:
    """RMS where the commands were `q`, if the robot can take them."""
    low, high = robot.joint_range
    slack = 0.05 * (high - low)
    if ((q >= low - slack) & (q <= high + slack)).mean() < 0.8:
        return
    pose, closes = _poses(data, robot, q)
    if closes.mean() > 0.8:
        point = pose.tcp(data.tool)[closes]
        yield _rms(_error(point, data.position[closes], data.frame, mirrored=False)), said


def _transpositions(n: int) -> list[tuple[int, ...]]:
    out = []
    for i in range(n):
        for j in range(i + 1, n):
            order = list(range(n))
            order[i], order[j] = j, i
            out.append(tuple(order))
    return out


def _error(point: np.ndarray, position: np.ndarray, frame: str, *, mirrored: bool) -> np.ndarray:
    """(N,) [m] distances; in a tracker's frame after the best rigid registration (Kabsch), or mirrored one."""
    if frame == "base":
        return np.linalg.norm(position - point, axis=1)
    a, b = point - point.mean(axis=0), position - position.mean(axis=0)
    return np.linalg.norm(b - a @ rotation.laying(a, b, mirrored).T, axis=1)


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))
