"""One robot of a campaign: measured in MuJoCo, identified, compensated, and checked in MuJoCo. A pure function.

Everything random is drawn from streams that depend on the campaign's seed and the robot's number only: robot 7 has
the same unit errors, the same noise and the same poses in every cell, so that cells differ by what is swept and not by
luck.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from bench import batch, simulate
from bench.batch import BatchMachine
from bench.commands import Commands, Landing
from bench.jobs.campaign import samples
from bench.jobs.campaign.cell import Cell, Method
from bench.jobs.campaign.spec import Campaign
from bench.machine import Machine
from bench.plan import Plan
from bench.truth import Truth
from pcalib import compensation, effects
from pcalib.data.measurement import Measurements
from pcalib.errors import PcalibError
from pcalib.fitting import identification
from pcalib.mechanics import grid
from pcalib.mechanics.mechanism import Pose
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions

GEOMETRY, PLAN, INSTRUMENT, FAULTS, TARGETS = range(5)
"""Streams of random numbers."""
PERCENTILE = 95


@dataclass(frozen=True, eq=False)
class Stand:
    """What all robots of a cell share."""

    cell: Cell
    targets: Pose
    """(P) plate poses; the TCP targets are those of every tool there."""
    plan: Plan | None
    """A plan that is the same for every robot; None where each has its own."""
    oriented: bool
    """Whether commands say how the plate is turned."""

    @property
    def tools(self) -> np.ndarray:
        """(T·P, 3) [m] tool of each target."""
        return np.repeat(self.cell.verify.tools, len(self.targets), axis=0)

    @property
    def goals(self) -> Pose:
        """(T·P) plate poses, tool after tool."""
        T = len(self.cell.verify.tools)
        t = self.targets
        return Pose(np.tile(t.x, (T, 1)), np.tile(t.R, (T, 1, 1)), np.tile(t.phi, (T, 1)))


def run(campaign: Campaign, number: int) -> list[dict[str, Any]]:
    """The rows of trial `number`: one per method and tool, whatever happens.

    A robot that cannot be built, measured, identified or checked gives rows with status 'failed' and the reason.
    """
    index, robot = divmod(number, campaign.robots)
    cell = campaign.cell(index)
    head = {"cell": index, "robot": robot, "point": campaign.points[index]}
    keep = robot < campaign.output.map_robots
    try:
        shared = stand(campaign, index)
        machine, data = _measured(campaign, shared, robot)
    except Exception as error:
        _let_pass(error)
        return [row for method in cell.methods for row in _failed(head, cell, method, error)]
    calibrated: dict[str, Any] = {}
    for method in cell.methods:
        try:
            calibrated[method.name] = _commanded(shared, method, data)
        except Exception as error:
            _let_pass(error)
            calibrated[method.name] = error
    good = [name for name, outcome in calibrated.items() if not isinstance(outcome, Exception)]
    landed: dict[str, Landing] = {}
    if good:
        try:
            landed = _verified(shared, machine, {name: calibrated[name][0] for name in good})
        except Exception as error:
            _let_pass(error)
            calibrated |= dict.fromkeys(good, error)
    out: list[dict[str, Any]] = []
    for method in cell.methods:
        outcome = calibrated[method.name]
        if isinstance(outcome, Exception):
            out += _failed(head, cell, method, outcome)
        else:
            out += _rows(head, shared, method, outcome[1], len(data), landed[method.name], keep)
    return out


def given_up(campaign: Campaign, number: int, reason: str) -> list[dict[str, Any]]:
    """The rows of a trial that could not be tried to its end."""
    index, robot = divmod(number, campaign.robots)
    cell = campaign.cell(index)
    head = {"cell": index, "robot": robot, "point": campaign.points[index]}
    return [row for method in cell.methods for row in _failed(head, cell, method, PcalibError(reason))]


def truth_errors(campaign: Campaign, number: int) -> np.ndarray:
    """(nk,) true minus nominal parameters of a trial's robot."""
    index, robot = divmod(number, campaign.robots)
    return campaign.cell(index).geometry.errors(robot, _stream(campaign.seed, robot, GEOMETRY))


def landings(campaign: Campaign, number: int) -> dict[str, Landing]:
    """Where a trial's robot ends up with the commands of each method, targets of all tools one after the other.

    Raises:
        PcalibError: the robot cannot be measured, or a method fails.
    """
    index, robot = divmod(number, campaign.robots)
    shared = stand(campaign, index)
    machine, data = _measured(campaign, shared, robot)
    return _verified(shared, machine, {m.name: _commanded(shared, m, data)[0] for m in shared.cell.methods})


def steps(campaign: Campaign, number: int) -> dict[str, Callable[[], object]]:
    """The steps of a trial, each to be called as often as one likes: measuring, each method, verifying."""
    index, robot = divmod(number, campaign.robots)
    shared = stand(campaign, index)
    machine, data = _measured(campaign, shared, robot)
    commands = {method.name: _commanded(shared, method, data)[0] for method in shared.cell.methods}
    out: dict[str, Callable[[], object]] = {"measuring": lambda: _measured(campaign, shared, robot)}
    for method in shared.cell.methods:
        out[f"{method.name}, fit and commands"] = lambda method=method: _commanded(shared, method, data)
    return out | {"verifying": lambda: _verified(shared, machine, commands)}


# -- the steps ---------------------------------------------------------------------------------------------------------


def _measured(campaign: Campaign, stand: Stand, robot: int) -> tuple[BatchMachine | Machine, Measurements]:
    """The true robot, and what the instrument saw of it."""
    cell = stand.cell
    rng = _stream(campaign.seed, robot, FAULTS)
    truth = Truth(
        cell.robot,
        cell.geometry.errors(robot, _stream(campaign.seed, robot, GEOMETRY)),
        cell.instrument,
        tuple(fault.make(cell.robot, rng) for fault in cell.faults),
    )
    machine = _machine(truth)
    plan = stand.plan or samples.own(cell.robot, cell.plan, _seed(campaign.seed, robot, PLAN))
    data = simulate.run(truth, plan, _seed(campaign.seed, robot, INSTRUMENT), machine=machine)
    return machine, data.measurements


def _commanded(stand: Stand, method: Method, data: Measurements) -> tuple[np.ndarray, dict[str, Any]]:
    """Commands (T·P, nq), NaN where there is none, and the figures of the fit."""
    cell = stand.cell
    model, figures = _identified(cell, method, data)
    goals, tools = stand.goals, stand.tools
    conditions = _conditions(cell, tools)
    commands = compensation.compensate(
        model,
        goals.tcp(tools),
        rotation_matrix=goals.R if stand.oriented else None,
        conditions=conditions,
        method=method.compensation,
    )
    return commands.q, figures


def _identified(cell: Cell, method: Method, data: Measurements) -> tuple[Model, dict[str, Any]]:
    """The model that a method makes of the data.

    Raises:
        FitError: the fit did not converge, or the data cannot support the level.
    """
    if method.level == "nominal" and not method.effects:
        return Model.nominal(cell.robot), {}
    if method.reads == "position":
        mask = data.mask.copy()
        mask[:, 3:] = False
        data = replace(data, mask=mask)
    started = []
    for spec in method.effects:
        effect = effects.parse(spec, cell.robot)
        started.append(FittedEffect(effect, np.zeros(len(effect.parameters)), spec))
    fit = identification.fit(
        data, cell.robot, method.level, effects=started, method=method.fit, loss=method.loss, weighted=method.weighted
    )
    figures = {
        "fit_rms_um": fit.fit.rms_pos * 1e6,
        "fit_chi2_dof": fit.fit.chi2_dof,
        "identified": fit.n_identified,
        "iterations": fit.iterations,
        "prior_scale": fit.prior_scale,
    }
    return fit.model, figures


def _verified(
    stand: Stand, machine: BatchMachine | Machine, commands: Mapping[str, np.ndarray]
) -> dict[str, Landing]:
    """Where the true robot ends up with each method's commands, all in one go.

    What a command of this robot does not prescribe is taken as wanted.
    """
    goals, n = stand.goals, len(commands)
    conditions = _conditions(stand.cell, np.tile(stand.tools, (n, 1)))
    asked = Commands(
        np.concatenate(list(commands.values())), conditions.tool, conditions.payload, conditions.columns
    )
    if isinstance(machine, BatchMachine):
        landing = machine.run(asked, near=(np.tile(goals.x, (n, 1)), np.tile(goals.R, (n, 1, 1))))
    else:
        landing = machine.run(asked)
    size = len(goals)
    return {
        name: _judged(stand, landing.take(slice(i * size, (i + 1) * size))) for i, name in enumerate(commands)
    }


def _judged(stand: Stand, landing: Landing) -> Landing:
    """A landing with the TCP's directions that no command prescribes as wanted."""
    loose = grid.uncommanded(stand.cell.robot)
    tcp = landing.tcp.copy()
    tcp[:, loose] = np.where(np.isnan(tcp[:, loose]), np.nan, stand.goals.tcp(stand.tools)[:, loose])
    return replace(landing, tcp=tcp)


def _rows(
    head: Mapping[str, Any], stand: Stand, method: Method, figures: Mapping[str, Any], rows: int, landing: Landing,
    keep: bool,
) -> list[dict[str, Any]]:  # fmt: skip
    """One row per tool."""
    out = []
    P = len(stand.targets)
    error = np.linalg.norm(landing.tcp - stand.goals.tcp(stand.tools), axis=1)
    # Of a small angle between two rotations, from the length of their difference: |ΔR| = 2√2 sin(angle/2).
    far = np.linalg.norm(landing.R - stand.goals.R, axis=(1, 2)) / np.sqrt(8.0)
    tilt = 2 * np.arcsin(np.minimum(far, 1.0))
    for t, tool in enumerate(stand.cell.verify.tools):
        here = slice(t * P, (t + 1) * P)
        ok = landing.ok[here]
        row = {**head, **_named(method, tool), "targets": P, "reached": int(ok.sum()), "measured": rows, **figures}
        if not ok.any():
            out.append({**row, "status": "failed", "reason": "the robot reached none of the targets"})
            continue
        um = error[here][ok] * 1e6
        out.append(
            {
                **row,
                "status": "ok",
                "reason": "",
                "rms_um": float(np.sqrt(np.mean(um**2))),
                "p95_um": float(np.percentile(um, PERCENTILE)),
                "max_um": float(um.max()),
                "tilt_urad": float(np.sqrt(np.mean(tilt[here][ok] ** 2)) * 1e6),
                "error_um": (error[here] * 1e6).astype(np.float32) if keep else None,
            }
        )
    return out


def _failed(head: Mapping[str, Any], cell: Cell, method: Method, error: Exception) -> list[dict[str, Any]]:
    """One row per tool that says why there are no figures."""
    reason = (getattr(error, "problem", str(error)).splitlines() or [""])[0]
    if not isinstance(error, PcalibError):
        reason = f"{type(error).__name__}: {reason}"
    nothing = {"status": "failed", "reason": reason, "targets": cell.verify.targets, "reached": 0}
    return [{**head, **_named(method, tool), **nothing} for tool in cell.verify.tools]


def _named(method: Method, tool: np.ndarray) -> dict[str, Any]:
    return {"method": method.name, "tool": tool_label(tool), "tool_length_mm": float(np.linalg.norm(tool) * 1e3)}


def tool_label(tool: np.ndarray) -> str:
    """A tool as a command line takes it: '0,0,-300mm'."""
    return ",".join(f"{round(float(v) * 1e3, 6) + 0.0:g}" for v in tool) + "mm"


def _let_pass(error: Exception) -> None:
    """Errors of the machine that runs the campaign are no property of the robot."""
    if isinstance(error, (MemoryError, OSError)):
        raise error


# -- what robots share -------------------------------------------------------------------------------------------------


def _stream(seed: int, robot: int, purpose: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(_sequence(seed, robot, purpose)))


def _sequence(seed: int, robot: int, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(purpose, robot))


def _seed(seed: int, robot: int, purpose: int) -> int:
    """A seed for functions that take a number."""
    return int(_sequence(seed, robot, purpose).generate_state(1, np.uint64)[0])


@lru_cache(maxsize=8)
def stand(campaign: Campaign, index: int) -> Stand:
    """What all robots of a cell share."""
    cell = campaign.cell(index)
    robot, verify = cell.robot, cell.verify
    found = samples.targets(
        robot, verify.places, verify.targets, verify.spacing, _seed(campaign.seed, 0, TARGETS)
    )
    plan = samples.shared(robot, cell.plan, cell.instrument, _seed(campaign.seed, 0, PLAN))
    return Stand(cell, found, plan, bool({3, 4, 5} & set(robot.mechanism.task)))


_LOCAL = threading.local()
"""Compiled models belong to one thread."""


def _machine(truth: Truth) -> BatchMachine | Machine:
    """The true robot; rigid ones of a kind that allows it share one compiled model."""
    robot = truth.robot
    if not batch.possible(robot) or any(not fault.absent for fault in truth.faults):
        return truth.machine()
    if getattr(_LOCAL, "robot", None) != robot.text:
        _LOCAL.machine, _LOCAL.robot = BatchMachine(robot), robot.text
    _LOCAL.machine.become(truth.values)
    return _LOCAL.machine


def _conditions(cell: Cell, tools: np.ndarray) -> Conditions:
    """Under what the robot is verified: one payload and temperature, no time that passes, no direction of approach."""
    n, verify = len(tools), cell.verify
    columns = {name: np.full(n, verify.temp) for name in ("temp_arms", "temp_rods", "temp_base", "temp")}
    columns |= {"time": np.zeros(n)} | {f"dir{i + 1}": np.zeros(n) for i in range(len(cell.robot.mechanism.actuators))}
    return Conditions(tools, np.full(n, verify.payload), columns)
