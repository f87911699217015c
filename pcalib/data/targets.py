"""Target files (poses at which the TCP is wanted) and command files (actuator values that bring it there)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcalib import rotation, units
from pcalib.data import columns as cols
from pcalib.data import plausibility, spelling
from pcalib.data import table as tables
from pcalib.errors import InputError
from pcalib.robot import Robot

STATUS = "status"
U95, EXTRAPOLATES, COVARIANCE = "u95_um", "extrapolates", "cov_{}{}_um2"
"""Columns of a command file beside the status, if the model states its uncertainty."""
OK = "ok"


@dataclass(frozen=True, eq=False)
class Targets:
    """N wanted TCP poses in the base frame, SI."""

    position: np.ndarray
    """(N, 3) [m]; zero in a direction that the robot does not command."""
    orientation: np.ndarray
    """(N, 3) [rad] rotation vector of the plate; zero where the file gives none."""
    tool: np.ndarray | None
    """(N, 3) [m] TCP in the plate frame; None where the file does not say."""
    payload: np.ndarray
    """(N,) [kg]."""
    columns: Mapping[str, np.ndarray]
    """Further numbers by quantity, as in `Measurements.columns`."""
    kept: Mapping[str, Sequence[str] | np.ndarray]
    """The file's own columns as they stand, to be written beside the commands."""
    lines: np.ndarray
    """(N,) int."""
    source: str = "targets"

    def __len__(self) -> int:
        return len(self.position)

    @property
    def rotation(self) -> np.ndarray:
        """(N, 3, 3) wanted plate → base."""
        return rotation.exp(self.orientation)


def _refuse_measurements(table: tables.Table, columns: cols.Columns, commands: Mapping[str, str]) -> None:
    """Refuse a measurement file, whose positions are those that were reached.

    Raises:
        InputError: it holds commands beside what only measurements have.
    """
    of_measurements = [key for key in table.metadata if key.startswith("sigma_")]
    of_measurements += [name for name in ("pose_id", "set") if name in table.columns]
    if of_measurements and all(name in columns for name in commands):
        raise InputError(
            f"a measurement file: it holds commands ({', '.join(commands)}) and '{of_measurements[0]}'",
            file=table.source,
            remedy="targets have x, y, z and, where they are known, tool and payload: leave the other columns and "
            "the '#' lines out to command the places that were measured",
        )


def load_targets(path: str | Path, robot: Robot) -> Targets:
    """Read a target file, CSV or Parquet.

    Positions are needed for every direction that the robot commands; rx, ry, rz only where it commands them too, and
    they are zero where not given. Actuator and status columns (of a command file used again) are left aside.

    Raises:
        InputError: whatever cannot be used, with file, line, column and remedy.
    """
    table = spelling.read(path)
    mechanism = robot.mechanism
    count = len(mechanism.actuators)
    old = dict.fromkeys(mechanism.actuators, mechanism.actuator_dimension)
    wanted = old | cols.POSITION | cols.ROTATION | cols.CONDITIONS
    plain = (*(f"dir{i + 1}" for i in range(count)), STATUS)
    columns = cols.assign(table, wanted, plain, count)
    _refuse_measurements(table, columns, old)
    said = cols.metadata(table, {}, ("robot", "frame"))
    if said.get("frame", "base") != "base":
        problem = f"frame '{said['frame']}': targets stand in the base frame of the robot"
        raise table.metadata_error("frame", problem, "transform them, or write '# frame = base'")
    task = mechanism.task
    needed = {name: "length" for i, name in enumerate(cols.POSITION) if i in task}
    cols.require(columns, needed, "it holds the wanted TCP position")
    for i, name in enumerate(cols.ROTATION, 3):
        if name in columns and i not in task and np.any(columns.si(name)):
            commanded = " ".join([*cols.POSITION, *cols.ROTATION][j] for j in task)
            raise table.error(
                f"column '{columns.name(name)}': robot '{robot.name}' commands {commanded} only", remedy="leave it out"
            )
    zero = np.zeros(len(table))
    position = np.stack([columns.si(c) if c in columns else zero for c in cols.POSITION], axis=1)
    orientation = np.stack([columns.si(c) if c in columns else zero for c in cols.ROTATION], axis=1)
    tool = cols.tool(columns)
    numeric, _ = cols.conditions(columns, count)
    reach = np.zeros_like(position)
    if tool is not None:
        plausibility.tools(columns, robot, tool)
        reach = (rotation.exp(orientation) @ tool[..., None])[..., 0]
    plausibility.targets(columns, robot, position - reach)
    left = {columns.name(q) for q in (*old, STATUS) if q in columns}
    left |= {U95, EXTRAPOLATES, *(COVARIANCE.format(a, b) for a in "xyz" for b in "xyz")}
    kept = {name: cells for name, cells in table.columns.items() if name not in left}
    return Targets(position, orientation, tool, cols.payload(columns), numeric, kept, table.lines, table.source)


def save_commands(
    path: str | Path,
    robot: Robot,
    targets: Targets,
    q: np.ndarray,
    status: Sequence[str],
    beside: Mapping[str, Sequence[str] | np.ndarray] | None = None,
) -> None:
    """Write one command per target, in the same order, atomically.

    Args:
        q: (N, nq) [rad or m]; left blank in rows whose status is not 'ok'.
        status: N words, 'ok' or why there is no command.
        beside: further columns, (N,) each, to stand behind the status.
    """
    mechanism = robot.mechanism
    unit = units.UNITS[robot.command_unit]
    good = np.array([word == OK for word in status])
    out: dict[str, Sequence[str] | np.ndarray] = {
        f"{name}_{unit.suffix}": np.where(good, values / unit.factor, np.nan)
        for name, values in zip(mechanism.actuators, np.asarray(q, float).T, strict=True)
    }
    out[STATUS] = [str(word) for word in status]
    tables.write(path, out | dict(beside or {}) | dict(targets.kept), {"robot": robot.name})


def load_commands(path: str | Path, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Read a command file: q (N, nq) [rad or m], NaN in rows without a command, and status (N,) of words.

    Raises:
        InputError: no command file, or a row whose status is 'ok' lacks an actuator value.
    """
    table = spelling.read(path)
    mechanism = robot.mechanism
    wanted = dict.fromkeys(mechanism.actuators, mechanism.actuator_dimension)
    columns = cols.assign(table, wanted, (STATUS,), len(wanted))
    cols.require(columns, wanted, "it holds the command")
    q = columns.matrix(wanted, blank=True)
    status = np.array(table.texts(STATUS) if STATUS in columns else [OK] * len(table), object)
    lacking = np.isnan(q).any(axis=1) & (status == OK)
    if lacking.any():
        row = int(np.argmax(lacking))
        raise table.error("status is ok, but the command is blank", row=row, column=STATUS)
    return q, status
