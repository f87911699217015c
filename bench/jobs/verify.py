"""Command a compensated robot in MuJoCo, with all its faults, and measure where the TCP lands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench import truth as truths
from bench.commands import REFERENCE_TEMPERATURE, TEMPERATURES, Commands
from bench.jobs import alignment
from bench.truth import Truth
from pcalib import compensation, modelfile, workspace
from pcalib.data import targets
from pcalib.errors import InputError, ReachError
from pcalib.iso9283 import PoseFigures, pose_figures
from pcalib.ladder import tool_label
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot

STREAM = 0x9283
"""Key of the random stream, so that landings are independent of measurements with the same seed."""
CHUNK = 50


@dataclass(frozen=True, eq=False)
class Task:
    """Targets of the TCP and the conditions of each."""

    position: np.ndarray
    """(P, 3) [m] base frame."""
    rotation: np.ndarray | None
    """(P, 3, 3), for robots that command orientation; None: level."""
    conditions: Conditions
    """Tool and payload of every target, and the columns that its file gives."""


def grid_task(robot: Robot, tool: np.ndarray, payload: float = 0.0) -> Task:
    """A grid through the whole workspace, with one tool (3,) [m] and payload [kg]."""
    plate = workspace.workspace_grid(robot)
    return Task(plate + tool, None, Conditions(np.broadcast_to(tool, plate.shape), np.full(len(plate), payload)))


def file_task(path: Path, robot: Robot, tool: np.ndarray | None = None, payload: float | None = None) -> Task:
    """The task of a target file; tool and payload where the file has none.

    Raises:
        InputError: no usable target file, or tool or payload given twice.
    """
    found = targets.load_targets(path, robot)
    if found.tool is not None and tool is not None:
        raise InputError("the targets have tool columns and --tool is given too", file=path, remedy="keep one")
    if found.payload.any() and payload is not None:
        raise InputError("the targets have payloads and --payload is given too", file=path, remedy="keep one")
    point = found.tool if found.tool is not None else np.zeros(3) if tool is None else tool
    load = found.payload if payload is None else np.full(len(found), payload)
    turned = found.rotation if {3, 4, 5} & set(robot.mechanism.task) else None
    return Task(found.position, turned, Conditions(np.broadcast_to(point, found.position.shape), load, found.columns))


def tasks(robot: Robot, tools: list[np.ndarray], path: Path | None, payload: float | None) -> dict[str, Task]:
    """One task per tool, by its label: the targets of a file, or a grid where there is none."""
    if path is None:
        chosen = tools or [np.zeros(3)]
        return {tool_label(t): grid_task(robot, t, payload or 0.0) for t in chosen}
    if not tools:
        return {path.name: file_task(path, robot, payload=payload)}
    return {tool_label(t): file_task(path, robot, t, payload) for t in tools}


def load(model: Path, truth: Path, effect_files: Sequence[str] = ()) -> tuple[Model, Truth]:
    """The model, and the truth that it is judged against.

    Raises:
        InputError: files that cannot be used, or that are not of one robot.
    """
    calibrated, real = modelfile.load(model, effect_files), truths.load(truth)
    same_robot(calibrated, real)
    return calibrated, real


@dataclass(frozen=True, eq=False)
class Verification:
    """Positions that were attained, and the figures of accuracy."""

    task: Task
    attained: np.ndarray
    """(cycles, P, 3) [m]; NaN where a target was refused or not reached."""
    status: np.ndarray
    """(cycles, P) 'ok' or why not: by the compensation ('outside_workspace' …) or by MuJoCo ('joint_limit' …)."""
    accuracy: PoseFigures
    cycles: int
    """How many were asked for."""
    alike: bool
    """Whether all cycles are the same, so that one was enough."""

    @property
    def failed(self) -> int:
        """Targets that were not attained in some cycle."""
        return int((self.status != "ok").any(axis=0).sum())

    @property
    def reasons(self) -> dict[str, int]:
        """Why targets were not attained, with how often in all cycles."""
        words, counts = np.unique(self.status[self.status != "ok"], return_counts=True)
        return dict(zip(words.tolist(), counts.tolist(), strict=True))


def run(
    model: Model,
    truth: Truth,
    task: Task,
    *,
    method: str = "exact",
    cycles: int = 30,
    temperature: float = REFERENCE_TEMPERATURE,
    seed: int = 0,
    aligned: bool = False,
    advance: Callable[[int], None] = lambda n: None,
) -> Verification:
    """Carry out a task several times.

    Every target is approached anew in every cycle: each joint's last motion has a random sign where the task does not
    prescribe it, and the drives repeat themselves as badly as the truth says. Temperatures that the task does not
    give are `temperature`, its time is zero. The model is told of all that, as a controller could be.

    Args:
        temperature: [°C] of the whole robot.
        aligned: first remove the rigid motion that lays the attained positions best on the wanted ones: for a model
            fitted in an unknown measuring frame, which cannot know where its base stands.
        advance: called with the number of poses just done.

    Raises:
        InputError: model and truth are not of one robot.
        ReachError: no target was reached.
    """
    same_robot(model, truth)
    machine = truth.machine()
    columns = dict(task.conditions.columns)
    for part in TEMPERATURES:
        whole = columns.get("temp", np.full(len(task.position), temperature))
        columns.setdefault(f"temp_{part}", whole)
    columns.setdefault("time", np.zeros(len(task.position)))
    generator = np.random.default_rng([STREAM, seed])
    noisy = bool(truth.instrument.values["sigma_joint"] or truth.instrument.values["sigma_carriage"])
    drives = int(np.random.SeedSequence([STREAM, seed]).generate_state(1, np.uint64)[0])
    alike = not noisy and not machine.faults and not model.effects
    attained, status = [], []
    for cycle in range(1 if alike else cycles):
        now = {**approach(generator, len(task.position), len(truth.robot.mechanism.actuators)), **columns}
        conditions = Conditions(task.conditions.tool, task.conditions.payload, now)
        commands = compensation.compensate(
            model, task.position, conditions=conditions, rotation_matrix=task.rotation, method=method
        )
        asked = Commands.of(np.nan_to_num(commands.q), conditions.tool, conditions.payload, **now)
        rows = np.arange(len(asked)) + cycle * len(asked)
        miss = truth.instrument.joint_noise(asked.q, truth.robot.mechanism.actuator_dimension, drives, rows)
        tcp, here = np.full((len(asked), 3), np.nan), commands.status.astype("<U20")
        ready = np.flatnonzero(here == "ok")
        for piece in np.array_split(ready, max(1, -(-len(ready) // CHUNK))):
            landing = machine.run(asked.take(piece), miss[piece])
            tcp[piece], here[piece] = landing.tcp, landing.status
            advance(len(piece))
        attained.append(tcp)
        status.append(here)
    found, said = np.stack(attained), np.stack(status)
    if not (said == "ok").any():
        words = ", ".join(sorted(set(said.ravel().tolist())))
        raise ReachError(
            f"no target was reached ({words})\n"
            "  check targets and tool against the robot file, and the parameters of the model"
        )
    loose = [c for c in range(3) if c not in truth.robot.mechanism.task]
    found[..., loose] = np.where(np.isnan(found[..., loose]), np.nan, task.position[:, loose])
    if aligned:
        if (said == "ok").any(axis=0).sum() < 3:
            problem = "fewer than three targets were reached: no rigid motion can be taken out"
            raise ReachError(f"{problem}\n  give targets within reach, or leave out --align")
        found = alignment.align(found, task.position)
    return Verification(task, found, said, pose_figures(found, task.position), cycles, alike)


def approach(generator: np.random.Generator, n: int, actuators: int) -> dict[str, np.ndarray]:
    """Random signs of each joint's last motion, as columns dir1 …, (n,) each."""
    signs = generator.choice([-1.0, 1.0], (actuators, n))
    return {f"dir{i + 1}": row for i, row in enumerate(signs)}


def same_robot(model: Model, truth: Truth) -> None:
    """Check that a model and a truth are of one robot.

    Raises:
        InputError: they are not.
    """
    a, b = model.robot, truth.robot
    if a.kind != b.kind or not np.allclose(a.mechanism.nominal, b.mechanism.nominal, rtol=0, atol=1e-9):
        raise InputError(
            f"the model is of robot '{a.name}' ({a.kind}), the truth of '{b.name}' ({b.kind}), and their nominal "
            "dimensions differ",
            remedy="verify a model with the truth of the data that it was fitted to",
        )
