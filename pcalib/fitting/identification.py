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
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.errors import InputError, unknown
from pcalib.fitting import least_squares
from pcalib.fitting.identifiability import Identifiability, analyse, priors
from pcalib.fitting.linearisation import ROWS, body_turned, evaluate, seen_from
from pcalib.fitting.linearisation import conditions_of as conditions_of
from pcalib.fitting.linearisation import linearise as linearise
from pcalib.fitting.linearisation import residuals as residuals
from pcalib.fitting.minimisation import State, Task, minimise
from pcalib.fitting.remaining import Doubt, remaining
from pcalib.fitting.result import Accuracy as Accuracy
from pcalib.fitting.result import Fit as Fit
from pcalib.fitting.result import accuracy, explained
from pcalib.fitting.scatter import NOT_SCALED, Repeated, Scale, scale, with_joints, with_repeated
from pcalib.fitting.sufficiency import require_enough, require_order, require_reach, require_rows
from pcalib.fitting.systematic import of_scale
from pcalib.fitting.unknowns import Unknowns, level_of, unknowns_of
from pcalib.fitting.warnings import cautions
from pcalib.model import LOSSES, METHODS, FitOptions, FittedEffect, Model
from pcalib.posterior import Posterior, Remaining
from pcalib.robot import Robot

GROSS = 0.2
"""Robust weight up to which a row is gross: Huber's loss gives it to residuals of 6.7 σ."""
LEFT = 4.0
"""χ² per degree of freedom from which on the axes of a tracker's body are tried as unknowns."""
BETTER = 0.5
"""Share of χ² that is left where they are turned. A missing effect follows loads, places or time, and a turn that is
the same in all rows takes up little of it."""
_ROUNDING = 1e-9
"""Share of a parameter's tolerance below which a level only seems to free it, by rounding."""


def fit(
    data: Measurements,
    robot: Robot | Model,
    level: str = "complete",
    *,
    effects: Sequence[FittedEffect] = (),
    method: str | None = None,
    loss: str | None = None,
    fixed: Iterable[str] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Mapping[str, float] | None = None,
    prior_scale: float | None = None,
    weighted: bool = True,
    max_iterations: int = 60,
    suspect: bool = True,
) -> Fit:
    """Identify a robot from measurements.

    Args:
        data: measured poses; rows with ``set = check`` are never used for fitting.
        robot: nominal robot, or a model to start from: its effects and frame are start values, and what is not said
            here of the options from `method` to `prior` is as it was fitted before.
        level: named geometry level of the robot's kind.
        effects: effects to identify together with the geometry, at their start values.
        method: 'map' (the default), 'base' or 'linear', see the module.
        loss: 'linear' (the default), or 'huber' / 'cauchy', which weigh rows far off down and report them.
        fixed, bounds, prior: see :func:`pcalib.fitting.unknowns.unknowns_of`.
        prior_scale: common factor on the manufacturing priors; estimated (≥ 1) where absent.
        weighted: divide by the instrument's σ; False weighs a millimetre like a radian, as the paper's text does.
        suspect: where the data are far from the robot, look for a mistake in the file; False where that was done.

    Raises:
        InputError: rows that the nominal robot cannot reach, fewer readings than the level needs, or columns that are
            mixed up.
    """
    model = robot if isinstance(robot, Model) else Model.nominal(robot)
    said = {"method": method, "loss": loss, "fixed": fixed, "bounds": bounds, "prior": prior}
    how = _options(model, level, {name: value for name, value in said.items() if value is not None})
    method, loss = how.method, how.loss
    model = replace(model, level=level, effects=tuple(effects) or model.effects, options=how)
    if model.time_origin is None and "time" in data.columns:
        model = replace(model, time_origin=float(np.min(data.columns["time"])))
    if not weighted:
        data = replace(data, sigma=data.sigma[:, :1] * np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3]))
    require_rows(data)
    fitted = data.take(~data.check) if data.check.any() else data
    used = replace(fitted, mask=explained(fitted, level_of(model, level)))
    model = seen_from(model, used)
    tracker = data.frame == "tracker"
    unknowns = unknowns_of(model, level, model.effects, tracker, how.fixed, how.bounds, how.prior, flat=method != "map")
    if not unknowns.level.raw:
        model = model.with_geometry(model.robot.mechanism.nominal + unknowns.level.project(model.errors))
    at = evaluate(model, used)
    require_reach(at[1], used)
    if suspect:
        require_order(at[0], used, model.robot)
    expected = require_enough(model, used, unknowns)
    noise, repeated = with_joints(used, model, at[1].pose)
    task = Task(used, noise, unknowns, np.arange(len(unknowns.names)), loss, prior_scale, max_iterations)
    seen = None
    if method != "map":
        nominal = replace(Model.nominal(model.robot), effects=model.effects, frame=model.frame, setup=model.setup)
        seen = _seen(_rows(task, nominal), unknowns)
        beside = unknowns.names[unknowns.n_geometry :]
        chosen = np.array([i for i, name in enumerate(unknowns.names) if name in seen.base + beside], int)
        task = replace(task, chosen=chosen, prior_scale=1.0, max_iterations=1 if method == "linear" else max_iterations)
    state = minimise(task, model, at)
    found = _conclude(task, state, data, seen or _seen(state.begun.plain[:, :-1], unknowns), expected, repeated)
    # A body that is turned a little against the plate looks like a robot that was put together without care.
    if method == "map" and found.accuracy.chi2_dof > LEFT and (turned := body_turned(model, used)) is not None:
        another = fit(
            data, turned, level, prior_scale=prior_scale, weighted=weighted, max_iterations=max_iterations,
            suspect=False,
        )  # fmt: skip
        if another.status == "converged" and another.accuracy.chi2_dof < BETTER * found.accuracy.chi2_dof:
            return another
    return found


def _options(model: Model, level: str, said: Mapping[str, Any]) -> FitOptions:
    """The options of a fit: those in `said`, and for all others those with which the model was fitted before."""
    levels = model.robot.mechanism.levels
    out = replace(model.options, **said)
    kept = replace(model.options, **{name: getattr(FitOptions(), name) for name in said})
    if level in levels and (lost := [name for name in kept.named if name not in levels[level].columns]):
        raise InputError(
            f"{', '.join(lost)}: held, bounded or with a prior at level {model.level}, which level {level} cannot do",
            remedy=f"fit the data again with the options for that level: pcalib fit --level {level} …",
        )
    for value, names, what in ((out.method, METHODS, "method"), (out.loss, LOSSES, "loss")):
        if value not in names:
            raise InputError(unknown(what, value, names))
    return replace(out, fixed=tuple(out.fixed), bounds=dict(out.bounds), prior=dict(out.prior))


def _rows(task: Task, model: Model) -> np.ndarray:
    """Whitened derivatives of the readings (M, n) at a model; of many rows their triangular factor, (n, n)."""
    if len(task.data) <= ROWS:  # not the factor: equal columns may swap places in pivoted QR by its rounding
        return linearise(model, task.data, task.unknowns, noise=task.noise).jacobian
    return task.linearised(model, evaluate(model, task.data)).plain[:, :-1]


def _seen(rows: np.ndarray, unknowns: Unknowns) -> Identifiability:
    """What rows (·, n) of a Jacobian, or of its triangle, say about the geometry, effects and frame being unknown."""
    g = unknowns.n_geometry
    of = [unit for unit, kept in zip(unknowns.level.units, unknowns.keep, strict=True) if kept]
    return analyse(rows[:, :g], unknowns.scale[:g], unknowns.names[:g], rows[:, g:], of)


def _conclude(
    task: Task, state: State, data: Measurements, ident: Identifiability, expected: int, repeated: Repeated
) -> Fit:
    """The fit that a search ended with, its residuals on all rows and its warnings."""
    unknowns, chosen, g = task.unknowns, task.chosen, task.unknowns.n_geometry
    supported, half = _supported(task, state, repeated)
    covariance = half @ half.T
    status, reason, remedy = _verdict(state, ident, expected, task)

    fitted, held = ~data.check, data.check
    noise = replace(Noise.of(data), measured=explained(data, unknowns.level))
    error, weight = np.empty((len(data), 6)), np.ones(len(data))
    every = noise.measured is data.mask  # readings that the level cannot explain have residuals all the same
    error[fitted] = state.at[0] if every else evaluate(state.model, data.take(fitted), state.at[1].pose)[0]
    counted = task.noise
    if held.any():
        error[held], p = evaluate(state.model, data.take(held))
        counted = with_repeated(noise.take(held), repeated, state.model, data.take(held), p.pose)
    if repeated.sigma_q:
        noise = noise.at(fitted, task.noise)
        noise = noise.at(held, counted) if held.any() else noise
    weight[fitted] = state.weights.row
    information = (ident.ratio * state.weights.scale) ** 2
    taken = float(np.sum(chosen < g))
    if state.model.options.method == "map":
        taken = float(np.sum(information / (1 + information)))
    taken += unknowns.n_effects + unknowns.n_registration

    # What a robust loss gives next to no weight is no part of what the fit leaves over either.
    own = noise.take(fitted)
    rows = data.take(fitted), replace(own, measured=own.measured & (weight[fitted] > GROSS)[:, None])
    found = Fit(
        candidate=_with_sigma(state.model, unknowns, covariance),
        status=status,
        reason=reason,
        remedy=remedy,
        data=data,
        noise=noise,
        unknowns=unknowns,
        covariance=covariance,
        scale=supported,
        error=error,
        weight=weight,
        accuracy=accuracy(error[fitted], noise.take(fitted), taken),
        check=accuracy(error[held], noise.take(held), 0.0) if held.any() else None,
        identifiability=ident,
        expected=expected,
        prior_scale=state.weights.scale,
        iterations=state.iterations,
        posterior_of=partial(_posterior, task, state.model, state.R, *rows, repeated, supported, half),
    )
    return replace(found, warnings=cautions(found, state.at[1].unsettled))


def _supported(task: Task, state: State, repeated: Repeated) -> tuple[Scale, np.ndarray]:
    """Factor on the noise that the data support, and H (n, r) of the unknowns' covariance H·Hᵀ with that noise [SI].

    With C = (JᵀJ + P)⁻¹ the covariance under the noise that the fit weighed with, J of whitened readings and P of the
    priors, the estimate has covariance C·(Σ s²·JᵀJ + P)·C where the noise of each class of readings is s times larger.
    """
    chosen, unknowns = task.chosen, task.unknowns
    half = least_squares.root(state.R) * unknowns.scale[chosen][:, None]
    out = np.zeros((len(unknowns.names), len(chosen)))
    out[chosen] = half
    if not np.isfinite(half).all():
        return NOT_SCALED, out
    grams = state.linear.grams()
    if len(chosen) < len(unknowns.names):
        grams = grams[:, chosen[:, None], chosen]
    leverage = np.einsum("cij,ij->c", grams, half @ half.T)
    found = scale(state.at[0], task.noise, state.weights.row, leverage, repeated)
    more = np.einsum("c,cij->ij", np.repeat(found.ratio**2 - 1, 3), grams)
    middle = np.eye(len(chosen)) + half.T @ more @ half  # positive: the priors' share, and s² times that of the data
    out[chosen] = half @ _square_root(middle)
    return found, out


def _square_root(A: np.ndarray) -> np.ndarray:
    """L (n, n) with L·Lᵀ = A, which has no negative eigenvalues but by rounding."""
    try:
        return np.linalg.cholesky(A)
    except np.linalg.LinAlgError:  # singular, as where nothing is left over and no prior holds
        values, vectors = np.linalg.eigh(A)
        return vectors * np.sqrt(np.maximum(values, 0.0))


def _verdict(state: State, ident: Identifiability, expected: int, task: Task) -> tuple[str, str, str]:
    """Status, its reason, and what to do."""
    unknowns = task.unknowns
    if ident.n_identified < (expected if state.model.options.method != "map" else (expected + 1) // 2):
        return (
            "rank_deficient",
            f"the data identify {ident.n_identified} of the {expected} directions of level {unknowns.level.name}",
            "spread the poses over the workspace ('pcalib plan'), or fit a simpler level",
        )
    if not state.converged:
        jumps = "; effects that go by the sign of a load jump with it: try without" if state.model.effects else ""
        return (
            "not_converged",
            f"no minimum after {state.iterations} iterations",
            "the data may belong to another robot, rows to other commands, or columns or units may be mixed up: "
            f"'pcalib inspect' with --robot names them{jumps}",
        )
    if unknowns.level.strict and ident.n_identified < unknowns.n_geometry:
        unseen = [axis for c, axis in enumerate("xyz") if not task.data.mask[:, c].any()]
        cause = f" ({' and '.join(unseen)} never measured: a shift along them leaves no trace)" if unseen else ""
        return (
            "rank_deficient",
            f"the values of level {unknowns.level.name} are handed on one by one, but these readings fix only "
            f"{ident.n_identified} of {unknowns.n_geometry}{cause}: {'; '.join(ident.sentences())}",
            "fit a level without them, hold them with --fix, or measure what tells them apart",
        )
    return "converged", "", ""


def _posterior(
    task: Task,
    fitted: Model,
    R: np.ndarray,
    data: Measurements,
    noise: Noise,
    repeated: Repeated,
    supported: Scale,
    half: np.ndarray,
    model: Model,
) -> Posterior:
    """The posterior that `model` keeps: the covariance of its unknowns, and the noise and misfit that the fit found."""
    known = _left_over(task, fitted, R, data, noise, repeated, supported, half)
    free, unknowns = len(task.unknowns.keep), task.unknowns
    rows = np.r_[np.flatnonzero(unknowns.keep), free + np.arange(unknowns.n_effects)]
    factor = np.hstack([known.unknowns, of_scale(task, fitted, R, data, noise)])
    factor = factor[: unknowns.n_geometry + unknowns.n_effects]
    whole = np.zeros((free + unknowns.n_effects, factor.shape[1]))
    whole[rows] = factor
    return Posterior.of(model.unknowns, whole, known.left)


def _left_over(
    task: Task,
    model: Model,
    R: np.ndarray,
    data: Measurements,
    noise: Noise,
    repeated: Repeated,
    supported: Scale,
    half: np.ndarray,
) -> Doubt:
    """Noise and misfit that the fitted rows show, and the covariance with them; `half` is its root without them."""
    if not repeated.sigma_q:
        plain = np.zeros((len(task.unknowns.names), len(task.chosen)))
        plain[task.chosen] = least_squares.root(R) * task.unknowns.scale[task.chosen][:, None]
        if (known := remaining(model, data, task.unknowns, plain, noise)) is not None:
            return known
    ratio = np.where(np.isnan(repeated.ratio), 1.0, repeated.ratio) if repeated.sigma_q else 1.0
    behind = supported.dof[np.isfinite(supported.dof)]
    dof = float(behind.sum()) if len(behind) else np.inf
    return Doubt(Remaining(np.maximum(ratio * supported.ratio, 1e-3), repeated.sigma_q, 1.0, dof), half)


def _with_sigma(model: Model, unknowns: Unknowns, covariance: np.ndarray) -> Model:
    """The model with 1σ of geometry and effects attached."""
    g, basis = unknowns.n_geometry, unknowns.basis
    sigma = np.full(len(model.k), np.nan)
    moved = np.abs(basis * unknowns.scale[:g]).max(axis=1, initial=0.0)
    freed = moved > _ROUNDING * priors(model.robot.mechanism.units)
    sigma[freed] = np.sqrt(np.sum(basis @ covariance[:g, :g] * basis, axis=1))[freed]
    each = np.sqrt(np.diag(covariance))
    effects, i = [], g
    for fitted in model.effects:
        effects.append(replace(fitted, sigma=each[i : i + len(fitted.theta)]))
        i += len(fitted.theta)
    return replace(model, sigma=sigma, effects=tuple(effects), uncertainty=None, posterior=None)
