"""Measurement plans: which commands, tools, loads and temperatures, in which order.

    random   uniform in the workspace, as far as the joint range reaches
    border   uniform on the surface of the workspace, drawn in to where the robot can reach
    plain    as random, and nothing else is varied: no payload, directions, replicates, temperature or time
    rich     as random, with payloads, last directions of motion, replicates, time, and temperatures that come and go
    FILE     the commands of a CSV or Parquet file, with whatever conditions stand in it; rows to check are random
             poses after them, each under the conditions of one of the file's rows

Workspace and joint range are those of the plate of the *nominal* robot, solved by the bench itself.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bench.commands import REFERENCE_TEMPERATURE, TEMPERATURES, Commands
from bench.machine import Machine
from bench.reach import reach
from pcalib import rotation
from pcalib.data import columns as cols
from pcalib.data import measurement, plausibility
from pcalib.data import table as tables
from pcalib.errors import InputError, ReachError, unknown
from pcalib.robot import Robot

NAMES = ("random", "border", "plain", "rich")
OPTIMAL = "d-optimal"
"""The D-optimal plan. It needs the formulas of pcalib and is therefore made in `bench.jobs.optimal`."""
STREAM = 0x91A
PAYLOADS = (0.0, 1.0, 2.0)
"""[kg] payloads of a rich plan, unless others are asked for."""
SWING = 6.0
"""[K] by which temperatures of a rich plan swing about 22 °C."""
PACE = 20.0
"""[s] from one measurement to the next."""
SIGMA = {"sigma_pos": "length", "sigma_rot": "angle"}
"""Columns of a data file that tell the noise of readings, not of a plan."""
REPLICATED = 1 / 6
"""Share of a rich plan's rows that repeat the row before."""


Solver = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Plate positions (N, 3) [m] and orientations (N, 3, 3) → commands (N, nq) and which of them can be reached (N,)."""


@dataclass(frozen=True)
class Plan:
    """Commands and what the data file says about them."""

    commands: Commands
    pose_id: np.ndarray
    """(N,) int, rows with one id are replicates; −1: none."""
    check: np.ndarray
    """(N,) bool, held out."""
    name: str

    def __len__(self) -> int:
        return len(self.commands)


def make(
    robot: Robot,
    name: str | Path,
    n: int = 40,
    *,
    check: int = 0,
    tools: Sequence[np.ndarray] = (),
    payloads: Sequence[float] = (),
    seed: int = 0,
    solver: Solver | None = None,
) -> Plan:
    """Return a plan by name, or the one in a file.

    Args:
        n: rows to fit; a file brings its own. check: further rows, held out.
        tools: (3,) each [m, plate frame], dealt out evenly and at random; payloads: [kg], likewise.
        seed: the same seed gives the same plan.
        solver: how commands for poses are found; the bench's own when absent.

    Raises:
        InputError: no such plan, no usable file, or numbers that make no plan.
        ReachError: the workspace is out of the robot's reach.
    """
    if str(name) not in NAMES:
        path = Path(name)
        if not path.suffix and not os.path.exists(path):
            raise InputError(unknown("plan", str(name), [*NAMES, OPTIMAL, "a CSV or Parquet file"]))
        sensible(1, check)
        plan = _of_file(robot, path, tools, payloads)
        return with_checks(robot, plan, check, seed, solver) if check else plan
    sensible(n, check)
    total = n + check
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, NAMES.index(str(name)))))
    distinct = total
    repeats = np.ones(total, int)
    if name == "rich":
        distinct = total - round(total * REPLICATED)
        repeats = np.ones(distinct, int)
        repeats[generator.choice(distinct, min(total - distinct, distinct), replace=False)] = 2
    q = _poses(robot, distinct, generator, solver or partial(reach, Machine(robot)), border=name == "border")
    if name == "rich" and not payloads:
        payloads = PAYLOADS
    tool = _dealt(np.atleast_2d(np.zeros(3) if not len(tools) else np.array(tools, float)), distinct, generator)
    payload = _dealt(np.array(payloads or [0.0], float), distinct, generator)
    varied: dict[str, np.ndarray] = {}
    if name == "rich":
        varied = {f"dir{i + 1}": generator.choice([-1.0, 1.0], distinct) for i in range(q.shape[1])}
        varied |= _weather(distinct, generator)

    row = np.repeat(np.arange(distinct), repeats)
    held = np.zeros(distinct, bool)
    held[_last(repeats, check)] = True
    pose_id = np.where(repeats[row] > 1, row, -1) if name == "rich" else np.full(len(row), -1)
    varied = {key: values[row] for key, values in varied.items()}
    if name == "rich":
        varied["time"] = PACE * np.arange(len(row))
    return Plan(Commands(q[row], tool[row], payload[row], varied), pose_id, held[row], str(name))


def columns(name: str, actuators: int) -> tuple[str, ...]:
    """Return what a plan of that name brings beside commands, tools and payloads."""
    if name != "rich":
        return ()
    return (*(f"dir{i + 1}" for i in range(actuators)), *(f"temp_{part}" for part in TEMPERATURES), "time")


def sensible(n: int, check: int) -> None:
    """Refuse numbers of rows that make no plan.

    Raises:
        InputError: they do not.
    """
    if n < 1:
        raise InputError(f"a plan of {n} rows makes no sense", remedy="ask for one row at least")
    if check < 0:
        raise InputError(f"{check} rows to check make no sense", remedy="leave --check out for none")


def _last(repeats: np.ndarray, rows: int) -> np.ndarray:
    """Return the last poses that make up `rows` rows, or the nearest number to it."""
    counted = np.cumsum(repeats[::-1])
    return np.arange(len(repeats))[::-1][: np.searchsorted(counted, rows, side="right")]


def _poses(robot: Robot, n: int, generator: np.random.Generator, solver: Solver, *, border: bool) -> np.ndarray:
    """Return n commands (n, nq) whose plate poses lie in, or on the border of, workspace ∩ joint range."""
    kept: list[np.ndarray] = []
    tried = 0
    while sum(map(len, kept)) < n:
        if tried > (300 + 50 * n if kept and max(map(len, kept)) else 600):
            raise ReachError(
                f"the workspace of '{robot.name}' is all but out of its reach: {sum(map(len, kept))} of {tried} random "
                "poses lie within the joint range\n  check [workspace] and [joints] of the robot file"
            )
        size = max(8, n - sum(map(len, kept)))
        tried += size
        R = _orientations(robot, size, generator)
        if border:
            q, ok = _drawn_in(robot, solver, _on_surface(robot, size, generator), R)
        else:
            q, ok = solver(_inside(robot, size, generator), R)
        kept.append(q[ok])
    return np.concatenate(kept)[:n]


def _inside(robot: Robot, n: int, generator: np.random.Generator) -> np.ndarray:
    space = robot.workspace
    angle = generator.uniform(0, 2 * np.pi, n)
    radius = space.radius * np.sqrt(generator.random(n))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), generator.uniform(space.z_min, space.z_max, n)], 1)


def _on_surface(robot: Robot, n: int, generator: np.random.Generator) -> np.ndarray:
    space = robot.workspace
    x = _inside(robot, n, generator)
    wall, lid = 2 * (space.z_max - space.z_min), space.radius  # both over π·radius
    part = generator.random(n) * (wall + 2 * lid)
    on_wall = part < wall
    reach_out = np.hypot(x[:, 0], x[:, 1])
    x[on_wall, :2] *= (space.radius / np.maximum(reach_out, 1e-12))[on_wall, None]
    x[~on_wall, 2] = np.where(part < wall + lid, space.z_min, space.z_max)[~on_wall]
    return x


def _drawn_in(robot: Robot, solver: Solver, x: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return commands for the points x, or for the last reachable ones on their way to the middle of the workspace."""
    space = robot.workspace
    middle = np.array([0.0, 0.0, 0.5 * (space.z_min + space.z_max)])
    best, ok = solver(x, R)
    low, high = np.zeros(len(x)), np.ones(len(x))  # share of the way from the middle: reached, not reached
    open_ = np.flatnonzero(~ok)
    for _ in range(9):
        if not len(open_):
            break
        share = 0.5 * (low[open_] + high[open_])
        q, good = solver(middle + share[:, None] * (x[open_] - middle), R[open_])
        best[open_[good]] = q[good]
        ok[open_[good]] = True
        low[open_[good]], high[open_[~good]] = share[good], share[~good]
    return best, ok


def _orientations(robot: Robot, n: int, generator: np.random.Generator) -> np.ndarray:
    """Return (n, 3, 3) within the workspace's tilt and yaw, of the components that the robot commands."""
    task, space = robot.mechanism.task, robot.workspace
    turn = np.zeros((n, 3))
    way, tilt = generator.uniform(0, 2 * np.pi, n), space.tilt * np.sqrt(generator.random(n))
    yaw = generator.uniform(-1, 1, n) * space.yaw
    if 3 in task and 4 in task:
        turn[:, :2] = tilt[:, None] * np.stack([np.cos(way), np.sin(way)], 1)
    R = rotation.exp(turn)
    if 5 in task:
        R = R @ rotation.about(np.array([0.0, 0.0, 1.0]), yaw)
    return R


def _dealt(choices: np.ndarray, n: int, generator: np.random.Generator) -> np.ndarray:
    """Return n of the choices, each as often as the others, in random order."""
    return choices[generator.permutation(np.arange(n) % len(choices))]


def _weather(n: int, generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Return temperatures of arms, rods and base [°C] that rise and fall several times, each in a rhythm of its own."""
    way = np.linspace(0, 2 * np.pi, n)
    return {
        f"temp_{part}": REFERENCE_TEMPERATURE + 2.0 + SWING * np.sin(cycles * way + generator.uniform(0, 2 * np.pi))
        for part, cycles in zip(TEMPERATURES, (3, 4, 5), strict=True)
    }


def with_checks(robot: Robot, plan: Plan, check: int, seed: int, solver: Solver | None = None) -> Plan:
    """Return a plan and `check` held-out rows after it: random poses, each with all conditions of some row of the
    plan."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, len(NAMES))))
    q = _poses(robot, check, generator, solver or partial(reach, Machine(robot)), border=False)
    like = plan.commands.take(_dealt(np.arange(len(plan)), check, generator))
    columns = dict(like.columns)
    if "time" in columns:
        columns["time"] = np.nanmax(plan.commands.columns["time"]) + PACE * np.arange(1, check + 1)
    before = plan.commands
    commands = Commands(
        np.concatenate([before.q, q]),
        np.concatenate([before.tool, like.tool]),
        np.concatenate([before.payload, like.payload]),
        {name: np.concatenate([before.columns[name], values]) for name, values in columns.items()},
    )
    held = np.concatenate([plan.check, np.ones(check, bool)])
    return Plan(commands, np.concatenate([plan.pose_id, np.full(check, -1)]), held, plan.name)


def _of_file(robot: Robot, path: Path, tools: Sequence[np.ndarray], payloads: Sequence[float]) -> Plan:
    """Return the commands and conditions of a file; what it says of measurements is left aside."""
    table = tables.read(path)
    mechanism = robot.mechanism
    actuators = dict.fromkeys(mechanism.actuators, mechanism.actuator_dimension)
    directions = tuple(f"dir{i + 1}" for i in range(len(actuators)))
    wanted = actuators | cols.POSITION | cols.ROTATION | SIGMA | cols.CONDITIONS
    columns = cols.assign(table, wanted, (*directions, "pose_id", "set", "status"), len(actuators))
    cols.require(columns, actuators, "a plan holds the commanded actuator values")
    q = columns.matrix(actuators)
    tool = cols.tool(columns)
    if tool is not None and len(tools):
        raise table.error("the plan has tools of its own", remedy="leave out --tool, or the tool columns")
    if "payload" in columns and len(payloads):
        raise table.error("the plan has payloads of its own", remedy="leave out --payload, or the payload column")
    if len(tools) > 1 or len(payloads) > 1:
        raise InputError("a plan from a file takes one tool and one payload for all rows", file=path)
    low, high = robot.joint_range
    if not ((q >= low) & (q <= high)).all(axis=1).any():  # one row out of reach is reported later, all are a wrong unit
        plausibility.joints(columns, robot, q)
    payload = cols.payload(columns)
    if len(payloads):
        payload = np.full(len(q), float(payloads[0]))
    numeric, _ = cols.conditions(columns, len(actuators))
    commands = Commands.of(q, tool if tool is not None else (tools[0] if len(tools) else 0.0), payload, **numeric)
    return Plan(commands, measurement.pose_ids(table), measurement.held_out(table), path.name)
