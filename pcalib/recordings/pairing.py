"""Which reading belongs to which command: by name, by order or by time; what cannot be paired is listed, never guessed.

By order the counts may differ, because a point was measured twice, was lost, or was none of the robot's. Distances
between points do not depend on the instrument's frame: a first alignment pairs the longest run of readings whose
distances to the ones before are those of the commands. The rigid motion of that run then tells for every reading which
commands it can belong to; where that is not one alone, it stays unpaired.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib import prediction, rotation
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.model import Conditions, Model
from pcalib.recordings import Recording
from pcalib.robot import Robot

BY = ("name", "order", "time")
CLOSE = 0.01
"""[m] What a robot may be off by before its calibration, and what positions of readings are compared with."""
ALIKE = 1e-3
"""[m] Readings of one command that differ by more are not both of it, and which one is cannot be said."""
_SAME = 1e-6
"""[m] Commands in a row that are closer are one point, measured again."""
_SKIPS = 6
"""Most points in a row that may be lost or added."""
_APART = 0.5
"""Share of the pause between commands within which a time is that of a command."""


@dataclass(frozen=True)
class Pairs:
    """Which reading belongs to which command."""

    reading: np.ndarray
    """(P,) int, index of the reading of each pair."""
    command: np.ndarray
    """(P,) int, index of its command."""
    n_readings: int
    n_commands: int

    @property
    def lost(self) -> np.ndarray:
        """Commands that have no reading."""
        return np.setdiff1d(np.arange(self.n_commands), self.command)

    @property
    def extra(self) -> np.ndarray:
        """Readings that have no command."""
        return np.setdiff1d(np.arange(self.n_readings), self.reading)


def by_name(readings: Sequence[str], commands: Sequence[str]) -> Pairs:
    """Equal names; a name that several commands have pairs in order with readings of that name."""
    left: dict[str, list[int]] = {}
    for i, name in enumerate(commands):
        left.setdefault(name, []).append(i)
    found = [(r, left[name].pop(0)) for r, name in enumerate(readings) if left.get(name)]
    return _pairs(found, len(readings), len(commands))


def by_time(readings: np.ndarray, commands: np.ndarray) -> Pairs:
    """The command nearest in time, on one clock, where it is nearer than half of the pause to the next one."""
    found = []
    for r, t in enumerate(readings):
        c = int(np.argmin(np.abs(commands - t)))
        pause = np.min(np.abs(np.delete(commands, c) - commands[c])) if len(commands) > 1 else np.inf
        if abs(commands[c] - t) < _APART * pause and (not found or found[-1][1] < c):
            found.append((r, c))
    return _pairs(found, len(readings), len(commands))


def by_order(readings: np.ndarray, commands: np.ndarray) -> Pairs:
    """Pair readings (N, 3) and points of commands (M, 3) [m] of the same order; on either side some may be missing.

    Raises:
        InputError: too few agree to determine the pose of the instrument.
    """
    total = len(commands)
    first = np.flatnonzero(np.r_[True, np.linalg.norm(np.diff(commands, axis=0), axis=1) > _SAME])
    last, commands = np.append(first[1:], total) - 1, commands[first]  # a point that is measured again at once is one
    run = _longest_run(readings, commands)
    few = InputError(
        f"{len(run)} of {len(readings)} readings follow the commands in order; the rest cannot be placed",
        remedy="check that both files belong together, or pair them by name (--pair name)",
    )
    if len(run) < max(4, 0.3 * min(len(readings), len(commands))):
        raise few
    keep = np.array(run)
    R, t = rotation.registered(readings[keep[:, 0]], commands[keep[:, 1]])
    for _ in range(5):  # rows that do not lie where the others put them leave the run
        off = np.linalg.norm(readings[keep[:, 0]] @ R.T + t - commands[keep[:, 1]], axis=1)
        good = off < CLOSE
        if good.all():
            break
        if good.sum() < 4:
            raise few
        keep = keep[good]
        R, t = rotation.registered(readings[keep[:, 0]], commands[keep[:, 1]])
    away = np.linalg.norm((readings @ R.T + t)[:, None] - commands, axis=-1)  # (N, M)
    found = _unambiguous(away)
    members: dict[int, list[int]] = {}
    for r, c in found:
        members.setdefault(c, []).append(r)
    alike = {c: rows for c, rows in members.items() if np.ptp(readings[rows], axis=0).max() <= ALIKE}
    dealt = [(r, min(int(first[c]) + k, int(last[c]))) for c, rows in sorted(alike.items()) for k, r in enumerate(rows)]
    return _pairs(dealt, len(readings), total)


def _unambiguous(away: np.ndarray) -> list[tuple[int, int]]:
    """Pairs (reading, command) in rising order, where nothing else is possible.

    A reading may belong to a command that it is close to. Where there is one such command it is certain, and a point
    that was read twice is two readings of it. Commands that are visited again are told apart by order, where counts
    agree between neighbours that are certain.
    """
    possible = away < CLOSE
    n, m = away.shape
    certain = [(r, int(np.argmax(possible[r]))) for r in range(n) if possible[r].sum() == 1]
    certain = [certain[i] for i in _rising([c for _, c in certain])]
    out: list[tuple[int, int]] = []
    fences = [(-1, -1), *certain, (n, m)]
    for (r0, c0), (r1, c1) in itertools.pairwise(fences):
        if r0 >= 0:
            out.append((r0, c0))
        rows = [r for r in range(r0 + 1, r1) if possible[r, c0 + 1 : c1].any()]
        columns = [c for c in range(c0 + 1, c1) if possible[rows, c].any()]
        if len(rows) == len(columns) and all(possible[r, c] for r, c in zip(rows, columns, strict=True)):
            out += list(zip(rows, columns, strict=True))
    return out


def _rising(values: Sequence[int]) -> list[int]:
    """Indices of the longest subsequence that never falls."""
    if not values:
        return []
    length, before = [1] * len(values), [-1] * len(values)
    for i in range(len(values)):
        for j in range(i):
            if values[j] <= values[i] and length[j] + 1 > length[i]:
                length[i], before[i] = length[j] + 1, j
    at, out = int(np.argmax(length)), []
    while at >= 0:
        out.append(at)
        at = before[at]
    return out[::-1]


def _longest_run(readings: np.ndarray, commands: np.ndarray) -> list[tuple[int, int]]:
    """The longest chain of pairs in which neighbours are as far apart in both, by dynamic programming."""
    n, m = len(readings), len(commands)
    score, before = np.ones((n, m), int), np.full((n, m, 2), -1)
    for i in range(n):
        for a in range(max(0, i - _SKIPS), i):
            d = np.linalg.norm(readings[i] - readings[a])
            for gap in range(1, _SKIPS + 1):
                j = np.arange(gap, m)
                fits = np.abs(np.linalg.norm(commands[j] - commands[j - gap], axis=1) - d) < CLOSE
                better = j[fits & (score[a, j - gap] + 1 > score[i, j])]
                score[i, better] = score[a, better - gap] + 1
                before[i, better] = np.stack([np.full(len(better), a), better - gap], axis=1)
    at = np.unravel_index(int(np.argmax(score)), score.shape)
    out, (i, j) = [], (int(at[0]), int(at[1]))
    while i >= 0:
        out.append((i, j))
        i, j = (int(v) for v in before[i, j])
    return out[::-1]


def _pairs(found: Sequence[tuple[int, int]], n: int, m: int) -> Pairs:
    both = np.array(found, int).reshape(-1, 2)
    return Pairs(both[:, 0], both[:, 1], n, m)


def measured(
    recording: Recording, commands: Measurements, robot: Robot, by: str, sigma: tuple[float | None, float | None]
) -> tuple[Measurements, Pairs]:
    """Measurements of the commands that have a reading, in the instrument's own frame.

    Args:
        recording: single readings, one for each stop.
        commands: rows without readings.
        by: 'name', 'order' or 'time'.
        sigma: [m] and [rad] 1σ of positions and rotations; None where they are not stated.

    Raises:
        InputError: names or times are asked for and absent, or nothing can be paired.
    """
    if by == "name":
        names = next((commands.notes[n] for n in ("name", "point", "label") if n in commands.notes), None)
        called = [str(n) for n in names] if names is not None else [str(i) for i in commands.pose_id]
        if not recording.label or all(c == "-1" for c in called):
            where = recording.source if not recording.label else commands.source
            raise InputError(
                "readings and commands are paired by name, and one has none", file=where,
                remedy="add a column 'name' to the commands, or use --pair order",
            )  # fmt: skip
        pairs = by_name(recording.label, called)
    elif by == "time":
        if recording.time is None or "time" not in commands.columns:
            where = recording.source if recording.time is None else commands.source
            raise InputError("readings and commands are paired by time, and one has none", file=where,
                             remedy="add a column time_s to the commands, or use --pair order")  # fmt: skip
        pairs = by_time(recording.time, commands.columns["time"])
    else:
        p = prediction.predict(Model.nominal(robot), commands.q, Conditions(commands.tool, commands.payload))
        pairs = by_order(recording.position, p.position)
    if not len(pairs.reading):
        raise InputError(
            "no reading belongs to a command", file=recording.source, remedy="do both files belong together?"
        )
    rows, there = commands.take(pairs.command), pairs.reading
    return Measurements.create(
        robot, rows.q, recording.position[there], recording.rotation[there], tool=rows.tool, payload=rows.payload,
        columns=rows.columns, pose_id=_repeated(pairs.command, rows.pose_id), check=rows.check, sigma_pos=sigma[0],
        sigma_rot=sigma[1], frame="tracker", source=recording.source,
    ), pairs  # fmt: skip


def _repeated(command: np.ndarray, pose_id: np.ndarray) -> np.ndarray:
    """Pose ids in which readings of one command are replicates."""
    counts = np.bincount(command)
    return np.where((pose_id < 0) & (counts[command] > 1), command + pose_id.max(initial=0) + 1, pose_id)
