"""A data set from a truth and a plan: the robot carries out the plan, and the instrument measures it.

Every row is computed by itself from seed and row number, so that a data set has the same bytes however many processes
share the work.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from bench import contact, faults, pool
from bench import truth as truths
from bench.commands import Commands, Landing
from bench.machine import Machine
from bench.plan import Plan
from bench.truth import Truth
from pcalib import units
from pcalib.data.measurement import Measurements
from pcalib.data.readings import POSE, Readings
from pcalib.errors import ReachError

CHUNK = 64
"""Rows per piece of work."""


class Robotic(Protocol):
    """What carries out commands: a `Machine`, or a `BatchMachine`."""

    def run(self, commands: Commands, miss: np.ndarray | None = None) -> Landing:
        """Return where the robot ends up, see :meth:`bench.machine.Machine.run`."""
        ...

DATED = 1e8
"""[s] A time above this at the first row is a date; faults then count from the first row."""


@dataclass(frozen=True, eq=False)
class DataSet:
    """What came out of a simulation."""

    measurements: Measurements
    landing: Landing
    """Where the robot really went, for all rows of the plan."""
    kept: np.ndarray
    """Row of the plan of every measurement."""
    lost: np.ndarray
    """Rows that the instrument lost, or saw nothing of."""
    outlier: np.ndarray
    """Rows that are grossly wrong, and in the measurements."""
    covariance: np.ndarray
    """(N, 6, 6) [m, rad] true covariance of the noise of the measured rows."""


def run(
    truth: Truth,
    plan: Plan,
    seed: int = 0,
    workers: int = 1,
    advance: Callable[[int], None] | None = None,
    machine: Robotic | None = None,
) -> DataSet:
    """Carry out a plan and measure it.

    Args:
        seed: of the noise; together with the plan it fixes every byte.
        workers: processes that share the rows.
        advance: called with the number of rows just done, for a progress bar.
        machine: the robot of this truth, where it has been built already.

    Raises:
        ReachError: more than half of the commands lead nowhere.
        InputError: a fault lacks a column, such as a temperature history.
    """
    robot, instrument, commands = truth.robot, truth.instrument, plan.commands
    rows = np.arange(len(plan))
    present = faults.present(truth.faults)
    for fault in present:
        commands.need(fault.NEEDS, f"fault '{fault.name}'")
    columns = dict(commands.columns)
    if "time" in columns and columns["time"][0] > DATED:
        columns["time"] = columns["time"] - columns["time"][0]
    asked = Commands(commands.q, commands.tool, commands.payload, columns)
    if instrument.values["kind"] == "contact":
        asked = contact.lowered(truth, asked, seed)
    for fault in present:
        asked = asked.remembering(fault.history(asked))
    miss = instrument.joint_noise(asked.q, robot.mechanism.actuator_dimension, seed, rows)
    landing = _land(truth, asked, miss, workers, advance) if machine is None else machine.run(asked, miss)
    _judge(truth, landing)

    position, R = instrument.frame(landing.tcp, landing.R)
    for fault in present:
        position, R = fault.seen(position, R, asked)
    reading = instrument.read(position, R, seed, rows, asked.tool)
    if instrument.values["kind"] == "contact":
        reading.position[:, 2] = instrument.values["bed"]
    seen = ~(np.isnan(reading.position).all(axis=1) & np.isnan(reading.rotation).all(axis=(1, 2)))
    kept = np.flatnonzero(landing.ok & seen & ~reading.lost)
    source, readings, sigma = _sensed(truth, landing, rows, kept, seed)
    posed = np.ones(len(source), bool) if readings is None else readings.sensor == POSE
    blank = ~posed
    position, turn = reading.position[source], reading.rotation[source]
    position[blank], turn[blank] = np.nan, np.nan
    measurements = Measurements.create(
        robot,
        asked.q[source],
        position,
        turn,
        tool=commands.tool[source],
        payload=commands.payload[source],
        columns={name: values[source] for name, values in commands.columns.items()},
        pose_id=plan.pose_id[source],
        check=plan.check[source],
        sigma_pos=reading.sigma_pos[source] if reading.states[0] else None,
        sigma_rot=reading.sigma_rot[source] if reading.states[1] else None,
        instrument=reading.description,
        frame=instrument.values["frame"],
        source="simulation",
        readings=readings,
        sigma_readings=sigma if instrument.values["state_sigma"] else None,
    )
    lost = np.setdiff1d(np.flatnonzero(landing.ok), source)
    outlier = kept[reading.outlier[kept]]
    covariance = reading.covariance[source]
    covariance[blank] = sigma[blank, :, None] ** 2 * np.eye(6)
    return DataSet(measurements, landing, source, lost, outlier, covariance)


def _sensed(
    truth: Truth, landing: Landing, rows: np.ndarray, kept: np.ndarray, seed: int
) -> tuple[np.ndarray, Readings | None, np.ndarray]:
    """Return the rows of the plan behind every reading, in order, what sensors read there, and σ (n, 6) of that.

    Raises:
        ReachError: neither instrument nor sensors saw anything.
    """
    found = [(sensor.read(landing.tcp, landing.R, rows, seed)) for sensor in truth.sensors]
    given = [np.flatnonzero(landing.ok & ~np.isnan(read.value).all(axis=1)) for read in found]
    source = np.concatenate([kept, *given])
    if not len(source):
        raise ReachError(
            "nothing was measured: lower missing_rows and missing_components, or move the stations into reach"
        )
    order = np.argsort(source, kind="stable")
    if not found:
        return source, None, np.zeros((len(source), 6))
    n, read = len(kept), list(zip(found, given, strict=True))
    name = np.concatenate([np.full(n, POSE, object), *(np.full(len(g), r.name, object) for r, g in read)])
    to = np.concatenate([np.full(n, "", object), *(r.to[g] for r, g in read)])
    value = np.concatenate([np.full((n, 6), np.nan), *(r.value[g] for r, g in read)])
    sigma = np.concatenate([np.zeros((n, 6)), *(np.full((len(g), 6), r.sigma) for r, g in read)])
    said = {key: text for read in found for key, text in read.metadata.items()}
    return source[order], Readings(name[order], to[order], value[order], said, said), sigma[order]


def truth_path(data: Path) -> Path:
    """Return where the sealed truth of a data file goes: data.csv → data.truth.toml."""
    return data.with_name(f"{data.stem}.truth.toml")


def _judge(truth: Truth, landing: Landing) -> None:
    """Refuse a robot that carries out less than half of its commands.

    Raises:
        ReachError: it does not; says what may be the cause.
    """
    failed = np.flatnonzero(~landing.ok)
    if 2 * len(failed) <= len(landing):
        return
    words, counts = np.unique(landing.status[failed], return_counts=True)
    why = ", ".join(f"{count} {word}" for word, count in zip(words, counts, strict=True))
    names = [fault.name for fault in faults.present(truth.faults)]
    hint = "the commands may be of another robot"
    if (landing.status[failed] == "joint_limit").all():
        unit = truth.robot.command_unit
        low, high = np.array(truth.robot.joint_range) / units.UNITS[unit].factor
        hint = f"the joints of '{truth.robot.name}' go from {low:g} to {high:g} {unit}; {hint}, or in another unit"
    elif names:
        hint = f"faults {', '.join(names)} may be too strong"
    raise ReachError(f"{len(failed)} of {len(landing)} commands cannot be carried out ({why})\n  {hint}")


def _land(
    truth: Truth, commands: Commands, miss: np.ndarray, workers: int, advance: Callable[[int], None] | None
) -> Landing:
    pieces = [slice(i, i + CHUNK) for i in range(0, len(commands), CHUNK)]
    if workers == 1 or len(pieces) == 1:
        machine, parts = truth.machine(), []
        for piece in pieces:
            parts.append(machine.run(commands.take(piece), miss[piece]))
            if advance:
                advance(len(parts[-1]))
    else:
        work = partial(_piece, truths.dumps(truth), os.fspath(Path("sealed truth").absolute()))
        shared = ((commands.take(piece), miss[piece]) for piece in pieces)
        parts = []
        for part in pool.ordered(work, shared, workers):
            parts.append(part)
            if advance:
                advance(len(part))
    return Landing(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("x", "R", "tcp", "status")))


_machines: dict[str, Machine] = {}


def _piece(text: str, source: str, asked: tuple[Commands, np.ndarray]) -> Landing:
    """Do the work of one process; its robot is kept for the next piece."""
    if text not in _machines:
        _machines.clear()
        _machines[text] = truths.parse(text, source).machine()
    machine = _machines[text]
    return machine.run(*asked)
