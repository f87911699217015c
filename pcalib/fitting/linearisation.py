"""Residuals of a model on data, and how they depend on every unknown: what fits, diagnoses and plans start from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcalib import prediction, rotation
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.data.readings import POSE, Readings
from pcalib.effects.base import Contribution
from pcalib.errors import InputError
from pcalib.fitting import least_squares
from pcalib.fitting.unknowns import Unknowns
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Frame, Model
from pcalib.prediction import Conditions, Prediction, View
from pcalib.sensors.base import Block, Scene

ROWS = 2000
"""Rows of a chunk: whitened Jacobians of 2000 poses by 70 unknowns are 7 MB, and calls cost little beside them."""


def chunks(n: int) -> Iterator[slice]:
    """Slices of at most ROWS rows that cover n rows."""
    return (slice(start, min(start + ROWS, n)) for start in range(0, n, ROWS))


MOVED, ANEW = 1e-3, 10.0
"""A tracker is said to have been set up anew where the RMS error exceeds MOVED [m], and ANEW times what is left in the
frame found anew."""
FEWEST_ANEW = 6
"""Fewest rows from which that is said: six positions give eighteen numbers for the six parameters of a frame."""
TURNED = np.radians(1.0)
"""[rad] mean turn of the plate from the drawing, in a tracker's frame, from which on the tracked body's own axes are
unknowns from the start: the tolerances of parts turn no plate so far, and who glues a target on does not align it
better. A smaller turn is tried where a fit without it leaves much."""


@dataclass(frozen=True)
class Linearisation:
    """Whitened residuals of measured scalars and their derivatives by every unknown."""

    residual: np.ndarray
    """(M,) (measured − predicted)/σ."""
    jacobian: np.ndarray
    """(M, n) by geometry, effects and frame, side by side."""
    n_geometry: int
    row: np.ndarray
    """(M,) pose of each scalar."""
    component: np.ndarray
    """(M,) 0…5 for x y z rx ry rz."""
    prediction: Prediction
    motion: np.ndarray
    """(N, n_state, n_geometry) of the plates about their measured points, by geometry."""

    @property
    def geometry(self) -> np.ndarray:
        """(M, n_geometry)."""
        return self.jacobian[:, : self.n_geometry]

    @property
    def nuisance(self) -> np.ndarray:
        """(M, n_effects + n_frame) what is unknown beside the geometry."""
        return self.jacobian[:, self.n_geometry :]

    @property
    def padded(self) -> np.ndarray:
        """(N, 6, n) derivatives row by row; 0 where nothing is measured."""
        out = np.zeros((len(self.prediction.q), 6, self.jacobian.shape[1]))
        out[self.row, self.component] = self.jacobian
        return out

    def grams(self, weight: np.ndarray) -> np.ndarray:
        """JᵀwJ (6, n, n) of every component, for weights w (N,) of the rows."""
        out = np.zeros((6, self.jacobian.shape[1], self.jacobian.shape[1]))
        J = self.jacobian * np.sqrt(weight)[self.row, None]
        for c in np.unique(self.component):
            rows = J[self.component == c]
            out[c] = rows.T @ rows
        return out

    @cached_property
    def triangle(self) -> np.ndarray:
        """Triangular factor of [jacobian residual], at most (n + 1, n + 1): all that the M scalars say."""
        return least_squares.triangle(self.jacobian, self.residual)


@dataclass(frozen=True)
class Information:
    """All that rows say of a step of the unknowns."""

    triangle: np.ndarray
    """(·, n + 1) triangular factor of √w·[J r], J whitened derivatives and r whitened residuals; at most n + 1 rows."""
    plain: np.ndarray
    """The same without weights."""
    motion: np.ndarray | None
    """(N, n_state, n_geometry) of the plates about their measured points, by geometry; None for more than ROWS rows."""
    grams: Callable[[], np.ndarray]
    """Gives Jᵀw²J of every component, (6, n, n): for traces and products, never to be inverted."""


def conditions_of(data: Measurements) -> Conditions:
    """Tools, payloads and further columns of a data set."""
    targeted = None if data.readings is None else data.readings.sensor == POSE
    return Conditions(data.tool, data.payload, data.columns, targeted)


def predicted(model: Model, data: Measurements, start: Pose | None = None) -> Prediction:
    """What a model predicts for the rows of a data set, whatever reads them."""
    return viewed(model, prediction.predict(model, data.q, conditions_of(data), start), data.readings)


def viewed(model: Model, p: Prediction, readings: Readings | None) -> Prediction:
    """A prediction of N rows as sensors see them; whatever values the N readings have."""
    return p if readings is None else replace(p, view=_view(model, p, readings))


def _scene(model: Model, p: Prediction, rows: np.ndarray, origin: np.ndarray | None = None) -> Scene:
    x, R = prediction.in_base(p)
    gravity = model.robot.gravity
    size = float(np.linalg.norm(gravity))
    up = -gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
    return Scene(x[rows], R[rows], up, None if origin is None else x[origin[rows]])


def _view(model: Model, p: Prediction, readings: Readings) -> View:
    """What the sensors should read."""
    rows = np.flatnonzero(readings.sensor != POSE)
    place = np.full(len(readings.sensor), -1)
    place[rows] = np.arange(len(rows))
    first = dict(zip((b.name for b in model.setup), np.cumsum([0, *(len(b.theta) for b in model.setup)]), strict=False))
    known = {block.name: block.theta for block in model.setup}
    total = sum(map(len, known.values()))
    value, by = np.zeros((len(rows), 6)), np.zeros((len(rows), 6, 6))
    own = np.zeros((len(rows), 6, total))
    by_origin = None if readings.origin is None else np.zeros((len(rows), 6, 6))
    for sensor, to, mine in readings.parts:
        names = [block.name for block in sensor.blocks(to, readings.options)]
        if lacking := [name for name in names if name not in known]:
            raise InputError(
                f"the model does not know {', '.join(lacking)}, which {sensor.title} are measured with",
                remedy="fit data that were measured with it",
            )
        seen = sensor.see(_scene(model, p, mine, readings.origin), [known[name] for name in names])
        at, places = place[mine][:, None], [where for where, _ in sensor.quantities.values()]
        value[at, places], by[at, places] = seen.value, seen.by_twist
        if by_origin is not None and seen.by_origin is not None:
            by_origin[at, places] = seen.by_origin
        columns = np.array([i for name in names for i in first[name] + np.arange(len(known[name]))], int)
        own[at[..., None], np.array(places)[:, None], columns] = seen.own
    origin = None if readings.origin is None else readings.origin[rows]
    return View(rows, value, by, own, origin, by_origin)


def residuals(model: Model, data: Measurements, start: Pose | None = None) -> tuple[np.ndarray, Prediction]:
    """Measured − predicted (N, 6) [m, rad], NaN where not measured or not reached, and the prediction.

    Args:
        start: poses from which forward kinematics starts.
    """
    p = predicted(model, data, start)
    error = np.full((len(data.q), 6), np.nan)
    error[:, :3] = data.position - p.position
    turned = data.turned
    if turned.any():
        rows = slice(None) if turned.all() else turned
        error[rows, 3:] = rotation.log(data.rotation[rows] @ rotation.transposed(p.rotation[rows]))
    if p.view is not None:
        assert data.readings is not None
        error[p.view.rows] = data.readings.value[p.view.rows] - p.view.value
    error[~data.mask] = np.nan
    error[~p.reached] = np.nan
    return error, p


def in_space(error: np.ndarray, p: Prediction) -> np.ndarray:
    """Residuals (N, 6) as motions of the measured point and body (N, 6) [m, rad]: of what a sensor reads, the smallest
    motion in the base frame that would explain it, NaN where its readings tell of none."""
    if p.view is None:
        return error
    out = error.copy()
    given = error[p.view.rows]
    seen = p.view.by_twist * np.isfinite(given)[:, :, None]
    motion = (np.linalg.pinv(seen) @ np.nan_to_num(given)[..., None])[..., 0]
    out[p.view.rows] = np.where(np.any(seen != 0, axis=1), motion, np.nan)
    return out


def linearise(
    model: Model,
    data: Measurements,
    unknowns: Unknowns,
    at: tuple[np.ndarray, Prediction] | None = None,
    noise: Noise | None = None,
) -> Linearisation:
    """Whitened residuals and Jacobians of a model on data.

    Args:
        at: what :func:`residuals` gave for this model and these data, where it is known already.
        noise: that of the readings; what the data state where it is absent.
    """
    error, p = at if at is not None else residuals(model, data)
    basis = None if unknowns.level.raw and unknowns.keep.all() else unknowns.basis
    if unknowns.n_effects:
        assert p.situation is not None
        closed, JX = prediction.closure_of(model, p)
        motion = prediction.geometry_motion(model, p, closed, JX, basis)
        parts = prediction.unit_contributions(model, p.situation)
        effects = [prediction.effect_columns(model, p, closed, JX, parts)]
    else:
        motion, effects = prediction.response(model, p, basis), []
    blocks = [prediction.readings(model, p, motion), *effects]
    if unknowns.n_frame:
        blocks.append(prediction.frame_columns(model, p))
    if unknowns.n_setup:
        blocks.append(prediction.setup_columns(p, unknowns.n_setup))
    columns = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=-1)
    noise = Noise.of(data) if noise is None else noise
    whitened = noise.whiten(error), noise.whiten(columns)
    return Linearisation(*whitened, unknowns.n_geometry, noise.row, noise.component, p, motion)


def evaluate(model: Model, data: Measurements, start: Pose | None = None) -> tuple[np.ndarray, Prediction]:
    """Residuals and prediction; of more than ROWS rows the prediction keeps readings, poses and status only."""
    if len(data) <= ROWS:
        return residuals(model, data, start)
    parts = [residuals(model, data.take(r), None if start is None else start.take(r)) for r in chunks(len(data))]

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(p, name) for _, p in parts])

    poses = [p.pose for _, p in parts]
    each = ([p.x for p in poses], [p.R for p in poses], [p.phi for p in poses])
    pose = Pose(*(np.concatenate(part) for part in each))
    status = joined("status")
    slim = Prediction(
        joined("position"), joined("rotation"), joined("q"), pose, joined("tool"), Contribution(), status,
        unsettled=joined("reached") & (status != "ok"),
    )  # fmt: skip
    return np.concatenate([error for error, _ in parts]), slim


def information(
    model: Model,
    data: Measurements,
    unknowns: Unknowns,
    at: tuple[np.ndarray, Prediction],
    noise: Noise,
    weight: np.ndarray,
) -> Information:
    """What weighted rows say at a model, gathered chunk by chunk: memory does not grow with the rows.

    Args:
        at: what :func:`evaluate` gave for this model and these data.
        weight: (N,) of each row.
    """

    def weighted(linear: Linearisation, weight: np.ndarray) -> np.ndarray:
        root = np.sqrt(weight)[linear.row]
        return least_squares.triangle(linear.jacobian * root[:, None], linear.residual * root)

    def added(whole: np.ndarray, part: np.ndarray) -> np.ndarray:
        both = np.concatenate([whole, part])
        return least_squares.triangle(both[:, :-1], both[:, -1])

    alike = bool((weight == 1).all())
    if len(data) <= ROWS:
        linear = linearise(model, data, unknowns, at, noise)
        triangle = linear.triangle if alike else weighted(linear, weight)
        return Information(triangle, linear.triangle, linear.motion, lambda: linear.grams(weight**2))
    plain = whole = np.zeros((0, len(unknowns.names) + 1))
    grams = np.zeros((6, len(unknowns.names), len(unknowns.names)))
    for r in chunks(len(data)):
        part = data.take(r)
        linear = linearise(model, part, unknowns, residuals(model, part, at[1].pose.take(r)), noise.take(r))
        plain = added(plain, linear.triangle)
        whole = plain if alike else added(whole, weighted(linear, weight[r]))
        grams += linear.grams(weight[r] ** 2)
    return Information(whole, plain, None, lambda: grams)


def joint_response(model: Model, data: Measurements, pose: Pose) -> np.ndarray:
    """Derivative of the readings by the position of every actuator, (N, 6, nq).

    Args:
        pose: (N,) from which forward kinematics starts.
    """
    mechanism = model.robot.mechanism
    out = np.empty((len(data), 6, len(mechanism.actuators)))
    for r in chunks(len(data)):
        _, p = residuals(model, data.take(r), pose.take(r))
        one = np.broadcast_to(np.eye(out.shape[-1]), (len(p.q), out.shape[-1], out.shape[-1]))
        parts = [Contribution(actuator=one[:, i]) for i in range(out.shape[-1])]
        out[r] = prediction.effect_columns(model, p, *prediction.closure_of(model, p), parts)
    return out


def seen_from(model: Model, data: Measurements) -> Model:
    """The model with the set-up that measured the data: the frame of a tracker, none in the base, and stations and
    surfaces; what of it the model does not know yet is found from the data."""
    if data.frame != "tracker":
        model = replace(model, frame=None)
    elif model.frame is None:
        model = replace(model, frame=register(model, data))
    if model.frame is not None:
        model = replace(model, frame=replace(model.frame, sigma_offset=data.target_known))
    return replace(model, setup=() if data.readings is None else _setup(model, data, data.readings))


def _setup(model: Model, data: Measurements, readings: Readings) -> tuple[Block, ...]:
    """The unknowns of the sensors, at their values in the model or else at a first guess."""
    known = {block.name: block.theta for block in model.setup}
    out: dict[str, Block] = {}
    p = prediction.predict(model, data.q, conditions_of(data))
    for sensor, to, rows in readings.parts:
        blocks = sensor.blocks(to, readings.options)
        start: tuple[np.ndarray, ...] | None = None
        for i, block in enumerate(blocks):
            theta = known.get(block.name)
            if theta is None or len(theta) != len(block.parameters):
                if start is None:
                    mine = rows[p.status[rows] == "ok"]
                    _require_some(block, len(mine), data)
                    value = readings.value[mine][:, [place for place, _ in sensor.quantities.values()]]
                    start = sensor.start(_scene(model, p, mine), value, to, readings.options)
                theta = start[i]
            out.setdefault(block.name, block.at(theta))
    return tuple(out.values())


def _require_some(block: Block, n: int, data: Measurements) -> None:
    if n < len(block.parameters):
        raise InputError(
            f"{n} readings to {block.name}, which has {len(block.parameters)} unknowns ({', '.join(block.parameters)})",
            file=data.source, remedy="measure to it at more poses, well spread; or leave these rows out",
        )  # fmt: skip


def register(model: Model, data: Measurements) -> Frame:
    """First guess of the frame: the rigid motion that best lays predicted on measured positions (Kabsch)."""
    p = prediction.predict(replace(model, frame=None), data.q, conditions_of(data))
    full = ~np.isnan(data.position).any(axis=1) & (p.status == "ok")
    if full.sum() < 3:
        raise InputError(
            f"only {full.sum()} rows have x, y and z: an unknown frame needs at least 3",
            file=data.source,
            remedy="measure more poses, or in the base frame (# frame = base)",
        )
    R, t = rotation.registered(p.position[full], data.position[full])
    return Frame(R, t, turn=_turn(R @ p.rotation[full], data.rotation[full]))


def set_up_anew(model: Model, data: Measurements) -> Model | None:
    """The model in the frame of a tracker that was set up anew, found from the data; None where it has not been moved.

    The target's place on the plate is kept. Errors of the robot alone are never so large.
    """
    if data.frame != "tracker" or model.frame is None:
        return None
    before, p = residuals(model, data)
    full = ~np.isnan(data.position).any(axis=1) & (p.status == "ok")
    if full.sum() < FEWEST_ANEW:
        return None
    R, t = rotation.registered(p.position[full], data.position[full])
    old = model.frame
    moved = replace(model, frame=replace(old, rotation=R @ old.rotation, translation=R @ old.translation + t))
    after = residuals(moved, data)[0]
    was, now = (float(np.sqrt(np.mean(e[full][:, :3] ** 2))) for e in (before, after))
    return moved if was > MOVED and was > ANEW * now else None


def body_turned(model: Model, data: Measurements) -> Model | None:
    """The model with the axes of the tracked body as unknowns, at a first guess; None where they are unknowns already,
    or where no rotation is measured in a tracker's frame."""
    frame = model.frame
    if data.frame != "tracker" or frame is None or frame.turn is not None:
        return None
    p = prediction.predict(replace(model, frame=None), data.q, conditions_of(data))
    ok = p.status == "ok"
    turn = _turn(frame.rotation @ p.rotation[ok], data.rotation[ok], 0.0)
    return None if turn is None else replace(model, frame=replace(frame, turn=turn))


def _turn(predicted: np.ndarray, measured: np.ndarray, least: float = TURNED) -> np.ndarray | None:
    """(3, 3) axes of the tracked body in the plate's where they are not the plate's own; None where they are, or where
    no rotation is measured.

    Args:
        least: [rad] turn from which on they are not.
    """
    given = ~np.isnan(measured).any(axis=(1, 2))
    if not given.any():
        return None
    mean = np.mean(rotation.transposed(predicted[given]) @ measured[given], axis=0)
    U, _, Vt = np.linalg.svd(mean)
    turn = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return turn if np.linalg.norm(rotation.log(turn[None])) > least else None
