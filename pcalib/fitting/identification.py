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
from typing import Any

import numpy as np

from pcalib import units, wording
from pcalib.data.measurement import Measurements
from pcalib.errors import FitError, InputError, unknown
from pcalib.fitting import least_squares
from pcalib.fitting.identifiability import Identifiability, analyse, priors
from pcalib.fitting.linearisation import Linearisation as Linearisation
from pcalib.fitting.linearisation import conditions_of as conditions_of
from pcalib.fitting.linearisation import linearise, residuals, seen_from
from pcalib.fitting.minimisation import State, minimise
from pcalib.fitting.sufficiency import require_enough, require_order, require_reach, require_rows
from pcalib.fitting.unknowns import Unknowns, current, unknowns_of
from pcalib.model import LOSSES, METHODS, FitOptions, FittedEffect, Model
from pcalib.robot import Robot

_LEFT_OUT = 1.5
"""Times their σ from which rotations that a level leaves out are warned of."""
_ROUNDING = 1e-9
"""Share of a parameter's tolerance below which a level only seems to free it, by rounding."""
_FAR = 6
"""Times the median residual from which a row is named: noise alone reaches three."""


@dataclass(frozen=True)
class Accuracy:
    """How far model and measurements are apart on some rows."""

    rms_pos: float
    """[m] sqrt(mean |e|²) over the rows with a position."""
    max_pos: float
    rms_rot: float
    """[rad]; NaN without rotations."""
    chi2_dof: float
    """Of the readings that the level can explain; NaN where none is to spare."""
    dof: float
    """Readings behind it, less what the fit took up."""
    n_rows: int

    @property
    def at_the_noise(self) -> bool:
        """Whether such residuals are what noise of the given σ leaves: within 3 of its σ, or 5 %."""
        return bool(np.sqrt(self.chi2_dof) < 1 + max(3 / np.sqrt(2 * max(self.dof, 1)), 0.05))


@dataclass(frozen=True)
class Fit:
    """The outcome of an identification. `model` refuses where the fit cannot be trusted."""

    candidate: Model
    """The fitted model, whatever the status: for inspection only."""
    status: str
    """'converged', 'not_converged' or 'rank_deficient'."""
    reason: str
    """Why a status other than converged."""
    remedy: str
    """And what to do about it."""
    method: str
    iterations: int
    unknowns: Unknowns
    estimate: np.ndarray
    """(n,) values of the unknowns: change from nominal, effect values, target offset."""
    covariance: np.ndarray
    """(n, n) posterior covariance."""
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad], NaN where not measured, all rows, check rows included."""
    sigma: np.ndarray
    """(N, 6) [m, rad] 1σ of the readings that the fit counted with."""
    weight: np.ndarray
    """(N,) robust weights; 1 with linear loss and on check rows."""
    accuracy: Accuracy
    """Of the fitted rows, and"""
    check: Accuracy | None
    """of those held out."""
    identifiability: Identifiability
    expected: int
    """Directions that well-spread poses with the same kind of readings would identify at this level."""
    prior_scale: float
    """By how much the manufacturing priors were widened, as the data asked."""
    warnings: tuple[str, ...]
    lines: np.ndarray
    """(N,) source lines of the rows."""
    held: np.ndarray
    """(N,) bool, rows held out."""
    source: str
    """The measurement file, for messages."""
    sigma_stated: bool
    """Whether the file states the instrument's σ; assumed otherwise."""
    left_out: float
    """Rotations that the level cannot explain and that do not count: RMS in σ on fitted rows; NaN where none are."""

    @property
    def model(self) -> Model:
        """The fitted model.

        Raises:
            FitError: the fit did not converge or the data cannot support the level.
        """
        if self.status != "converged":
            status = self.status.replace("_", " ")
            raise FitError(f"{self.source}: the fit is not usable ({status}): {self.reason}\n  {self.remedy}")
        return self.candidate

    @property
    def n_identified(self) -> int:
        """Directions with prior σ / posterior σ above the threshold."""
        return self.identifiability.n_identified


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

    Raises:
        InputError: rows that the nominal robot cannot reach, or fewer readings than the level needs.
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
    tracker = data.frame == "tracker"
    unknowns = unknowns_of(
        model, level, model.effects, tracker, how.fixed, how.bounds, how.prior, flat=method != "map"
    )
    require_rows(data)
    fitted = data.take(~data.check) if data.check.any() else data
    used = _explained(fitted, unknowns)
    model = seen_from(model, used)
    if not unknowns.level.raw:
        model = model.with_geometry(model.robot.mechanism.nominal + unknowns.level.project(model.errors))
    at = residuals(model, used)
    require_reach(at[1], used)
    require_order(at[0], used, model.robot)
    expected = require_enough(model, used, unknowns)
    chosen, seen = np.arange(len(unknowns.names)), None
    if method != "map":
        nominal = replace(Model.nominal(model.robot), effects=model.effects, frame=model.frame)
        seen = _seen(linearise(nominal, used, unknowns).jacobian, unknowns)
        beside = unknowns.names[unknowns.n_geometry :]
        chosen = np.array([i for i, name in enumerate(unknowns.names) if name in seen.base + beside], int)
    scale = 1.0 if method != "map" else prior_scale
    state = minimise(model, used, unknowns, chosen, at, loss, scale, 1 if method == "linear" else max_iterations)
    ident = seen or _seen(state.linear.triangle[:, :-1], unknowns)
    return _conclude(state, data, unknowns, chosen, method, expected, ident)


def _options(model: Model, level: str, said: Mapping[str, Any]) -> FitOptions:
    """What is said, and beside it how the model was fitted before."""
    levels = model.robot.mechanism.levels
    out = replace(model.options, **said)
    kept = replace(model.options, **{name: getattr(FitOptions(), name) for name in said})
    if level in levels and (lost := [name for name in kept.named if name not in levels[level].columns]):
        raise InputError(
            f"{', '.join(lost)}: held, bounded or with a prior at level {model.level}, which level {level} cannot do",
            remedy=f"fit anew and say what holds there: pcalib fit --level {level} …",
        )
    for value, names, what in ((out.method, METHODS, "method"), (out.loss, LOSSES, "loss")):
        if value not in names:
            raise InputError(unknown(what, value, names))
    return replace(out, fixed=tuple(out.fixed), bounds=dict(out.bounds), prior=dict(out.prior))


def _seen(rows: np.ndarray, unknowns: Unknowns) -> Identifiability:
    """What rows (·, n) of a Jacobian, or of its triangle, say about the geometry, effects and frame being unknown."""
    g = unknowns.n_geometry
    of = [unit for unit, kept in zip(unknowns.level.units, unknowns.keep, strict=True) if kept]
    return analyse(rows[:, :g], unknowns.scale[:g], unknowns.names[:g], rows[:, g:], of)


def _conclude(
    state: State,
    data: Measurements,
    unknowns: Unknowns,
    chosen: np.ndarray,
    method: str,
    expected: int,
    ident: Identifiability,
) -> Fit:
    g = unknowns.n_geometry
    half = least_squares.root(state.R) * unknowns.scale[chosen][:, None]
    covariance = np.zeros((len(unknowns.names),) * 2)
    covariance[np.ix_(chosen, chosen)] = half @ half.T
    status, reason, remedy = _verdict(state, ident, expected, method, unknowns)

    fitted, held = ~data.check, data.check
    error, weight = np.empty((len(data), 6)), np.ones(len(data))
    explained = _explained(data, unknowns)
    every = explained is data  # readings that the level cannot explain have residuals all the same
    error[fitted] = state.error if every else residuals(state.model, data.take(fitted), state.linear.prediction.pose)[0]
    error[held] = residuals(state.model, data.take(held))[0] if held.any() else 0.0
    weight[fitted] = state.weight
    information = (ident.ratio * state.prior_scale) ** 2
    taken = float(np.sum(information / (1 + information))) if method == "map" else float(np.sum(chosen < g))
    taken += unknowns.n_effects + min(unknowns.n_frame, 6)
    counted = explained.mask & ~np.isnan(error)
    beside = (data.mask & ~explained.mask)[fitted]
    off = (error[fitted] / data.sigma[fitted])[beside]
    left_out = float(np.sqrt(np.mean(off**2))) if len(off) else float("nan")
    figures = accuracy(error[fitted], data.sigma[fitted], counted[fitted], taken)

    return Fit(
        candidate=_with_sigma(state.model, unknowns, covariance),
        status=status,
        reason=reason,
        remedy=remedy,
        method=method,
        iterations=state.iterations,
        unknowns=unknowns,
        estimate=current(state.model, unknowns),
        covariance=covariance,
        error=error,
        sigma=data.sigma,
        weight=weight,
        accuracy=figures,
        check=accuracy(error[held], data.sigma[held], counted[held], 0.0) if held.any() else None,
        identifiability=ident,
        expected=expected,
        prior_scale=state.prior_scale,
        warnings=_warnings(data, error, unknowns, ident, expected, state, figures.rms_rot, left_out),
        lines=data.lines,
        held=held,
        source=data.source,
        sigma_stated=data.sigma_stated,
        left_out=left_out,
    )


def _verdict(
    state: State, ident: Identifiability, expected: int, method: str, unknowns: Unknowns
) -> tuple[str, str, str]:
    """Status, its reason, and what to do."""
    if ident.n_identified < (expected if method != "map" else (expected + 1) // 2):
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
        unseen = [axis for c, axis in enumerate("xyz") if c not in state.linear.component]
        cause = f" ({' and '.join(unseen)} never measured: a shift along them leaves no trace)" if unseen else ""
        return (
            "rank_deficient",
            f"the values of level {unknowns.level.name} are handed on one by one, but these readings fix only "
            f"{ident.n_identified} of {unknowns.n_geometry}{cause}: {'; '.join(ident.sentences())}",
            "fit a level without them, hold them with --fix, or measure what tells them apart",
        )
    return "converged", "", ""


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
        dof=dof,
        n_rows=int((~np.isnan(error).all(axis=1)).sum()),
    )


def _explained(data: Measurements, unknowns: Unknowns) -> Measurements:
    """The readings that the level can explain: no rotations where parallelograms are taken as perfect."""
    if not unknowns.level.perfect or not data.mask[:, 3].any() or not data.mask[:, :3].any():
        return data
    mask = data.mask.copy()
    mask[:, 3:] = False
    return replace(data, mask=mask)


def _warnings(
    data: Measurements,
    error: np.ndarray,
    unknowns: Unknowns,
    ident: Identifiability,
    expected: int,
    state: State,
    rms_rot: float,
    left_out: float,
) -> tuple[str, ...]:
    out = []
    if left_out > _LEFT_OUT:
        out.append(
            f"level {unknowns.level.name} takes parallelograms as perfect: measured rotations are left out, and are "
            f"{wording.deviation(rms_rot, 'rad')} RMS off, {left_out:.1f}× their σ"
        )
    if ident.n_identified < expected:
        out.append(f"{ident.n_identified} of {expected} directions are supported by these poses; priors hold the rest")
    if state.prior_scale > 2:
        out.append(
            f"geometric errors are about {state.prior_scale:.1f} times the assumed tolerances; "
            "priors were widened accordingly"
        )
    fitted = ~data.check
    one_tool = np.ptp(data.tool[fitted], axis=0).max() < 1e-6
    if one_tool and not data.mask[fitted, 3:].any() and not unknowns.level.perfect:
        out.append(
            "position only, with one tool: the plate's tilt is not seen, and other tools are not calibrated; "
            "measure with two more tool lengths or with orientations"
        )
    for f in state.model.effects:
        for p, value in zip(f.effect.parameters, f.theta, strict=True):
            if not p.low <= value <= p.high:
                shown = f"{wording.figure(value / units.factor(p.unit))} {units.spoken(p.unit)}".strip()
                out.append(f"{f.effect.name}: {p.name} = {shown} lies outside what is physical")
    low = data.lines[fitted][state.weight < 0.5]
    if len(low):
        out.append(f"{_rows(len(low), 'far from the model')} and of little weight ({_lines(low)}); look there")
    length = np.linalg.norm(np.nan_to_num(error[fitted, :3]), axis=1)
    beyond = (length > _FAR * np.median(length)) & (length > _FAR * data.sigma[fitted, 0]) & (state.weight >= 0.5)
    far = data.lines[fitted][beyond]
    if len(far):
        out.append(
            f"{_lines(far)}: more than {_FAR} times as far from the model as half of all rows; do command and "
            "measurement belong together? --loss huber gives such rows little weight"
        )
    if state.unsettled is not None:
        between = data.lines[fitted][state.unsettled]
        out.append(
            f"{_lines(between)}: the load pushes a gap shut from either side, so that the model's reading there is "
            "uncertain by that gap"
        )
    if data.robot_name and data.robot_name != state.model.robot.name:
        out.append(f"the file names robot '{data.robot_name}', the robot file is of '{state.model.robot.name}'")
    lost = data.lines[data.check & data.mask.any(axis=1) & np.isnan(error).all(axis=1)]
    if len(lost):
        out.append(f"{_rows(len(lost), 'out of the fitted reach, held out')} and not counted ({_lines(lost)})")
    return tuple(out)


def _lines(lines: np.ndarray, most: int = 8) -> str:
    more = ", …" if len(lines) > most else ""
    return f"line{'s' * (len(lines) > 1)} {', '.join(str(int(line)) for line in lines[:most])}{more}"


def _rows(n: int, what: str) -> str:
    return f"{n} rows are {what}" if n > 1 else f"1 row is {what}"
