"""Identification: from measured poses to geometry, effects and measuring frame.

Unknowns z are level coordinates, effect parameters and the frame. The cost is

    Σ_rows w_r·|W·(measured − predicted(z))|² + Σ ((z_j − z_j⁰)/σ_j)²

with W from the instrument's σ, manufacturing priors σ_j (MAP) and optional robust weights w_r; it is minimised by
Levenberg–Marquardt on scaled unknowns, each step by QR. Methods:

* ``map``: all parameters of the level with priors; never ill-posed. The default. Where the robot is less accurate
  than the tolerances say, their common scale is estimated from the data (evidence maximisation, MacKay 1992).
* ``base``: the identifiable base only (pivoted QR), no priors: the classical Gauss–Newton calibration.
* ``linear``: one least-squares step at nominal on the base (paper eqs 23–26); pairs with first-order compensation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pcalib import least_squares, prediction, rotation
from pcalib.errors import FitError, InputError, unknown
from pcalib.identifiability import THRESHOLD, Identifiability, analyse, project_out
from pcalib.measurement import Measurements
from pcalib.model import FittedEffect, Frame, Model
from pcalib.prediction import Conditions, Prediction
from pcalib.robot import Robot
from pcalib.unknowns import Unknowns, apply, current, unknowns_of

METHODS = ("map", "base", "linear")
LOSSES = ("linear", "huber", "cauchy")
ROBUST_AT = 2.5
"""Rows further off than this many σ (per component) weigh less under a robust loss."""
_COST_NOISE = 1e-6
"""Relative change of the cost that the rounding of forward kinematics can cause: no reason to reject a step."""
_TOLERANCE = 1e-5
"""A fit has converged when what is left to go is below this share of every unknown's natural size."""


@dataclass(frozen=True)
class Linearisation:
    """Whitened residuals of measured scalars and their derivatives by every unknown."""

    residual: np.ndarray
    """(M,) (measured − predicted)/σ."""
    geometry: np.ndarray
    """(M, n_geometry)."""
    effects: np.ndarray
    """(M, n_effects)."""
    frame: np.ndarray
    """(M, n_frame)."""
    row: np.ndarray
    """(M,) pose of each scalar."""
    component: np.ndarray
    """(M,) 0…5 for x y z rx ry rz."""
    prediction: Prediction

    @property
    def jacobian(self) -> np.ndarray:
        """(M, n) all columns side by side."""
        return np.concatenate([self.geometry, self.effects, self.frame], axis=1)


@dataclass(frozen=True)
class Accuracy:
    """How far model and measurements are apart on some rows."""

    rms_pos: float
    """[m] sqrt(mean |e|²) over the rows with a position."""
    max_pos: float
    rms_rot: float
    """[rad]; NaN without rotations."""
    chi2_dof: float
    """Of the readings that the level can explain."""
    n_rows: int


@dataclass(frozen=True)
class Fit:
    """The outcome of an identification. `model` refuses where the fit cannot be trusted."""

    candidate: Model
    """The fitted model, whatever the status: for inspection only."""
    status: str
    """'converged', 'not_converged' or 'rank_deficient'."""
    reason: str
    """Why a status other than converged."""
    method: str
    iterations: int
    unknowns: Unknowns
    estimate: np.ndarray
    """(n,) values of the unknowns: change from nominal, effect values, target offset."""
    covariance: np.ndarray
    """(n, n) posterior covariance."""
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad], NaN where not measured, all rows, check rows included."""
    weight: np.ndarray
    """(N,) robust weights; 1 with linear loss and on check rows."""
    fit: Accuracy
    check: Accuracy | None
    identifiability: Identifiability
    expected: int
    """Directions that well-spread poses with the same kind of readings would identify at this level."""
    prior_scale: float
    """By how much the manufacturing priors were widened, as the data asked."""
    warnings: tuple[str, ...]
    lines: np.ndarray
    """(N,) source lines of the rows."""

    @property
    def model(self) -> Model:
        """The fitted model.

        Raises:
            FitError: the fit did not converge or the data cannot support the level.
        """
        if self.status != "converged":
            raise FitError(f"the fit is not usable ({self.status.replace('_', ' ')}): {self.reason}")
        return self.candidate

    @property
    def n_identified(self) -> int:
        """Directions with prior σ / posterior σ above the threshold."""
        return self.identifiability.n_identified


def conditions_of(data: Measurements) -> Conditions:
    """Tools, payloads and further columns of a data set."""
    return Conditions(data.tool, data.payload, data.columns)


def residuals(model: Model, data: Measurements, start: Prediction | None = None) -> tuple[np.ndarray, Prediction]:
    """Measured − predicted (N, 6) [m, rad], NaN where not measured, and the prediction."""
    p = prediction.predict(model, data.q, conditions_of(data), start.pose if start is not None else None)
    error = np.full((len(data.q), 6), np.nan)
    error[:, :3] = data.position - p.position
    turned = data.mask[:, 3]
    if turned.any():
        error[turned, 3:] = rotation.log(data.rotation[turned] @ np.swapaxes(p.rotation[turned], -1, -2))
    error[~data.mask] = np.nan
    return error, p


def linearise(
    model: Model, data: Measurements, unknowns: Unknowns, at: tuple[np.ndarray, Prediction] | None = None
) -> Linearisation:
    """Whitened residuals and Jacobians of a model on data, for a fit, a diagnosis or a plan."""
    error, p = at if at is not None else residuals(model, data)
    closed, JX = prediction.closure_of(model, p)
    basis = None if unknowns.level.raw and unknowns.keep.all() else unknowns.basis
    blocks = [prediction.geometry_columns(model, p, closed, JX, basis)]
    parts = []
    if unknowns.n_effects:
        assert p.situation is not None
        for fitted in model.effects:
            parts += prediction.unit_contributions(fitted.effect, p.situation, fitted.theta)
    blocks.append(prediction.effect_columns(model, p, closed, JX, parts))
    blocks.append(prediction.frame_columns(model, p) if unknowns.n_frame else np.zeros((len(error), 6, 0)))
    row, component = np.nonzero(data.mask)
    sigma = data.sigma[row, component]
    geometry, effects, frame = (block[row, component] / sigma[:, None] for block in blocks)
    return Linearisation(error[row, component] / sigma, geometry, effects, frame, row, component, p)


def register(model: Model, data: Measurements) -> Frame:
    """First guess of the frame: the rigid motion that best lays predicted on measured positions (Kabsch)."""
    p = prediction.predict(replace(model, frame=None), data.q, conditions_of(data))
    full = data.mask[:, :3].all(axis=1) & (p.status == "ok")
    if full.sum() < 3:
        raise InputError(
            f"only {full.sum()} rows have x, y and z: an unknown frame needs at least 3",
            file=data.source,
            remedy="measure more poses, or in the base frame (# frame = base)",
        )
    a, b = p.position[full], data.position[full]
    U, _, Vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return Frame(R, b.mean(0) - R @ a.mean(0))


def fit(
    data: Measurements,
    robot: Robot | Model,
    level: str = "complete",
    *,
    effects: Sequence[FittedEffect] = (),
    method: str = "map",
    loss: str = "linear",
    fixed: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Mapping[str, float] | None = None,
    prior_scale: float | None = None,
    weighted: bool = True,
    max_iterations: int = 30,
) -> Fit:
    """Identify a robot from measurements.

    Args:
        data: measured poses; rows with ``set = check`` are never used for fitting.
        robot: nominal robot, or a model to start from (its effects and frame are kept as start values).
        level: named geometry level of the robot's kind.
        effects: effects to identify together with the geometry, at their start values.
        method: 'map', 'base' or 'linear', see the module.
        loss: 'linear', or 'huber' / 'cauchy', which weigh rows far off down and report them.
        fixed, bounds, prior: see :func:`pcalib.unknowns.unknowns_of`.
        prior_scale: common factor on the manufacturing priors; estimated (≥ 1) where absent.
        weighted: divide by the instrument's σ; False weighs a millimetre like a radian, as the paper's text does.

    Raises:
        InputError: rows that the nominal robot cannot reach, or fewer readings than the level needs.
    """
    for value, names, what in ((method, METHODS, "method"), (loss, LOSSES, "loss")):
        if value not in names:
            raise InputError(unknown(what, value, names))
    model = robot if isinstance(robot, Model) else Model.nominal(robot)
    model = replace(model, level=level, effects=tuple(effects) or model.effects)
    if not weighted:
        data = replace(data, sigma=data.sigma[:, :1] * np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3]))
    tracker = data.frame == "tracker"
    unknowns = unknowns_of(model, level, model.effects, tracker, fixed, bounds, prior, flat=method != "map")
    used = _explained(data.take(~data.check), unknowns)
    if len(used.q) == 0:
        raise InputError("no rows to fit: all are set = check", file=data.source)
    model = replace(model, frame=(model.frame or register(model, used)) if tracker else None)
    if unknowns.level.raw is False:
        inside = unknowns.basis @ unknowns.coordinates(model.errors)
        model = model.with_geometry(model.robot.mechanism.nominal + inside)
    at = residuals(model, used)
    _require_reach(at[1], used)
    expected = _require_enough(model, used, unknowns)
    chosen = np.arange(len(unknowns.names))
    if method != "map":
        reference = linearise(replace(Model.nominal(model.robot), effects=model.effects, frame=model.frame), used, unknowns)
        chosen = _base(reference, unknowns)
    scale = 1.0 if method != "map" else prior_scale
    state = _minimise(model, used, unknowns, chosen, at, loss, scale, 1 if method == "linear" else max_iterations)
    return _conclude(state, data, used, unknowns, chosen, method, expected)


@dataclass(frozen=True)
class _State:
    """Where the minimisation ended."""

    model: Model
    error: np.ndarray
    R: np.ndarray
    """Triangular factor of the information in scaled unknowns."""
    linear: Linearisation
    weight: np.ndarray
    prior_scale: float
    iterations: int
    converged: bool


def _minimise(
    model: Model,
    data: Measurements,
    unknowns: Unknowns,
    chosen: np.ndarray,
    at: tuple[np.ndarray, Prediction],
    loss: str,
    prior_scale: float | None,
    max_iterations: int,
) -> _State:
    """Levenberg–Marquardt on the chosen unknowns, in units of their natural size."""
    scale = unknowns.scale[chosen]
    relative = unknowns.prior[chosen] / scale
    geometric = np.flatnonzero((chosen < unknowns.n_geometry) & np.isfinite(relative))
    held = np.isfinite(relative)
    tau = prior_scale or 1.0
    damping, converged, count, last = 0.0, False, 0, np.inf
    weight = _robust(at[0], data, loss)

    def prior_of(tau: float) -> np.ndarray:
        out = relative.copy()
        out[geometric] *= tau
        return out

    def cost(model: Model, at: tuple[np.ndarray, Prediction]) -> float:
        if not (at[1].status == "ok").all():
            return np.inf
        u = current(model, unknowns)[chosen] / scale
        return float(np.nansum(weight[:, None] * (at[0] / data.sigma) ** 2) + np.sum((u / prior_of(tau))[held] ** 2))

    linear = linearise(model, data, unknowns, at)
    while True:
        root = np.sqrt(weight)[linear.row]
        u = current(model, unknowns)[chosen] / scale
        J = linear.jacobian[:, chosen] * scale * root[:, None]
        step, R = least_squares.solve(J, root * linear.residual, -u, prior_of(tau), damping)
        if not np.isfinite(step).all() or count >= max_iterations:
            break
        if unknowns.bounded:
            low, high = unknowns.lower[chosen] / scale - u, unknowns.upper[chosen] / scale - u
            step = least_squares.within(R, step, low, high)
        full = np.zeros(len(unknowns.names))
        full[chosen] = step * scale
        trial = apply(model, unknowns, full)
        tried = residuals(trial, data, at[1])
        count += 1
        if max_iterations > 1 and not cost(trial, tried) <= cost(model, at) * (1 + _COST_NOISE) + _COST_NOISE:
            damping = max(10 * damping, 1e-3 * float(np.max(np.sum(J * J, axis=0), initial=1.0)))
            continue
        model, at = trial, tried
        # What is left to go shrinks as steps do: the next would be about (size/last)·size.
        size = float(np.abs(step).max(initial=0.0))
        left, last = size * (min(1.0, size / last) if np.isfinite(last) else 1.0), size
        before = (weight, tau)
        weight = _robust(at[0], data, loss)
        if prior_scale is None and len(geometric):
            tau = _evidence(u[geometric] + step[geometric], R, geometric, tau)
        steady = np.abs(weight - before[0]).max() < 1e-3 and abs(tau / before[1] - 1) < 5e-2
        converged = max_iterations == 1 or bool(left < _TOLERANCE and steady and not damping)
        damping = damping / 10 if damping > 1e-6 else 0.0
        if converged:
            break
        linear = linearise(model, data, unknowns, at)
    return _State(model, at[0], R, linear, weight, tau, count, converged)


def _evidence(u: np.ndarray, R: np.ndarray, geometric: np.ndarray, tau: float) -> float:
    """The prior's scale that makes the geometric errors found most likely, never below the stated tolerances."""
    well = np.sum(1 - least_squares.variances(R)[geometric] / tau**2)
    return float(np.clip(np.sqrt(np.sum(u * u) / max(well, 1e-3)), 1.0, 100.0)) if np.isfinite(well) else tau


def _robust(error: np.ndarray, data: Measurements, loss: str) -> np.ndarray:
    """Weight of each row from its residual length per component, in σ."""
    if loss == "linear":
        return np.ones(len(error))
    z = np.sqrt(np.nanmean((error / data.sigma) ** 2, axis=1))
    scale = max(1.0, float(np.nanmedian(z)) / 0.9)  # a misfit common to all rows is no outlier
    z = z / (scale * ROBUST_AT)
    return np.where(z <= 1, 1.0, 1 / np.maximum(z, 1)) if loss == "huber" else 1 / (1 + z * z)


def _conclude(
    state: _State,
    data: Measurements,
    used: Measurements,
    unknowns: Unknowns,
    chosen: np.ndarray,
    method: str,
    expected: int,
) -> Fit:
    g = unknowns.n_geometry
    linear = state.linear
    ident = analyse(
        linear.geometry, unknowns.scale[:g], unknowns.names[:g], np.hstack([linear.frame, linear.effects])
    )
    half = least_squares.root(state.R) * unknowns.scale[chosen][:, None]
    covariance = np.zeros((len(unknowns.names),) * 2)
    covariance[np.ix_(chosen, chosen)] = half @ half.T
    status, reason = _verdict(state, ident, expected, method, min(g, len(chosen)), unknowns)

    error, _ = residuals(state.model, data)
    weight = np.ones(len(data.q))
    weight[~data.check] = state.weight
    information = (ident.ratio * state.prior_scale) ** 2
    taken = float(np.sum(information / (1 + information))) if method == "map" else float(np.sum(chosen < g))
    taken += unknowns.n_effects + min(unknowns.n_frame, 6)
    explained = _explained(data, unknowns).mask

    def summary(rows: np.ndarray, parameters: float) -> Accuracy:
        return accuracy(error[rows], data.sigma[rows], explained[rows], parameters)

    return Fit(
        candidate=_with_sigma(state.model, unknowns, covariance),
        status=status,
        reason=reason,
        method=method,
        iterations=state.iterations,
        unknowns=unknowns,
        estimate=current(state.model, unknowns),
        covariance=covariance,
        error=error,
        weight=weight,
        fit=summary(~data.check, taken),
        check=summary(data.check, 0.0) if data.check.any() else None,
        identifiability=ident,
        expected=expected,
        prior_scale=state.prior_scale,
        warnings=_warnings(used, ident, expected, state),
        lines=data.lines,
    )


def _verdict(
    state: _State, ident: Identifiability, expected: int, method: str, n_chosen: int, unknowns: Unknowns
) -> tuple[str, str]:
    if not state.converged:
        return "not_converged", (
            f"no minimum after {state.iterations} iterations; the data may belong to another robot, or columns or "
            "units may be swapped (run 'pcalib inspect')"
        )
    identified = min(ident.n_identified, n_chosen)
    if identified < (expected if method != "map" else (expected + 1) // 2):
        return "rank_deficient", (
            f"the data identify {identified} of the {expected} directions of level {unknowns.level.name}; "
            "spread the poses over the workspace ('pcalib plan'), or fit a simpler level"
        )
    if unknowns.level.strict and ident.n_identified < unknowns.n_geometry:
        unseen = [axis for c, axis in enumerate("xyz") if c not in state.linear.component]
        cause = f" ({' and '.join(unseen)} never measured: a shift along them leaves no trace)" if unseen else ""
        return "rank_deficient", (
            f"the values of level {unknowns.level.name} are handed on one by one, but these readings fix only "
            f"{ident.n_identified} of {unknowns.n_geometry}{cause}: {'; '.join(ident.sentences())}; "
            "fit a level without them, hold them with --fix, or measure what tells them apart"
        )
    return "converged", ""


def _with_sigma(model: Model, unknowns: Unknowns, covariance: np.ndarray) -> Model:
    """The model with 1σ of geometry and effects attached."""
    g, basis = unknowns.n_geometry, unknowns.basis
    sigma = np.full(len(model.k), np.nan)
    freed = np.abs(basis).max(axis=1, initial=0.0) > 0
    sigma[freed] = np.sqrt(np.einsum("ij,jl,il->i", basis, covariance[:g, :g], basis))[freed]
    each = np.sqrt(np.diag(covariance))
    effects, i = [], g
    for fitted in model.effects:
        effects.append(replace(fitted, sigma=each[i : i + len(fitted.theta)]))
        i += len(fitted.theta)
    return replace(model, sigma=sigma, effects=tuple(effects))


def accuracy(error: np.ndarray, sigma: np.ndarray, explained: np.ndarray, parameters: float) -> Accuracy:
    """RMS and maximum of residuals (N, 6) [m, rad], and χ² per degree of freedom of the `explained` ones."""
    some = ~np.isnan(error[:, :3]).all(axis=1)
    length2 = np.nansum(error[some, :3] ** 2, axis=1)
    turned = ~np.isnan(error[:, 3])
    angle2 = np.sum(error[turned, 3:] ** 2, axis=1)
    chi2 = float(np.sum((error[explained] / sigma[explained]) ** 2))
    dof = int(explained.sum()) - parameters
    return Accuracy(
        rms_pos=float(np.sqrt(length2.mean())) if len(length2) else float("nan"),
        max_pos=float(np.sqrt(length2.max())) if len(length2) else float("nan"),
        rms_rot=float(np.sqrt(angle2.mean())) if len(angle2) else float("nan"),
        chi2_dof=chi2 / dof if dof > 0 else float("nan"),
        n_rows=len(error),
    )


def _explained(data: Measurements, unknowns: Unknowns) -> Measurements:
    """The readings that the level can explain: no rotations where parallelograms are taken as perfect."""
    if not unknowns.level.perfect or not data.mask[:, 3].any() or not data.mask[:, :3].any():
        return data
    mask = data.mask.copy()
    mask[:, 3:] = False
    return replace(data, mask=mask)


def _require_reach(p: Prediction, data: Measurements) -> None:
    bad = np.flatnonzero(p.status != "ok")
    if len(bad):
        more = f" (and {len(bad) - 1} more rows)" if len(bad) > 1 else ""
        raise InputError(
            f"the robot cannot close its loops at this command: {str(p.status[bad[0]]).replace('_', ' ')}{more}",
            file=data.source,
            line=int(data.lines[bad[0]]),
            remedy="check the sign, order and unit of the actuator columns against the robot file",
        )


def _require_enough(model: Model, data: Measurements, unknowns: Unknowns) -> int:
    """Directions the level should identify from such readings; refuses fewer readings than that."""
    if unknowns.n_geometry == 0:
        return 0
    kinds = {(tuple(m), tuple(t)) for m, t in zip(data.mask.tolist(), np.round(data.tool, 6).tolist(), strict=True)}
    sigma = np.nanmedian(np.where(data.mask, data.sigma, np.nan), axis=0) if data.mask.all() else _typical(data)
    expected = expected_rank(
        model.robot, unknowns.level.name, tuple(unknowns.keep), tuple(sorted(kinds)[:6]), tuple(sigma), unknowns.n_frame > 0
    )
    needed = expected + min(unknowns.n_frame, 6)
    readings = int(data.mask.sum())
    if readings < needed:
        least = int(np.ceil(needed * len(data.q) / max(readings, 1)))
        raise InputError(
            f"too few poses: {len(data.q)} poses give {readings} readings, level {unknowns.level.name} needs {needed}",
            file=data.source,
            remedy=f"measure at least {least} poses (three times as many is usual), or fit a simpler level",
        )
    return expected


def _typical(data: Measurements) -> np.ndarray:
    """(6,) median σ of the measured components; 1 where a component is never measured."""
    return np.array([np.median(data.sigma[m, c]) if m.any() else 1.0 for c, m in enumerate(data.mask.T)])


@lru_cache(maxsize=64)
def expected_rank(
    robot: Robot,
    level: str,
    keep: tuple[bool, ...],
    kinds: tuple[tuple[tuple[bool, ...], tuple[float, ...]], ...],
    sigma: tuple[float, ...],
    frame_unknown: bool,
) -> int:
    """Directions that 40 well-spread poses per (measured components, tool) would identify at nominal geometry."""
    from pcalib.workspace import reachable

    q = reachable(robot, 40, np.random.default_rng(0)).q
    nominal = replace(Model.nominal(robot), frame=Frame() if frame_unknown else None)
    chosen = unknowns_of(nominal, level, frame=frame_unknown)
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
        if frame_unknown:
            F = prediction.frame_columns(nominal, p)[:, seen] / noise
            frames.append(F.reshape(-1, F.shape[-1]))
    scaled = project_out(np.concatenate(rows), np.concatenate(frames) if frames else None) * scale
    return int(np.sum(np.linalg.svd(scaled, compute_uv=False) > THRESHOLD))


def _base(linear: Linearisation, unknowns: Unknowns) -> np.ndarray:
    """Indices of the identifiable base and of every effect and frame unknown."""
    g = unknowns.n_geometry
    found = analyse(linear.geometry, unknowns.scale[:g], unknowns.names[:g], linear.frame)
    base = [i for i in range(g) if unknowns.names[i] in found.base]
    return np.array(base + list(range(g, len(unknowns.names))), int)


def _warnings(data: Measurements, ident: Identifiability, expected: int, state: _State) -> tuple[str, ...]:
    out = []
    if ident.n_identified < expected:
        out.append(f"{ident.n_identified} of {expected} directions are supported by these poses; priors hold the rest")
    if state.prior_scale > 2:
        out.append(
            f"geometric errors are about {state.prior_scale:.1f} times the assumed tolerances; "
            "priors were widened accordingly"
        )
    if not data.mask[:, 3:].any() and len(np.unique(np.round(data.tool, 6), axis=0)) == 1:
        out.append(
            "position only, with one tool: the plate's tilt is not seen, and other tools are not calibrated; "
            "measure with two more tool lengths or with orientations"
        )
    low = np.flatnonzero(state.weight < 0.5)
    if len(low):
        shown = ", ".join(str(int(data.lines[i])) for i in low[:8])
        out.append(f"{len(low)} rows are far from the model and weigh little (lines {shown}); look at them")
    return tuple(out)
