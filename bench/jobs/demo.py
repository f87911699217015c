"""The main job: a robot with imperfect rods is measured, identified and compensated, and MuJoCo lands the TCP.

Nothing passes from the virtual robot to the calibration but a data file; nothing passes back but joint commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import simulate
from bench import truth as truths
from bench.commands import Commands
from bench.instrument import Instrument
from bench.jobs.methods import LADDER, Method
from bench.machine import Machine
from bench.plan import Plan
from bench.truth import Truth
from pcalib import compensation, modelfile, planning, summary, workspace
from pcalib import ladder as ladders
from pcalib.data.measurement import Measurements
from pcalib.fitting.identification import Fit
from pcalib.ladder import ErrorMap, Ladder, Step
from pcalib.model import Model
from pcalib.robot import Robot
from pcalib.uncertainty import assessed
from pcalib.uncertainty.maps import with_expected
from pcalib.workspace import reachable

DEGREE = np.pi / 180


@dataclass(frozen=True)
class Settings:
    """What is demonstrated [SI]."""

    sigma_length: float = 0.3e-3
    """1σ of every length and coordinate of the robot."""
    sigma_angle: float = 0.12 * DEGREE
    """1σ of every angle."""
    noise_pos: float = 0.02e-3
    """1σ per component of the instrument."""
    noise_rot: float = 0.005 * DEGREE
    poses: int = 40
    """Measured poses, D-optimal."""
    check: int = 20
    """Further random poses, held out."""
    tools: tuple[tuple[float, ...], ...] = ()
    """TCPs in the plate frame; see `straight` for what is usual."""
    spacing: float | None = None
    """Distance of the targets; a fifth of the workspace's radius when absent."""
    seed: int = 5
    robot_file: Path | None = None
    """Where the robot comes from, where it is not the default: the report says how to do the same again."""


def straight(robot: Robot, lengths: Sequence[float] = (0.0, 0.1, 0.3)) -> tuple[tuple[float, ...], ...]:
    """TCPs of straight tools of some lengths [m], pointing away from the drives."""
    return tuple(tuple((length * robot.mechanism.tool_direction).tolist()) for length in lengths)


@dataclass(frozen=True, eq=False)
class Demo:
    """What came out."""

    settings: Settings
    truth: Truth
    data: Measurements
    ladder: Ladder

    @property
    def complete(self) -> Fit:
        """The last fit."""
        fit = self.ladder.steps[-1].fit
        assert fit is not None
        return fit


def run(robot: Robot, settings: Settings, advance: Callable[[], None] = lambda: None) -> Demo:
    """Measure, identify, compensate and land.

    Args:
        advance: called once after each of `stages(settings)` pieces of work.

    Raises:
        FitError: a step of the ladder cannot be identified from so few poses.
        ReachError: such a robot cannot be assembled, or cannot reach its workspace.
    """
    truth = Truth(
        robot,
        truths.draw_errors(robot, settings.sigma_length, settings.sigma_angle, settings.seed),
        Instrument(sigma_pos=settings.noise_pos, sigma_rot=settings.noise_rot),
    )
    plan = measuring_plan(robot, settings)
    advance()
    data = simulate.run(truth, plan, settings.seed).measurements
    steps = tuple(climb(data, robot, method) for method in LADDER if method.level in robot.mechanism.levels)
    advance()
    plate = workspace.workspace_grid(robot, settings.spacing)
    machine = truth.machine()
    maps = []
    for tool in np.array(settings.tools, float).reshape(-1, 3):
        fields = []
        for step in steps:
            fields.append(land(machine, step, plate + tool, tool))
            advance()
        errors, status = (np.stack(part) for part in zip(*fields, strict=True))
        maps.append(ErrorMap(tool, plate + tool, errors, status))
    landed = Ladder(robot, steps, tuple(maps), "landed by MuJoCo", settings.noise_pos, truth.values)
    return Demo(settings, truth, data, with_expected(landed))


def stages(settings: Settings) -> int:
    """How often `run` calls `advance`."""
    return 2 + len(settings.tools) * len(LADDER)


def measuring_plan(robot: Robot, settings: Settings) -> Plan:
    """D-optimal poses to fit and random ones to check, all without a tool."""
    q, tools = planning.plan(
        robot, settings.poses, sigma_pos=settings.noise_pos, sigma_rot=settings.noise_rot, seed=settings.seed
    )
    if settings.check:
        more = reachable(robot, settings.check, np.random.default_rng([settings.seed, 1])).q
        q, tools = np.concatenate([q, more]), np.concatenate([tools, np.zeros((len(more), 3))])
    held_out = np.arange(len(q)) >= settings.poses
    return Plan(Commands.of(q, tools), np.full(len(q), -1), held_out, "d-optimal")


def climb(data: Measurements, robot: Robot, method: Method) -> Step:
    """Identify one step of the ladder."""
    if not method.identifies:
        return Step(method.name, method.label, Model.nominal(robot), "none", method.text)
    fit = method.identify(data, robot)
    figures, model = summary.statistics(fit), assessed(fit)
    model = replace(model, history=(modelfile.snapshot(model, "fit", data=data.source, **figures),))
    text = f"{robot.mechanism.levels[model.level].text} {method.text}".rstrip()
    return Step(method.name, method.label, model, method.compensation, text, fit)


def land(machine: Machine, step: Step, wanted: np.ndarray, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Command every target by a step's model, and see where the TCP comes to stand.

    Returns:
        errors (P, 3) [m], NaN where the target was not reached, and status (P,).
    """
    method = "exact" if step.method == "none" else step.method
    commands = compensation.compensate(step.model, wanted, tool, method=method)
    landing = machine.land(commands.q, tool)
    status = np.where(commands.status == "ok", landing.status, commands.status)
    errors = landing.tcp - wanted
    errors[:, workspace.uncommanded(machine.robot)] *= 0.0
    errors[status != "ok"] = np.nan
    return errors, status


def content(demo: Demo) -> dict[str, Any]:
    """The outcome as JSON, `pcbench.demo/1`."""
    ladder = demo.ladder
    return {
        "schema": "pcbench.demo/1",
        "sentence": ladders.sentence(ladder),
        "robot": demo.truth.robot.name,
        "seed": demo.settings.seed,
        "poses": demo.settings.poses,
        "n_identified": demo.complete.n_identified,
        **ladders.as_json(ladder),
    }
