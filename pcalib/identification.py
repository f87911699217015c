"""Identification: from measured poses to geometry, effects and measuring frame.

Unknowns z are level coordinates, effect parameters and the frame. The cost is

    Σ_rows w_r·|W·(measured − predicted(z))|² + Σ ((z_j − z_j⁰)/σ_j)²

with W from the instrument's σ, manufacturing priors σ_j (MAP) and optional robust weights w_r; it is minimised by
Levenberg–Marquardt on scaled unknowns, each step by QR. Methods:

* ``map``: all parameters of the level with priors. The default; never ill-posed.
* ``base``: the identifiable base only (pivoted QR), no priors: the classical Gauss–Newton calibration.
* ``linear``: one least-squares step at nominal on the base (paper eqs 23–26); pairs with first-order compensation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import lapack

from pcalib import kinematics, prediction, rotation
from pcalib.errors import FitError, InputError, unknown
from pcalib.identifiability import PRIOR, Identifiability, analyse, project_out
from pcalib.measurement import Measurements
from pcalib.mechanism import Level
from pcalib.model import FittedEffect, Frame, Model
from pcalib.prediction import Conditions, Prediction
from pcalib.robot import Robot

METHODS = ("map", "base", "linear")
LOSSES = ("linear", "huber", "cauchy")
EFFECT_PRIOR_WIDTH = 3.0
"""Effects are held by 3× what is usual: loose enough not to shrink what data can see."""
_FRAME_SCALE = 1e-3
_TOLERANCE = 1e-5
_ROBUST_AT = 2.5


@dataclass(frozen=True)
class Unknowns:
    """What a fit solves for, in order: level coordinates, effect parameters, frame."""

    level: Level
    keep: np.ndarray
    """(nz,) bool: level columns that are free."""
    prior: np.ndarray
    """(n,) 1σ of every unknown; inf where there is none."""
    scale: np.ndarray
    """(n,) natural size of every unknown, finite."""
    lower: np.ndarray
    upper: np.ndarray
    """(n,) bounds on the change from nominal (from zero for effects)."""
    names: tuple[str, ...]
    n_geometry: int
    n_effects: int
    n_frame: int

    @property
    def basis(self) -> np.ndarray:
        """(nk, n_geometry) free directions of the level."""
        return self.level.basis[:, self.keep]

    @property
    def bounded(self) -> bool:
        """Whether any unknown has a bound."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())


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
    """(n,) values of the unknowns: change from nominal, effect values, frame increments from the start frame."""
    covariance: np.ndarray
    """(n, n) posterior covariance."""
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad], NaN where not measured, all rows."""
    weight: np.ndarray
    """(N,) robust weights, 1 with linear loss and on check rows."""
    fit: Accuracy
    check: Accuracy | None
    identifiability: Identifiability
    expected: int
    """Directions that rich data of this kind could identify at this level."""
    warnings: tuple[str, ...] = ()
    lines: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
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

    def suspects(self, limit: float = 5.0) -> np.ndarray:
        """Rows (indices) further from the model than `limit` σ in some component."""
        return np.flatnonzero(self.weight < 1) if (self.weight < 1).any() else self._far(limit)

    def _far(self, limit: float) -> np.ndarray:
        ratio = np.sqrt(np.nanmean(self.error[:, :3] ** 2, axis=1))
        typical = np.nanmedian(ratio)
        return np.flatnonzero(ratio > limit * typical) if typical > 0 else np.zeros(0, int)


def conditions_of(data: Measurements) -> Conditions:
    """Tools, payloads and further columns of a data set."""
    return Conditions(data.tool, data.payload, data.columns)


def unknowns_of(
    model: Model,
    level: str,
    effects: Sequence[FittedEffect] = (),
    frame: bool = False,
    fixed: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Mapping[str, float] | None = None,
    free_prior: bool = False,
) -> Unknowns:
    """The unknowns of a fit.

    Args:
        fixed: names of level columns held at nominal.
        bounds: name → (low, high) of the change from nominal [SI].
        prior: 1σ by unit ('m', 'rad', '1') or by parameter name; manufacturing tolerances elsewhere.
        free_prior: no priors at all.
    """
    levels = model.robot.mechanism.levels
    if level not in levels:
        raise InputError(unknown("level", level, levels))
    chosen = levels[level]
    prior, bounds, fixed = dict(prior or {}), dict(bounds or {}), set(fixed)
    for name in [*fixed, *bounds, *(p for p in prior if p not in PRIOR)]:
        if name not in chosen.columns:
            raise InputError(unknown(f"parameter of level {level}", name, chosen.columns))
    keep = np.array([c not in fixed for c in chosen.columns], bool)
    names = [c for c in chosen.columns if c not in fixed]
    sizes = [
        prior.get(c, prior.get(u, PRIOR[u])) for c, u, k in zip(chosen.columns, chosen.units, keep, strict=True) if k
    ]
    n_geometry = len(names)
    for fitted in effects:
        for p in fitted.effect.parameters:
            names.append(f"{fitted.effect.name}.{p.name}")
            sizes.append(EFFECT_PRIOR_WIDTH * p.prior)
    n_effects = len(names) - n_geometry
    n_frame = 9 if frame else 0
    names += [f"frame.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")][:n_frame]
    names += [f"target.{c}" for c in "xyz"] if frame else []
    scale = np.array(sizes + [_FRAME_SCALE] * n_frame)
    free = np.concatenate([np.array(sizes), np.full(6 if frame else 0, np.inf), np.full(3 if frame else 0, np.inf)])
    if frame:
        free[-3:] = 1e-2  # the target's place is stated to a centimetre at worst; the rest of it is a gauge
    if free_prior:
        free[:] = np.inf
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for name, (low, high) in bounds.items():
        lower[names.index(name)], upper[names.index(name)] = low, high
    return Unknowns(chosen, keep, free, scale, lower, upper, tuple(names), n_geometry, n_effects, n_frame)


def residuals(model: Model, data: Measurements, start: Prediction | None = None) -> tuple[np.ndarray, Prediction]:
    """Measured − predicted (N, 6) [m, rad], NaN where not measured, and the prediction."""
    p = prediction.predict(model, data.q, conditions_of(data), start.pose if start is not None else None)
    error = np.full((len(data.q), 6), np.nan)
    error[:, :3] = data.position - p.position
    turned = data.mask[:, 3]
    if turned.any():
        delta = data.rotation[turned] @ np.swapaxes(p.rotation[turned], -1, -2)
        error[turned, 3:] = rotation.log(delta)
    error[~data.mask] = np.nan
    return error, p


def linearise(
    model: Model, data: Measurements, unknowns: Unknowns, at: tuple[np.ndarray, Prediction] | None = None
) -> Linearisation:
    """Whitened residuals and Jacobians of a model on data, for a fit, a diagnosis or a plan."""
    error, p = at if at is not None else residuals(model, data)
    closed, JX = prediction.closure_of(model, p)
    blocks = [prediction.geometry_columns(model, p, closed, JX, unknowns.basis)]
    parts = []
    if unknowns.n_effects:
        assert p.situation is not None
        for fitted in model.effects:
            parts += prediction.unit_contributions(fitted.effect, p.situation, fitted.theta)
    blocks.append(prediction.effect_columns(model, p, closed, JX, parts))
    if unknowns.n_frame:
        blocks.append(prediction.frame_columns(model, p))
    row, component = np.nonzero(data.mask)
    sigma = data.sigma[row, component]
    whole = [block[row, component] / sigma[:, None] for block in blocks]
    frame = whole[2] if unknowns.n_frame else np.zeros((len(row), 0))
    return Linearisation(error[row, component] / sigma, whole[0], whole[1], frame, row, component, p)


def apply(model: Model, unknowns: Unknowns, step: np.ndarray) -> Model:
    """The model after a step (n,) of the unknowns."""
    g, e = unknowns.n_geometry, unknowns.n_effects
    k = model.k + unknowns.basis @ step[:g] if g else model.k
    effects, i = [], g
    for fitted in model.effects:
        n = len(fitted.theta) if e else 0
        effects.append(replace(fitted, theta=fitted.theta + step[i : i + n]) if e else fitted)
        i += n
    frame = model.frame
    if unknowns.n_frame:
        assert frame is not None
        f = step[g + e :]
        frame = Frame(
            rotation.renormalise(rotation.exp(f[3:6]) @ frame.rotation), frame.translation + f[:3], frame.offset + f[6:9]
        )
    return replace(model, k=k, effects=tuple(effects), frame=frame)


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


def least_squares(
    J: np.ndarray, y: np.ndarray, pull: np.ndarray, prior: np.ndarray, damping: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Minimise |y − J·s|² + Σ((pull − s)/prior)² (+ |damping·s|²) by QR; returns the step and the factor R.

    R satisfies RᵀR = JᵀJ + diag(1/prior²) (+ damping²): the information matrix, never formed.
    """
    n = J.shape[1]
    held = np.flatnonzero(np.isfinite(prior))
    extra = len(held) + (n if damping is not None else 0)
    A = np.zeros((len(J) + extra, n + 1), order="F")
    A[: len(J), :n], A[: len(J), n] = J, y
    A[len(J) + np.arange(len(held)), held] = 1 / prior[held]
    A[len(J) : len(J) + len(held), n] = pull[held] / prior[held]
    if damping is not None:
        A[len(J) + len(held) + np.arange(n), np.arange(n)] = damping
    QR = lapack.dgeqrf(A, overwrite_a=True)[0]
    R = QR[:n, :n]
    step, info = lapack.dtrtrs(R, QR[:n, n])
    if info:
        step = np.full(n, np.nan)
    return step, np.triu(R)


def _bounded_step(R: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The least-squares step within bounds, from the triangular factor."""
    from scipy.optimize import lsq_linear

    return lsq_linear(R, R @ step, bounds=(np.minimum(low, -1e-300), np.maximum(high, 1e-300)), method="bvls").x


def _robust(error: np.ndarray, data: Measurements, loss: str) -> np.ndarray:
    """Weight of each row from its residual length per component, in σ."""
    if loss == "linear":
        return np.ones(len(error))
    z = np.sqrt(np.nanmean((error / data.sigma) ** 2, axis=1))
    scale = max(1.0, float(np.nanmedian(z)) / 0.9)  # a misfit common to all rows is no outlier
    z = z / (scale * _ROBUST_AT)
    return np.where(z <= 1, 1.0, 1 / np.maximum(z, 1)) if loss == "huber" else 1 / (1 + z * z)


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
        fixed, bounds, prior: see :func:`unknowns_of`.
        weighted: divide by the instrument's σ; False leaves m and rad as they are, as the paper's text does.

    Raises:
        InputError: rows that the nominal robot cannot reach, or fewer readings than the level needs.
    """
    for value, names, what in ((method, METHODS, "method"), (loss, LOSSES, "loss")):
        if value not in names:
            raise InputError(unknown(what, value, names))
    model = robot if isinstance(robot, Model) else Model.nominal(robot)
    model = replace(model, level=level, effects=tuple(effects) or model.effects)
    if not weighted:
        data = replace(data, sigma=np.ones_like(data.sigma))
    used = data.take(~data.check)
    if len(used.q) == 0:
        raise InputError("no rows to fit: all are set = check", file=data.source)
    tracker = data.frame == "tracker"
    if tracker and model.frame is None:
        model = replace(model, frame=register(model, used))
    if not tracker:
        model = replace(model, frame=None)
    anchor = model.robot.mechanism.nominal
    unknowns = unknowns_of(model, level, model.effects, tracker, fixed, bounds, prior, free_prior=method != "map")
    error, p = residuals(model, used)
    _require_reach(p, used)
    expected = _expected(model, used, unknowns)
    n_scalars = int(used.mask.sum())
    if n_scalars < expected + unknowns.n_frame:
        each = n_scalars / len(used.q)
        raise InputError(
            f"too few poses: {len(used.q)} poses give {n_scalars} readings, level {level} needs "
            f"{expected + unknowns.n_frame}",
            file=data.source,
            remedy=f"measure at least {int(np.ceil((expected + unknowns.n_frame) / max(each, 1)))} poses "
            "(three times as many is usual), or fit a simpler level",
        )
    chosen = np.arange(len(unknowns.names))
    if method != "map":
        chosen = _base(linearise(Model.nominal(model.robot) if not tracker and not model.effects else model, used, unknowns), unknowns)
    state = _minimise(model, used, unknowns, chosen, (error, p), anchor, loss, 1 if method == "linear" else max_iterations)
    return _conclude(state, data, used, unknowns, chosen, method, loss, expected, anchor)


@dataclass(frozen=True)
class _State:
    """Where the minimisation stands."""

    model: Model
    at: tuple[np.ndarray, Prediction]
    R: np.ndarray
    linear: Linearisation
    weight: np.ndarray
    iterations: int
    converged: bool


def _current(model: Model, unknowns: Unknowns, anchor: np.ndarray) -> np.ndarray:
    """Present values of the unknowns, relative to nominal (frame: relative to the present one)."""
    values = np.zeros(len(unknowns.names))
    if unknowns.n_geometry:
        values[: unknowns.n_geometry] = np.linalg.lstsq(unknowns.basis, model.k - anchor, rcond=None)[0] if (
            unknowns.basis.shape[0] != unknowns.basis.shape[1]
        ) else model.k - anchor
    if unknowns.n_effects:
        values[unknowns.n_geometry : unknowns.n_geometry + unknowns.n_effects] = np.concatenate(
            [f.theta for f in model.effects]
        )
    if unknowns.n_frame:
        assert model.frame is not None
        values[-3:] = model.frame.offset
    return values


def _minimise(
    model: Model,
    data: Measurements,
    unknowns: Unknowns,
    chosen: np.ndarray,
    at: tuple[np.ndarray, Prediction],
    anchor: np.ndarray,
    loss: str,
    max_iterations: int,
) -> _State:
    """Levenberg–Marquardt on the chosen unknowns in units of their scale."""
    scale, prior = unknowns.scale[chosen], unknowns.prior[chosen] / unknowns.scale[chosen]
    once = max_iterations == 1

    def cost(model: Model, at: tuple[np.ndarray, Prediction], weight: np.ndarray) -> float:
        z = (at[0] / data.sigma) ** 2
        value = np.nansum(weight[:, None] * z)
        pull = _current(model, unknowns, anchor)[chosen] / scale
        held = np.isfinite(prior)
        return float(value + np.sum((pull[held] / prior[held]) ** 2)) if (at[1].status == "ok").all() else np.inf

    damping, converged, count = 0.0, False, 0
    linear = linearise(model, data, unknowns, at)
    weight = _robust(at[0], data, loss)
    while True:
        root = np.sqrt(weight)[linear.row]
        J = linear.jacobian[:, chosen] * (scale * root[:, None])
        pull = -_current(model, unknowns, anchor)[chosen] / scale
        damp = np.full(len(chosen), np.sqrt(damping)) if damping else None
        step, R = least_squares(J, root * linear.residual, pull, prior, damp)
        if not np.isfinite(step).all() or count >= max_iterations or converged:
            break
        if unknowns.bounded:
            now = -pull * scale
            step = _bounded_step(
                R, step, (unknowns.lower[chosen] - now) / scale, (unknowns.upper[chosen] - now) / scale
            )
        full = np.zeros(len(unknowns.names))
        full[chosen] = step * scale
        trial = apply(model, unknowns, full)
        tried = residuals(trial, data, at[1])
        count += 1
        if not once and not cost(trial, tried, weight) <= cost(model, at, weight) * (1 + 1e-9) + 1e-9:
            damping = max(10 * damping, 1e-3 * float(np.max(np.sum(J * J, axis=0))))
            continue
        model, at, damping = trial, tried, damping / 10 if damping > 1e-6 else 0.0
        previous, weight = weight, _robust(at[0], data, loss)
        settled = np.abs(step).max(initial=0.0) < _TOLERANCE and np.abs(weight - previous).max() < 1e-3
        converged = once or bool(settled and not damping)
        if not converged or once:
            linear = linearise(model, data, unknowns, at)
        if converged and not once:
            break  # R of the last step is within its own size of the one here
        if once:
            break
    return _State(model, at, R, linear, weight, count, converged)


def _conclude(
    state: _State,
    data: Measurements,
    used: Measurements,
    unknowns: Unknowns,
    chosen: np.ndarray,
    method: str,
    loss: str,
    expected: int,
    anchor: np.ndarray,
) -> Fit:
    g, nuisance = unknowns.n_geometry, state.linear.frame
    ident = analyse(
        state.linear.geometry, unknowns.scale[:g], unknowns.names[:g], np.hstack([nuisance, state.linear.effects])
    )
    inverse_R = np.linalg.solve(state.R, np.eye(len(chosen))) if np.isfinite(state.R).all() else np.full_like(state.R, np.nan)
    root = inverse_R * unknowns.scale[chosen][:, None]
    covariance = np.full((len(unknowns.names),) * 2, 0.0)
    covariance[np.ix_(chosen, chosen)] = root @ root.T
    estimate = _current(state.model, unknowns, anchor)

    status, reason = "converged", ""
    floor = expected if method != "map" else (expected + 1) // 2
    if not state.converged:
        status = "not_converged"
        reason = (
            f"no minimum after {state.iterations} iterations; the data may belong to another robot, or columns or "
            "units may be swapped (run 'pcalib inspect')"
        )
    elif min(ident.n_identified, len(chosen)) < floor:
        status = "rank_deficient"
        reason = (
            f"the data identify {ident.n_identified} of the {expected} directions of level {unknowns.level.name}; "
            "spread the poses over the workspace ('pcalib plan'), or fit a simpler level"
        )
    error = state.at[0]
    weight = state.weight
    if data.check.any():
        error, _ = residuals(state.model, data)
        weight = np.ones(len(data.q))
        weight[~data.check] = state.weight
    held = unknowns.prior[:g] if method == "map" else None
    taken = float(np.sum(ident.ratio**2 / (1 + ident.ratio**2))) if held is not None else float(len(chosen))
    taken += (unknowns.n_frame + unknowns.n_effects) if held is not None else 0
    in_fit = ~data.check
    fit_rows = accuracy(error[in_fit], data.sigma[in_fit], taken)
    check_rows = accuracy(error[data.check], data.sigma[data.check], 0.0) if data.check.any() else None

    sigma_z = np.sqrt(np.diag(covariance))
    basis = unknowns.basis
    sigma_k = np.sqrt(np.einsum("ij,jl,il->i", basis, covariance[:g, :g], basis)) if g else np.zeros(len(anchor))
    freed = (np.abs(basis) > 0).any(axis=1) if g else np.zeros(len(anchor), bool)
    effects, i = [], g
    for fitted in state.model.effects:
        effects.append(replace(fitted, sigma=sigma_z[i : i + len(fitted.theta)]))
        i += len(fitted.theta)
    model = replace(state.model, sigma=np.where(freed, sigma_k, np.nan), effects=tuple(effects))
    return Fit(
        candidate=model, status=status, reason=reason, method=method, iterations=state.iterations, unknowns=unknowns,
        estimate=estimate, covariance=covariance, error=error, weight=weight, fit=fit_rows, check=check_rows,
        identifiability=ident, expected=expected, warnings=_warnings(used, ident, expected, state),
        lines=data.lines,
    )  # fmt: skip


def accuracy(error: np.ndarray, sigma: np.ndarray, parameters: float) -> Accuracy:
    """RMS and maximum of residuals (N, 6), and χ² per degree of freedom."""
    position = error[:, :3]
    some = ~np.isnan(position).all(axis=1)
    length2 = np.nansum(position[some] ** 2, axis=1)
    turned = ~np.isnan(error[:, 3])
    angle2 = np.sum(error[turned, 3:] ** 2, axis=1)
    chi2 = float(np.nansum((error / sigma) ** 2))
    dof = int((~np.isnan(error)).sum()) - parameters
    return Accuracy(
        rms_pos=float(np.sqrt(length2.mean())) if len(length2) else float("nan"),
        max_pos=float(np.sqrt(length2.max())) if len(length2) else float("nan"),
        rms_rot=float(np.sqrt(angle2.mean())) if len(angle2) else float("nan"),
        chi2_dof=chi2 / dof if dof > 0 else float("nan"),
        n_rows=len(error),
    )


def _require_reach(p: Prediction, data: Measurements) -> None:
    bad = np.flatnonzero(p.status != "ok")
    if len(bad):
        more = f" (and {len(bad) - 1} more rows)" if len(bad) > 1 else ""
        raise InputError(
            f"the robot cannot close its loops at this command: {p.status[bad[0]].replace('_', ' ')}{more}",
            file=data.source,
            line=int(data.lines[bad[0]]),
            remedy="check the sign, order and unit of the actuator columns against the robot file",
        )


def _base(linear: Linearisation, unknowns: Unknowns) -> np.ndarray:
    """Indices of the identifiable base and of every effect and frame unknown."""
    g = unknowns.n_geometry
    found = analyse(linear.geometry, unknowns.scale[:g], unknowns.names[:g], linear.frame)
    base = [i for i in range(g) if unknowns.names[i] in found.base]
    return np.array(base + list(range(g, len(unknowns.names))), int)


def _expected(model: Model, data: Measurements, unknowns: Unknowns) -> int:
    """Directions that well-spread poses with the same kind of readings and tools would identify."""
    g = unknowns.n_geometry
    if g == 0:
        return 0
    reference = reference_poses(model.robot)
    kinds = {(tuple(m), tuple(np.round(t, 6))) for m, t in zip(data.mask, data.tool, strict=True)}
    rows, frames = [], []
    nominal = replace(Model.nominal(model.robot), frame=model.frame)
    sigma = np.nanmedian(np.where(data.mask, data.sigma, np.nan), axis=0)
    for mask, tool in sorted(kinds)[:6]:
        p = prediction.predict(nominal, reference, Conditions.of(len(reference), np.array(tool)))
        at, JX = prediction.closure_of(nominal, p)
        seen = np.flatnonzero(mask)
        J = prediction.geometry_columns(nominal, p, at, JX, unknowns.basis)[:, seen] / sigma[seen][:, None]
        rows.append(J.reshape(-1, g))
        if unknowns.n_frame:
            F = prediction.frame_columns(nominal, p)[:, seen] / sigma[seen][:, None]
            frames.append(F.reshape(-1, F.shape[-1]))
    scaled = project_out(np.concatenate(rows), np.concatenate(frames) if frames else None) * unknowns.scale[:g]
    s = np.linalg.svd(scaled, compute_uv=False)
    return int(np.sum(s > 1e-2))


def reference_poses(robot: Robot, n: int = 40, seed: int = 0) -> np.ndarray:
    """Commands (n, nq) spread over joint range ∩ workspace of the nominal robot, always the same."""
    from pcalib.planning import reachable

    return reachable(robot, n, np.random.default_rng(seed)).q


def _warnings(data: Measurements, ident: Identifiability, expected: int, state: _State) -> tuple[str, ...]:
    out = []
    if ident.n_identified < expected:
        out.append(
            f"{ident.n_identified} of {expected} directions are supported by these poses; priors hold the rest"
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
