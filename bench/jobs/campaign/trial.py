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
from bench.jobs import iso9283
from bench.jobs.campaign import samples
from bench.jobs.campaign.cell import Cell, Method
from bench.jobs.campaign.spec import Campaign
from bench.machine import Machine
from bench.plan import Plan
from bench.truth import Truth
from pcalib import compensation, effects, workspace
from pcalib.data.measurement import Measurements
from pcalib.errors import PcalibError
from pcalib.fitting import identification
from pcalib.mechanics.mechanism import Pose
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions

GEOMETRY, PLAN, INSTRUMENT, FAULTS, TARGETS, LANDING = range(6)
"""Streams of random numbers."""
PERCENTILE = 95
UNALIGNED = "unaligned"
"""Status of a target that the robot reached with too few others to take out the rigid motion of the tracker."""


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


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What a method made of the data."""

    q: np.ndarray
    """(T·P, nq) commands, NaN where there is none."""
    figures: Mapping[str, Any]
    """Of the fit."""
    aligned: bool
    """Whether landings are judged after the best rigid motion: the model comes from an unknown frame."""


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
    calibrated: dict[str, Calibrated | Exception] = {}
    for method in cell.methods:
        try:
            calibrated[method.name] = _commanded(shared, method, data)
        except Exception as error:
            _let_pass(error)
            calibrated[method.name] = error
    good = {name: outcome for name, outcome in calibrated.items() if isinstance(outcome, Calibrated)}
    landed: dict[str, Landing] = {}
    if good:
        try:
            landed = _verified(campaign, shared, robot, machine, good)
        except Exception as error:
            _let_pass(error)
            calibrated |= dict.fromkeys(good, error)
    out: list[dict[str, Any]] = []
    for method in cell.methods:
        outcome = calibrated[method.name]
        if isinstance(outcome, Exception):
            out += _failed(head, cell, method, outcome)
        else:
            out += _rows(head, shared, method, outcome.figures, len(data), landed[method.name], keep)
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
    calibrated = {method.name: _commanded(shared, method, data) for method in shared.cell.methods}
    return _verified(campaign, shared, robot, machine, calibrated)


def steps(campaign: Campaign, number: int) -> dict[str, Callable[[], object]]:
    """The steps of a trial, each to be called as often as one likes: measuring, each method, verifying."""
    index, robot = divmod(number, campaign.robots)
    shared = stand(campaign, index)
    machine, data = _measured(campaign, shared, robot)
    calibrated = {method.name: _commanded(shared, method, data) for method in shared.cell.methods}
    out: dict[str, Callable[[], object]] = {"measuring": lambda: _measured(campaign, shared, robot)}
    for method in shared.cell.methods:
        out[f"{method.name}, fit and commands"] = lambda method=method: _commanded(shared, method, data)
    return out | {"verifying": lambda: _verified(campaign, shared, robot, machine, calibrated)}


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


def _commanded(stand: Stand, method: Method, data: Measurements) -> Calibrated:
    """The commands of a method."""
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
    return Calibrated(commands.q, figures, model.frame is not None)


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
        "fit_rms_um": fit.accuracy.rms_pos * 1e6,
        "fit_chi2_dof": fit.accuracy.chi2_dof,
        "identified": fit.n_identified,
        "iterations": fit.iterations,
        "prior_scale": fit.prior_scale,
    }
    return fit.model, figures


def _verified(
    campaign: Campaign,
    stand: Stand,
    robot: int,
    machine: BatchMachine | Machine,
    calibrated: Mapping[str, Calibrated],
) -> dict[str, Landing]:
    """Where the true robot ends up with each method's commands, all in one go, as it is judged.

    Its drives repeat themselves as badly as while it was measured, at each target alike for all methods.
    """
    cell, goals, n = stand.cell, stand.goals, len(calibrated)
    conditions = _conditions(cell, np.tile(stand.tools, (n, 1)))
    q = np.concatenate([c.q for c in calibrated.values()])
    asked = Commands(q, conditions.tool, conditions.payload, conditions.columns)
    size = len(goals)
    seed, drives = _seed(campaign.seed, robot, LANDING), cell.robot.mechanism.actuator_dimension
    miss = np.tile(cell.instrument.joint_noise(q[:size], drives, seed, np.arange(size)), (n, 1))
    if isinstance(machine, BatchMachine):
        landing = machine.run(asked, miss, near=(np.tile(goals.x, (n, 1)), np.tile(goals.R, (n, 1, 1))))
    else:
        landing = machine.run(asked, miss)
    return {
        name: _judged(stand, landing.take(slice(i * size, (i + 1) * size)), one.aligned)
        for i, (name, one) in enumerate(calibrated.items())
    }


def _judged(stand: Stand, landing: Landing, aligned: bool) -> Landing:
    """A landing with the TCP's directions that no command prescribes as wanted, and aligned, tool by tool."""
    loose, goals = workspace.uncommanded(stand.cell.robot), stand.goals.tcp(stand.tools)
    tcp, R, status = landing.tcp.copy(), landing.R.copy(), landing.status.copy()
    tcp[:, loose] = np.where(np.isnan(tcp[:, loose]), np.nan, goals[:, loose])
    P = len(stand.targets)
    for here in (slice(i, i + P) for i in range(0, len(tcp) if aligned else 0, P)):
        if landing.ok[here].sum() < 3:
            status[here][landing.ok[here]] = UNALIGNED
            continue
        turn, shift = iso9283.motion(tcp[None, here], goals[here])
        tcp[here], R[here] = tcp[here] @ turn.T + shift, turn @ R[here]
    return Landing(landing.x, R, tcp, status)


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
            reason = "the robot reached none of the targets"
            if (landing.status[here] == UNALIGNED).any():
                reason = "the robot reached fewer than three of the targets: no rigid motion can be taken out"
            out.append({**row, "status": "failed", "reason": reason})
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
    return ",".join(f"{round(float(v) * 1e3, 6) + 0.0:.12g}" for v in tool) + "mm"


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
