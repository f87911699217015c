"""The main job: a robot with imperfect rods is measured, identified and compensated, and MuJoCo lands the TCP.

Nothing passes from the virtual robot to the calibration but a data file; nothing passes back but joint commands.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import simulate
from bench import truth as truths
from bench.commands import Commands
from bench.instrument import Instrument
from bench.machine import Machine
from bench.plan import Plan
from bench.truth import Truth
from pcalib import compensation, files, modelfile, planning, summary, workspace
from pcalib import ladder as ladders
from pcalib.cli import frame
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.fitting.identification import Fit
from pcalib.ladder import ErrorMap, Ladder, Step
from pcalib.model import Model
from pcalib.robot import Robot
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


@dataclass(frozen=True)
class Rung:
    """One way to calibrate."""

    name: str
    label: str
    text: str
    """What is done, beside what the level lets vary."""
    fit: Mapping[str, Any] | None = None
    """Arguments of :func:`identification.fit`; None: the robot as drawn."""
    method: str = "exact"


RUNGS = (
    Rung("nominal", "Nominal", "The robot as drawn: whatever is wrong with it shows at the TCP.", method="none"),
    Rung("classical", "Classical", "", {"level": "classical", "method": "base"}),
    Rung("model24", "Model 24", "", {"level": "model24", "method": "base"}),
    Rung(
        "paper", "Paper, linear",
        "Found by one linear step; commands corrected to first order, as in the paper. What is left is of second order "
        "in the errors.",
        {"level": "complete", "method": "linear"}, "first-order",
    ),
    Rung(
        "complete", "Complete",
        "Found by non-linear least squares with manufacturing tolerances as priors; commands from the exact inverse. "
        "What is left is what the instrument cannot resolve.",
        {"level": "complete", "method": "map"},
    ),
)  # fmt: skip


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
    steps = tuple(climb(data, robot, rung) for rung in RUNGS if _possible(robot, rung))
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
    return Demo(
        settings, truth, data, Ladder(robot, steps, tuple(maps), "landed by MuJoCo", settings.noise_pos, truth.values)
    )


def stages(settings: Settings) -> int:
    """How often `run` calls `advance`."""
    return 2 + len(settings.tools) * len(RUNGS)


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


def climb(data: Measurements, robot: Robot, rung: Rung) -> Step:
    """Identify one step of the ladder."""
    if rung.fit is None:
        return Step(rung.name, rung.label, Model.nominal(robot), rung.method, rung.text)
    fit = identification.fit(data, robot, **rung.fit)
    figures = summary.statistics(fit)
    model = replace(fit.model, history=(modelfile.snapshot(fit.model, "fit", data=data.source, **figures),))
    text = f"{robot.mechanism.levels[model.level].text} {rung.text}".rstrip()
    return Step(rung.name, rung.label, model, rung.method, text, fit)


def _possible(robot: Robot, rung: Rung) -> bool:
    return rung.fit is None or rung.fit["level"] in robot.mechanism.levels


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


def write(demo: Demo, folder: Path) -> dict[str, Path]:
    """Write data, truth, models, recording and report into a folder, made where it is not there; paths by name.

    Raises:
        InputError: the folder cannot be written.
    """
    from bench.jobs import demo_report
    from pcalib import view

    name, seed = demo.truth.robot.name, demo.settings.seed
    with files.atomic_folder(folder) as fresh:
        out = {"data": fresh / "data.csv"}
        measurement.save(out["data"], demo.data)
        out["truth"] = simulate.truth_path(out["data"])
        files.write_text(out["truth"], truths.dumps(demo.truth, {"job": "demo", "seed": seed}))
        for step in demo.ladder.steps:
            if step.fit is not None:
                out[step.name] = fresh / f"{step.name}.toml"
                modelfile.save(out[step.name], step.model, summary.statistics(step.fit))
        out["recording"], out["report"] = fresh / "demo.rrd", fresh / "report.html"
        view.write(out["recording"], demo.ladder, identity=f"demo of {name}, seed {seed}")
        demo_report.write(out["report"], demo)
    return {key: folder / path.name for key, path in out.items()}


def show(demo: Demo, files: Mapping[str, Path], seconds: float) -> None:
    """Print the outcome: one sentence, the ladder, what was written."""
    frame.say(ladders.sentence(demo.ladder))
    print()
    frame.show_table(*ladders.table(demo.ladder))
    folder, n = files["report"].parent, len(demo.ladder.maps[0].targets)
    frame.say(
        f"{len(demo.data)} measured poses, {demo.settings.check} of them held out; {n} targets per tool, landed by "
        f"MuJoCo; {seconds:.1f} s. Files in {folder}:"
    )
    frame.say(f"- {files['report'].name}: the report, for any browser")
    frame.say(f"- {files['recording'].name}: the robot and its error field; open it with: {_pcalib()} view {folder}")
    frame.say(f"- {files['data'].name}, {files['truth'].name}, {files['complete'].name} …: data, truth and models")


def _pcalib() -> str:
    """How `pcalib` can be called from here."""
    if shutil.which("pcalib"):
        return "pcalib"
    beside = Path(sys.executable).with_name("pcalib")
    return os.path.relpath(beside) if beside.exists() else f"{Path(sys.executable).name} -m pcalib"


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
