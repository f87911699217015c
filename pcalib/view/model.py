"""A recording of one model: by how much the nominal robot would miss its targets, as the model predicts it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcalib import compensation, modelfile, prediction, workspace
from pcalib.ladder import ErrorMap, Ladder, Step
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.wording import size

_ROUNDING = 1e-9
"""[m] Smaller misses are shown as zero: the model's own commands miss by rounding alone."""


def predicted(
    model: Model, tools: Sequence[np.ndarray] = (), payload: float = 0.0, effect_files: Sequence[str] = ()
) -> Ladder:
    """Predicted misses of the commands of the nominal robot, of each step of the model's history and of the model.

    Effects that need further columns are seen at 20 °C, without direction of motion and at time zero.

    Args:
        tools: (3,) each [m] TCP in the plate frame; none: the plate itself, and a tool some 3/4 as long as the
            workspace's radius that points away from the drives.
        payload: [kg] at the TCP.
        effect_files: the user's own effects that the history may need, as for `modelfile.load`.
    """
    robot, real = model.robot, replace(model, frame=None)
    if not len(tools):
        tools = [np.zeros(3), _one_digit(0.75 * robot.workspace.radius) * robot.mechanism.tool_direction]
    text = "Commands from the drawing; the robot is as the model says."
    steps = [Step("nominal", "As drawn", Model.nominal(robot), "none", text)]
    for i, entry in enumerate(model.history[:-1]):
        then = modelfile.restore(real, entry, effect_files)
        known = " and ".join([f"geometry {then.level}", *(f.effect.name for f in then.effects)])
        text = f"Commands from the model as it was then: {known}. {robot.mechanism.levels[then.level].text}"
        label = f"{entry.get('action', 'step')} {i + 1}"
        steps.append(Step(f"step{i + 1}", label, then, "exact", text))
    text = "Commands from the model itself: by what it says of the robot, nothing is missed. " + _expected(model)
    steps.append(Step("model", "Calibrated", real, "exact", text))
    plate = workspace.workspace_grid(robot)
    maps = []
    for tool in tools:
        wanted = plate + tool
        conditions = _neutral(real, len(wanted), tool, payload)
        fields = [_missed(step.model, real, wanted, conditions) for step in steps]
        errors, status = (np.stack(part) for part in zip(*fields, strict=True))
        maps.append(ErrorMap(np.asarray(tool, float), wanted, errors, status))
    return Ladder(robot, tuple(steps), tuple(maps), "predicted by the model")


def _expected(model: Model) -> str:
    """The error to expect at the measured point: RMS residual of the fit, and apart from it that of held-out poses."""
    last = model.history[-1] if model.history else {}
    figures = ((last, "fitted"), (last.get("check") or {}, "held-out"))
    said = [
        f"{size(1e-6 * float(found['rms_pos_um']))} RMS on {rows} poses"
        for found, rows in figures
        if found.get("rms_pos_um") is not None
    ]
    return f"Expected at the measured point: {', '.join(said)}, the instrument's noise included." if said else ""


def _one_digit(value: float) -> float:
    """The next number below that has one digit only."""
    unit = 10.0 ** math.floor(math.log10(value))
    return unit * math.floor(value / unit + 1e-9)


def _neutral(model: Model, n: int, tool: np.ndarray, payload: float) -> Conditions:
    """Conditions in which only loads act: every column that an effect needs has its reference value."""
    needed = {name for f in model.effects for name in f.effect.needs}
    columns = {name: np.full(n, 20.0 if name.startswith("temp") else 0.0) for name in needed}
    return Conditions(np.broadcast_to(tool, (n, 3)), np.full(n, payload), columns)


def _missed(commanded: Model, real: Model, wanted: np.ndarray, conditions: Conditions) -> tuple[np.ndarray, np.ndarray]:
    """Where the TCP of one model goes by commands of another: errors (P, 3) [m] and status (P,)."""
    commands = compensation.compensate(commanded, wanted, conditions=conditions)
    good = commands.status == "ok"
    errors, status = np.full(wanted.shape, np.nan), commands.status.astype("<U20")
    if good.any():
        p = prediction.predict(real, commands.q[good], conditions.take(good))
        missed = p.position - wanted[good]
        errors[good] = np.where(np.abs(missed) < _ROUNDING, 0.0, missed)
        status[good] = p.status
    errors[status != "ok"] = np.nan
    errors[:, workspace.uncommanded(real.robot)] *= 0.0
    return errors, status
