"""Whether data can support a fit at all: poses that close, columns in order, enough readings for the level."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import lru_cache

import numpy as np

from pcalib import prediction
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.fitting import as_drawn, linearisation, mixups
from pcalib.fitting.identifiability import THRESHOLD, without
from pcalib.fitting.unknowns import Unknowns, unknowns_of
from pcalib.model import Frame, Model
from pcalib.prediction import Conditions, Prediction
from pcalib.robot import Robot

Kind = tuple[tuple[bool, ...], tuple[float, ...]]
"""What a row measures, (6,), and with which tool, (3,) [m]."""
_KINDS = 6
"""The commonest kinds of rows that count for what a level can identify."""


def require_reach(p: Prediction, data: Measurements) -> None:
    """Refuse data with a command at which the loops cannot close."""
    bad = np.flatnonzero(~p.reached)
    if len(bad):
        more = f" (and {len(bad) - 1} more rows)" if len(bad) > 1 else ""
        raise InputError(
            f"the robot cannot close its loops at this command: {str(p.status[bad[0]]).replace('_', ' ')}{more}",
            file=data.source,
            line=int(data.lines[bad[0]]),
            remedy="check the sign, order and unit of the actuator columns, and that robot and data belong together",
        )


def require_rows(data: Measurements) -> None:
    """Refuse data with no rows to fit."""
    if data.check.all():
        remedy = "mark some rows fit, or leave the column 'set' out"
        raise InputError("no rows to fit: all are set = check", file=data.source, remedy=remedy)


def require_usable(model: Model, data: Measurements) -> None:
    """Refuse data that a model cannot be compared with: no rows to fit, loops that do not close, columns mixed up."""
    require_rows(data)
    fitted = data.take(~data.check)
    error, p = linearisation.residuals(model, fitted)
    require_reach(p, fitted)
    require_order(error, fitted, model.robot)


def require_order(error: np.ndarray, data: Measurements, robot: Robot) -> None:
    """Refuse data that fit the nominal robot only with columns swapped, axes mirrored or another unit of angles.

    Args:
        error: (N, 6) residuals of the nominal robot, or of a calibrated one.
    """
    length, turn = (np.linalg.norm(e[~np.isnan(e).any(axis=1)], axis=1) for e in (error[:, :3], error[:, 3:]))
    if not len(length) or (
        np.median(length) < as_drawn.LARGE and not (len(turn) and np.median(turn) > as_drawn.LARGE_TURN)
    ):
        return
    found = mixups.judge(data, robot)
    if found.readings:
        raise InputError(
            mixups.sentence(found, as_drawn.compare(data, robot)), file=data.source, remedy=mixups.remedy(found)
        )


def require_enough(model: Model, data: Measurements, unknowns: Unknowns) -> int:
    """Directions that the level should identify from such readings; refuses data with no reading to spare."""
    if unknowns.n_geometry == 0:
        return 0
    count = _expected_of_poses if data.readings is None else _expected_of
    expected = count(data, model, unknowns)
    needed = expected + unknowns.n_registration + 1
    readings = int(data.mask.sum())
    if readings < needed:
        n = len(data.q)
        least = int(np.ceil(needed * n / max(readings, 1)))
        raise InputError(
            f"too few poses: {n} pose{'s' * (n != 1)} give{'s' * (n == 1)} {readings} readings, "
            f"level {unknowns.level.name} needs {needed}",
            file=data.source,
            remedy=f"measure at least {least} poses (three times as many is usual), or fit a simpler level",
        )
    return expected


def _expected_of_poses(data: Measurements, model: Model, unknowns: Unknowns) -> int:
    tools = np.round(data.tool, 6).tolist()
    rows = [(tuple(mask), tuple(tool)) for mask, tool in zip(data.mask.tolist(), tools, strict=True)]
    kinds = tuple(sorted(kind for kind, _ in Counter(rows).most_common(_KINDS)))
    return expected_rank(
        model.robot, unknowns.level.name, tuple(unknowns.keep), kinds, tuple(_typical(data)), unknowns.n_frame
    )


def _expected_of(data: Measurements, model: Model, unknowns: Unknowns) -> int:
    """Directions that the sensors of a file, as they stand, would identify at 40 well-spread poses with each tool."""
    from pcalib.workspace import reachable

    assert data.readings is not None
    read = zip(data.readings.sensor, data.readings.to, data.mask.tolist(), np.round(data.tool, 6).tolist(), strict=True)
    first: dict[tuple, list[int]] = {}
    for row, (sensor, to, mask, tool) in enumerate(read):
        first.setdefault((sensor, to, tuple(mask), tuple(tool)), []).append(row)
    most = sorted(first.values(), key=len, reverse=True)[:_KINDS]
    q = reachable(model.robot, 40, np.random.default_rng(0)).q
    rows = data.take(np.repeat([kind[0] for kind in most], len(q)))
    nominal = model.with_geometry(model.robot.mechanism.nominal)
    linear = linearisation.linearise(nominal, replace(rows, q=np.tile(q, (len(most), 1))), unknowns)
    g = unknowns.n_geometry
    J = without(linear.jacobian[:, :g], linear.jacobian[:, g:] * unknowns.scale[g:])
    J = J[np.isfinite(J).all(axis=1)]
    return int(np.sum(np.linalg.svd(J * unknowns.scale[:g], compute_uv=False) > THRESHOLD))


def _typical(data: Measurements) -> np.ndarray:
    """(6,) median σ of the measured components; 1 where a component is never measured."""
    columns = [np.sort(data.sigma[m, c]) for c, m in enumerate(data.mask.T)]
    return np.array([column[len(column) // 2] if len(column) else 1.0 for column in columns])


@lru_cache(maxsize=64)
def expected_rank(
    robot: Robot, level: str, keep: tuple[bool, ...], kinds: tuple[Kind, ...], sigma: tuple[float, ...], frame: int
) -> int:
    """Directions that 40 well-spread poses of each kind would identify at nominal geometry.

    Args:
        keep: which columns of the level are free.
        sigma: (6,) [m, rad] of the instrument.
        frame: how many unknowns the measuring frame has: 0, 9, or 12 where the target's turn is one.
    """
    from pcalib.workspace import reachable

    q = reachable(robot, 40, np.random.default_rng(0)).q
    nominal = replace(Model.nominal(robot), frame=Frame(turn=np.eye(3) if frame == 12 else None) if frame else None)
    chosen = unknowns_of(nominal, level, frame=frame > 0)
    basis = chosen.level.basis[:, np.array(keep, bool)]
    scale = chosen.scale[: chosen.n_geometry][np.array(keep, bool)]
    rows, frames = [], []
    for mask, tool in kinds:
        p = prediction.predict(nominal, q, Conditions.of(len(q), tool))
        at, JX = prediction.closure_of(nominal, p)
        seen = np.flatnonzero(mask)
        noise = np.array(sigma)[seen][:, None]
        J = prediction.geometry_columns(nominal, p, at, JX, basis)[:, seen] / noise
        rows.append(J.reshape(-1, basis.shape[1]))
        if frame:
            F = prediction.frame_columns(nominal, p)[:, seen] / noise
            frames.append(F.reshape(-1, F.shape[-1]))
    scaled = without(np.concatenate(rows), np.concatenate(frames) if frames else None) * scale
    return int(np.sum(np.linalg.svd(scaled, compute_uv=False) > THRESHOLD))
