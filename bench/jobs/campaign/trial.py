"""One robot of a campaign: measured in MuJoCo, identified, compensated, and checked in MuJoCo. A pure function.

Everything random comes from streams that depend on the campaign's seed and the robot's number only. Robot 7 has the
same unit errors, the same noise and the same poses in every cell, so that cells differ by what is swept and not by
luck.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from bench import batch, simulate
from bench.batch import BatchMachine
from bench.commands import Commands, Landing
from bench.jobs import alignment
from bench.jobs.campaign import samples
from bench.jobs.campaign.cell import Cell
from bench.jobs.campaign.spec import Spec
from bench.jobs.methods import Method
from bench.jobs.study import seed, stream
from bench.machine import Machine
from bench.plan import Plan
from bench.truth import Truth
from pcalib import compensation, workspace
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError, PcalibError
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Model
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
class Specimen:
    """One robot as it really is, and what the instrument saw of it."""

    stand: Stand
    seed: int
    """Seed of the landings."""
    machine: BatchMachine | Machine
    data: Measurements


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What a method made of the data."""

    q: np.ndarray
    """(T·P, nq) commands, NaN where there is none."""
    figures: Mapping[str, Any]
    """Figures of the fit."""
    aligned: bool
    """Whether landings are judged after the best rigid motion: the model comes from an unknown frame."""


def run(spec: Spec, number: int) -> list[dict[str, Any]]:
    """The rows of a trial: one per method and tool, whatever happens.

    A robot that cannot be built, measured, identified or checked gives rows with status 'failed' and the reason.
    """
    index, robot = divmod(number, spec.robots)
    methods = spec.cell(index).methods
    try:
        specimen = measured(spec, number)
    except Exception as error:
        return [row for method in methods for row in _failed(spec.cell(index), method, error)]
    outcome: dict[str, Calibrated | Exception] = {}
    for method in methods:
        try:
            outcome[method.name] = commanded(specimen, method)
        except Exception as error:
            outcome[method.name] = error
    good = {name: found for name, found in outcome.items() if isinstance(found, Calibrated)}
    landed: dict[str, Landing] = {}
    if good:
        try:
            landed = verified(specimen, good)
        except Exception as error:
            outcome |= dict.fromkeys(good, error)
    out: list[dict[str, Any]] = []
    for method in methods:
        found = outcome[method.name]
        if isinstance(found, Exception):
            out += _failed(specimen.stand.cell, method, found)
        else:
            out += _rows(specimen, method, found, landed[method.name], robot < spec.output.map_robots)
    return out


def given_up(spec: Spec, number: int, reason: str) -> list[dict[str, Any]]:
    """The rows of a trial that could not be tried to its end."""
    cell = spec.cell(number // spec.robots)
    return [row for method in cell.methods for row in _failed(cell, method, PcalibError(reason))]


def landings(spec: Spec, number: int) -> dict[str, Landing]:
    """Where a trial's robot ends up with the commands of each method, targets of all tools one after the other.

    Raises:
        PcalibError: the robot cannot be measured, or a method fails.
    """
    specimen = measured(spec, number)
    return verified(specimen, {m.name: commanded(specimen, m) for m in specimen.stand.cell.methods})


def steps(spec: Spec, number: int) -> dict[str, Callable[[], object]]:
    """The steps of a trial as functions that may be called repeatedly: measuring, each method, verifying."""
    specimen = measured(spec, number)
    calibrated = {m.name: commanded(specimen, m) for m in specimen.stand.cell.methods}
    out: dict[str, Callable[[], object]] = {"measuring": lambda: measured(spec, number)}
    for method in specimen.stand.cell.methods:
        out[f"{method.name}, fit and commands"] = lambda method=method: commanded(specimen, method)
    return out | {"verifying": lambda: verified(specimen, calibrated)}


# -- the steps ---------------------------------------------------------------------------------------------------------


def truth_errors(spec: Spec, number: int) -> np.ndarray:
    """(nk,) true minus nominal parameters of a trial's robot [m, rad, 1]."""
    index, robot = divmod(number, spec.robots)
    return spec.cell(index).geometry.errors(robot, stream(spec.seed, robot, GEOMETRY))


def measured(spec: Spec, number: int) -> Specimen:
    """The robot of a trial, measured."""
    index, robot = divmod(number, spec.robots)
    shared = stand(spec, index)
    cell, rng = shared.cell, stream(spec.seed, robot, FAULTS)
    present = tuple(fault.make(cell.robot, rng) for fault in cell.faults)
    truth = Truth(cell.robot, truth_errors(spec, number), cell.instrument, present)
    machine = _machine(truth)
    plan = shared.plan or samples.own(cell.robot, cell.poses, seed(spec.seed, robot, PLAN))
    data = simulate.run(truth, plan, seed(spec.seed, robot, INSTRUMENT), machine=machine)
    return Specimen(shared, seed(spec.seed, robot, LANDING), machine, data.measurements)


def commanded(specimen: Specimen, method: Method) -> Calibrated:
    """What a method makes of the measurements: a model, and its commands for all targets.

    Raises:
        FitError: the fit did not converge, or the data cannot support the level.
    """
    shared, figures = specimen.stand, {}
    model = Model.nominal(shared.cell.robot)
    if method.identifies:
        fit = method.identify(specimen.data, shared.cell.robot)
        model, figures = fit.model, {
            "fit_rms_um": fit.accuracy.rms_pos * 1e6,
            "fit_chi2_dof": fit.accuracy.chi2_dof,
            "identified": fit.n_identified,
            "iterations": fit.iterations,
            "prior_scale": fit.prior_scale,
        }  # fmt: skip
    goals, tools = shared.goals, shared.tools
    commands = compensation.compensate(
        model,
        goals.tcp(tools),
        rotation_matrix=goals.R if shared.oriented else None,
        conditions=_conditions(shared.cell, tools),
        method=method.compensation,
    )
    return Calibrated(commands.q, figures, model.frame is not None)


def verified(specimen: Specimen, calibrated: Mapping[str, Calibrated]) -> dict[str, Landing]:
    """Where the true robot ends up with each method's commands, all in one go, as it is judged.

    Its drives repeat themselves as badly as while it was measured, at each target alike for all methods.
    """
    shared, machine, n = specimen.stand, specimen.machine, len(calibrated)
    cell, goals = shared.cell, shared.goals
    conditions = _conditions(cell, np.tile(shared.tools, (n, 1)))
    q = np.concatenate([c.q for c in calibrated.values()])
    asked = Commands(q, conditions.tool, conditions.payload, conditions.columns)
    size, drives = len(goals), cell.robot.mechanism.actuator_dimension
    miss = np.tile(cell.instrument.joint_noise(q[:size], drives, specimen.seed, np.arange(size)), (n, 1))
    if isinstance(machine, BatchMachine):
        landing = machine.run(asked, miss, near=(np.tile(goals.x, (n, 1)), np.tile(goals.R, (n, 1, 1))))
    else:
        landing = machine.run(asked, miss)
    return {
        name: _judged(shared, landing.take(slice(i * size, (i + 1) * size)), one.aligned)
        for i, (name, one) in enumerate(calibrated.items())
    }


def _judged(shared: Stand, landing: Landing, aligned: bool) -> Landing:
    """A landing with the TCP's directions that no command prescribes as wanted, and aligned, tool by tool."""
    loose, goals = workspace.uncommanded(shared.cell.robot), shared.goals.tcp(shared.tools)
    tcp, R, status = landing.tcp.copy(), landing.R.copy(), landing.status.copy()
    tcp[:, loose] = np.where(np.isnan(tcp[:, loose]), np.nan, goals[:, loose])
    P = len(shared.targets)
    for here in (slice(i, i + P) for i in range(0, len(tcp) if aligned else 0, P)):
        if landing.ok[here].sum() < 3:
            status[here][landing.ok[here]] = UNALIGNED
            continue
        turn, shift = alignment.motion(tcp[None, here], goals[here])
        tcp[here], R[here] = tcp[here] @ turn.T + shift, turn @ R[here]
    return Landing(landing.x, R, tcp, status)


def _rows(specimen: Specimen, method: Method, found: Calibrated, landing: Landing, keep: bool) -> list[dict[str, Any]]:
    """One row per tool; the error at every target only where it is to be kept."""
    out, shared = [], specimen.stand
    P = len(shared.targets)
    error = np.linalg.norm(landing.tcp - shared.goals.tcp(shared.tools), axis=1)
    # Of a small angle between two rotations, from the length of their difference: |ΔR| = 2√2 sin(angle/2).
    far = np.linalg.norm(landing.R - shared.goals.R, axis=(1, 2)) / np.sqrt(8.0)
    tilt = 2 * np.arcsin(np.minimum(far, 1.0))
    for t, tool in enumerate(shared.cell.verify.tools):
        here = slice(t * P, (t + 1) * P)
        ok = landing.ok[here]
        row = {**_named(method, tool), "targets": P, "reached": int(ok.sum()), "measured": len(specimen.data)}
        row |= found.figures
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


def _failed(cell: Cell, method: Method, error: Exception) -> list[dict[str, Any]]:
    """One row per tool that says why there are no figures.

    Raises:
        MemoryError, OSError: errors of the computer, which are no property of the robot.
    """
    if isinstance(error, (MemoryError, OSError)):
        raise error
    said = error.problem if isinstance(error, InputError) else str(error)
    reason = (said.splitlines() or [""])[0]
    if not isinstance(error, PcalibError):
        reason = f"{type(error).__name__}: {reason}"
    nothing = {"status": "failed", "reason": reason, "targets": cell.verify.targets, "reached": 0}
    return [{**_named(method, tool), **nothing} for tool in cell.verify.tools]


def _named(method: Method, tool: np.ndarray) -> dict[str, Any]:
    return {"method": method.name, "tool": tool_label(tool), "tool_length_mm": float(np.linalg.norm(tool) * 1e3)}


def tool_label(tool: np.ndarray) -> str:
    """A tool as a command line takes it: '0,0,-300mm'."""
    return ",".join(f"{round(float(v) * 1e3, 6) + 0.0:.12g}" for v in tool) + "mm"


# -- what robots share -------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def stand(spec: Spec, index: int) -> Stand:
    """What all robots of a cell share."""
    cell = spec.cell(index)
    targets = samples.targets(cell.robot, cell.verify, seed(spec.seed, 0, TARGETS))
    plan = samples.shared(cell.robot, cell.poses, cell.instrument, seed(spec.seed, 0, PLAN))
    return Stand(cell, targets, plan, bool({3, 4, 5} & set(cell.robot.mechanism.task)))


class _Local(threading.local):
    """Compiled models belong to one thread."""

    robot: str = ""
    machine: BatchMachine


_LOCAL = _Local()


def _machine(truth: Truth) -> BatchMachine | Machine:
    """The true robot; rigid ones of a kind that allows it share one compiled model."""
    robot = truth.robot
    if not batch.possible(robot) or any(not fault.absent for fault in truth.faults):
        return truth.machine()
    if robot.text != _LOCAL.robot:
        _LOCAL.machine, _LOCAL.robot = BatchMachine(robot), robot.text
    _LOCAL.machine.become(truth.values)
    return _LOCAL.machine


def _conditions(cell: Cell, tools: np.ndarray) -> Conditions:
    """Conditions of the verification: one payload and temperature, no time that passes, no direction of approach."""
    n, verify = len(tools), cell.verify
    columns = {name: np.full(n, verify.temp) for name in ("temp_arms", "temp_rods", "temp_base", "temp")}
    columns |= {"time": np.zeros(n)} | {f"dir{i + 1}": np.zeros(n) for i in range(len(cell.robot.mechanism.actuators))}
    return Conditions(tools, np.full(n, verify.payload), columns)
