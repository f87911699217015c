"""How accurate calibrated robots get: many random robots, each measured, identified, compensated and landed.

One call of `study` is one column of a table: errors of a size, a number of poses of a kind, an instrument. Measuring
and landing are MuJoCo's; what lies between sees the readings only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.batch import BatchMachine
from bench.jobs.demo import RUNGS, Rung
from pcalib import compensation, planning, rotation, workspace
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError, ReachError, unknown
from pcalib.fitting import identification
from pcalib.mechanics import kinematics
from pcalib.model import Model
from pcalib.robot import Robot, Workspace
from pcalib.workspace import allowed, reachable

DEGREE = np.pi / 180
TOOLS = (0.0, 0.1, 0.3)
CHOICES = ("joint", "workspace", "interior", "d-optimal")
"""Random poses, uniform in joint space, in the volume of the working cylinder, or in that of one INSIDE its border; or
the planner's."""
INSIDE = 0.95
"""Size of the cylinder of the interior, its radius and height in those of the working cylinder."""
TARGETS = ("grid", "rings")
"""Where the TCP is sent: to a square grid through what the robot reaches, or to rings through the whole cylinder."""

EVERY = (
    *RUNGS,
    Rung("linear_exact", "Linear, exact inverse", "", {"level": "complete", "method": "linear"}),
    Rung("base", "Base, exact inverse", "", {"level": "complete", "method": "base"}),
)
"""The demo's ladder, and what shows which half of the paper's method leaves what."""


@dataclass(frozen=True)
class Conditions:
    """What is studied [SI]."""

    sigma_length: float = 0.1e-3
    """1σ of every length and coordinate of the robots."""
    sigma_angle: float = 0.05 * DEGREE
    robots: int = 20
    poses: int = 40
    choice: str = "joint"
    """How poses are chosen, one of CHOICES."""
    rotations: bool = True
    """Whether the instrument sees orientation."""
    measured: tuple[float, ...] | None = None
    """[m] lengths of the tools to measure with, shared out over random poses. When absent: none for random poses with
    orientation, else all of `tools`, as a planner may choose and as positions alone need."""
    noise_pos: float = 0.02e-3
    """1σ per component."""
    noise_rot: float = 0.005 * DEGREE
    tools: tuple[float, ...] = TOOLS
    """[m] lengths below the plate with which targets are approached."""
    targets: str = "grid"
    """Where the plate is sent, one of TARGETS."""
    spacing: float | None = 0.065
    """[m] of the grid of targets."""
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Outcome:
    """TCP errors of every robot at every target."""

    conditions: Conditions
    rungs: tuple[str, ...]
    errors: np.ndarray
    """(rungs, tools, robots, targets) [m] |TCP error|; NaN where a target was not reached."""
    statuses: Mapping[str, int]
    """How many fits ended how."""

    @property
    def rms(self) -> dict[str, np.ndarray]:
        """(tools,) [m] root of the mean squared error over robots and targets, by rung."""
        return {r: np.sqrt(np.nanmean(e**2, axis=(1, 2))) for r, e in zip(self.rungs, self.errors, strict=True)}

    @property
    def largest(self) -> dict[str, np.ndarray]:
        """(tools,) [m] largest error of all robots, by rung."""
        return {r: np.nanmax(e, axis=(1, 2)) for r, e in zip(self.rungs, self.errors, strict=True)}

    @property
    def rms_of_each(self) -> dict[str, np.ndarray]:
        """(tools, robots) [m] root of the mean squared error of each robot, by rung."""
        return {r: np.sqrt(np.nanmean(e**2, axis=2)) for r, e in zip(self.rungs, self.errors, strict=True)}

    @property
    def largest_of_each(self) -> dict[str, np.ndarray]:
        """(tools, robots) [m] largest error of each robot, by rung."""
        return {r: np.nanmax(e, axis=2) for r, e in zip(self.rungs, self.errors, strict=True)}

    @property
    def lost(self) -> int:
        """Targets that were not reached."""
        return int(np.isnan(self.errors).sum())

    def table(self) -> str:
        """RMS and maximum in µm, one line per rung."""
        head = "".join(f"{f'h = {1e3 * h:.0f} mm':>18}" for h in self.conditions.tools)
        lines = [f"{'RMS / max, µm':<16}{head}"]
        for rung in self.rungs:
            cells = zip(self.rms[rung] * 1e6, self.largest[rung] * 1e6, strict=True)
            lines.append(f"{rung:<16}" + "".join(f"{f'{a:.1f} / {b:.0f}':>18}" for a, b in cells))
        return "\n".join(lines)


def study(
    robot: Robot,
    conditions: Conditions = Conditions(),
    rungs: Sequence[Rung] = EVERY,
    tick: Callable[[], None] | None = None,
) -> Outcome:
    """Calibrate random robots and land their TCPs.

    Args:
        tick: called after every robot, for a progress bar.

    Raises:
        InputError: an unknown choice of poses or targets.
        FitError: a fit cannot be used.
    """
    if conditions.choice not in CHOICES:
        raise InputError(unknown("choice of poses", conditions.choice, CHOICES))
    if conditions.targets not in TARGETS:
        raise InputError(unknown("set of targets", conditions.targets, TARGETS))
    machine = BatchMachine(robot)
    whole = conditions.targets == "rings"
    plate = rings(robot.workspace) if whole else workspace.workspace_grid(robot, conditions.spacing)
    tools = np.array([[0.0, 0.0, -h] for h in conditions.tools])
    errors = np.full((len(rungs), len(tools), conditions.robots, len(plate)), np.nan)
    statuses: dict[str, int] = {}
    planned = plan(robot, conditions) if conditions.choice == "d-optimal" else None
    for n in range(conditions.robots):
        rng = np.random.default_rng([conditions.seed, n])
        machine.become(draw(robot, conditions, rng))
        data = measure(machine, conditions, *(planned or random_poses(robot, conditions, rng)), rng)
        for r, rung in enumerate(rungs):
            model = Model.nominal(robot)
            if rung.fit is not None:
                fit = identification.fit(data, robot, **rung.fit)
                statuses[fit.status] = statuses.get(fit.status, 0) + 1
                model = fit.model
            for t, tool in enumerate(tools):
                errors[r, t, n] = land(machine, model, rung.method, plate, tool)
        if tick:
            tick()
    return Outcome(conditions, tuple(rung.name for rung in rungs), errors, statuses)


def draw(robot: Robot, conditions: Conditions, rng: np.random.Generator) -> np.ndarray:
    """Raw parameters (nk,) of a robot with normal errors."""
    mechanism = robot.mechanism
    size = {"m": conditions.sigma_length, "rad": conditions.sigma_angle, "1": 1e-3}
    return mechanism.nominal + np.array([size[u] for u in mechanism.units]) * rng.standard_normal(len(mechanism.units))


def measure(
    machine: BatchMachine, conditions: Conditions, q: np.ndarray, tools: np.ndarray, rng: np.random.Generator
) -> Measurements:
    """Poses of the machine, commands (n, nq) and tools (n, 3), as the instrument sees them."""
    landing = machine.land(q, tools)
    if not landing.ok.all():
        raise ReachError(f"{(~landing.ok).sum()} of the measuring poses cannot be reached")
    position = landing.tcp + conditions.noise_pos * rng.standard_normal((len(q), 3))
    turned = rotation.exp(conditions.noise_rot * rng.standard_normal((len(q), 3))) @ landing.R
    seen: dict[str, Any] = {"rotation": turned, "sigma_rot": conditions.noise_rot} if conditions.rotations else {}
    return Measurements.create(machine.robot, q, position, tool=tools, sigma_pos=conditions.noise_pos, **seen)


def rings(w: Workspace, levels: int = 5, count: int = 3, around: int = 24) -> np.ndarray:
    """Plate positions (P, 3) [m] in levels through the working cylinder: on its axis and on rings out to its border."""
    radius = np.append(0.0, np.repeat(w.radius * np.arange(1, count + 1) / count, around))
    azimuth = np.append(0.0, np.tile(2 * np.pi * np.arange(around) / around, count))
    disc = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth)], axis=-1)
    z = np.repeat(np.linspace(w.z_min, w.z_max, levels), len(disc))
    return np.column_stack([np.tile(disc, (levels, 1)), z])


def measured_tools(conditions: Conditions) -> np.ndarray:
    """(T, 3) [m] tools to measure with."""
    bare = conditions.rotations and conditions.choice != "d-optimal"
    lengths = conditions.measured or ((0.0,) if bare else conditions.tools)
    return np.array([[0.0, 0.0, -h] for h in lengths])


def plan(robot: Robot, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
    """D-optimal commands (n, nq) and tools (n, 3): they depend on the nominal robot only."""
    return planning.plan(
        robot, conditions.poses, tools=measured_tools(conditions), sigma_pos=conditions.noise_pos,
        sigma_rot=conditions.noise_rot, measured=[True] * 3 + [conditions.rotations] * 3, seed=conditions.seed,
    )  # fmt: skip


def random_poses(robot: Robot, conditions: Conditions, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Random commands (n, nq) and tools (n, 3)."""
    n, w, mechanism = conditions.poses, robot.workspace, robot.mechanism
    if conditions.choice == "interior":
        w = shrunk(w, INSIDE)
    tools = np.resize(measured_tools(conditions), (n, 3))
    if conditions.choice == "joint":
        return reachable(robot, n, rng).q, tools
    kept: list[np.ndarray] = []
    while sum(map(len, kept)) < n:
        radius = w.radius * np.sqrt(rng.random(4 * n))
        azimuth, z = rng.uniform(0, 2 * np.pi, 4 * n), rng.uniform(w.z_min, w.z_max, 4 * n)
        x = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)
        found = kinematics.inverse(mechanism, mechanism.nominal, x)
        kept.append(found.q[allowed(robot, found.q, found.pose, found.status)])
    return np.concatenate(kept)[:n], tools


def shrunk(w: Workspace, size: float) -> Workspace:
    """The working cylinder with its radius and height multiplied by `size`, about its middle."""
    middle, half = 0.5 * (w.z_max + w.z_min), 0.5 * size * (w.z_max - w.z_min)
    return replace(w, radius=size * w.radius, z_min=middle - half, z_max=middle + half)


def land(machine: BatchMachine, model: Model, method: str, plate: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """|TCP error| (P,) [m] where targets are commanded by a model; NaN where one was not reached."""
    wanted = plate + tool
    commands = compensation.compensate(model, wanted, tool, method="exact" if method == "none" else method)
    landing = machine.land(commands.q, tool, near=(plate, np.broadcast_to(np.eye(3), (len(plate), 3, 3))))
    return np.where((commands.status == "ok") & landing.ok, np.linalg.norm(landing.tcp - wanted, axis=1), np.nan)
