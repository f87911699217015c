"""Levenberg–Marquardt on scaled unknowns, with priors whose common scale the data may widen and robust row weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.fitting import least_squares
from pcalib.fitting.linearisation import Linearisation, linearise, residuals
from pcalib.fitting.unknowns import EFFECT_PRIOR_WIDTH, Unknowns, apply, current
from pcalib.model import Model
from pcalib.prediction import Prediction, ahead

ROBUST_AT = 2.5
"""Rows further off than this many σ (per component) weigh less under a robust loss."""
TOLERANCE = 1e-5
"""A fit has converged when what is left to go is below this share of every unknown's natural size, or"""
_NOTHING = 1e-5
"""when χ² would gain no more than this by it."""
ROUNDING = 1e-13
"""[m, rad] what forward kinematics leaves open in a reading: no step is rejected for it."""
NEGLIGIBLE = 1e-3
"""Gain of a step in χ², in units of χ²/M, that no noise would let anyone see."""
_IDLE = 3
"""So many such steps in a row are the end. Where a model misses something, Gauss–Newton creeps on along directions
that the data hardly know; damped steps are short by themselves and prove nothing."""
_MANY = 20
"""Directions that the data know better than the drawing does, from which on their median says what is usual."""
_SCALES = np.geomspace(1.0, 100.0, 60)
"""Of the priors, between which is interpolated."""
_MEDIAN = 0.6745
"""Median of |z| for a standard normal z."""
_SETTLED = 10
"""Steps after which the priors' scale stays what it is."""
_STEADY = 0.05
"""Relative change of the widths of effects' priors below which a fit may end."""
_LEAST_DAMPING = 1e-12
"""Share of the largest diagonal element of JᵀJ: less is none."""


@dataclass(frozen=True)
class State:
    """Where a minimisation ended."""

    model: Model
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad]."""
    unsettled: np.ndarray | None
    """(N,) bool, rows where loads and pose do not settle; None where all do."""
    R: np.ndarray
    """Triangular factor of the information in scaled unknowns, without damping."""
    linear: Linearisation
    """Where the last step began, and what R is made of."""
    weight: np.ndarray
    """(N,) robust weights."""
    prior_scale: float
    iterations: int
    converged: bool


def minimise(
    model: Model,
    data: Measurements,
    unknowns: Unknowns,
    chosen: np.ndarray,
    at: tuple[np.ndarray, Prediction],
    loss: str = "linear",
    prior_scale: float | None = None,
    max_iterations: int = 60,
) -> State:
    """Minimise the cost over the chosen unknowns, each in units of its natural size.

    Args:
        chosen: indices into `unknowns`; the others stay where the model has them, or at the nearest bound.
        at: residuals of the model on the data.
        prior_scale: common factor on the priors of geometry; estimated (≥ 1) when absent.
        max_iterations: 1 takes one full step and asks no questions.
    """
    scale = unknowns.scale[chosen]
    prior = unknowns.prior[chosen] / scale
    held = np.isfinite(prior)
    g, e = unknowns.n_geometry, unknowns.n_effects
    geometric = np.flatnonzero((chosen < g) & held)
    effects = np.flatnonzero((chosen >= g) & (chosen < g + e) & held)  # beside them the target has a prior of its own
    low, high = unknowns.lower[chosen] / scale, unknowns.upper[chosen] / scale
    rounding = float(np.sum((ROUNDING / data.sigma[data.mask]) ** 2))
    tau, width = prior_scale or 1.0, prior[effects]
    damping, converged, count, idle = 0.0, False, 0, 0

    def widened() -> np.ndarray:
        out = prior.copy()
        out[geometric] *= tau
        out[effects] = width
        return out

    def position(model: Model) -> np.ndarray:
        return current(model, unknowns)[chosen] / scale

    def cost(u: np.ndarray, at: tuple[np.ndarray, Prediction]) -> float:
        if not at[1].reached.all():
            return np.inf
        off = (at[0] / data.sigma)[data.mask]
        return float(off @ (weight[linear.row] * off) + np.sum((u / widened()) ** 2))

    def triangle() -> np.ndarray:
        """All that the weighted rows say of the chosen unknowns, in units of their natural size."""
        if loss == "linear":
            whole = linear.triangle
        else:
            root = np.sqrt(weight)[linear.row]
            whole = least_squares.triangle(linear.jacobian * root[:, None], linear.residual * root)
        return whole[:, np.append(chosen, -1)] * np.append(scale, 1.0)

    def clipped(step: np.ndarray, R: np.ndarray) -> np.ndarray:
        return least_squares.within(R, step, low - u, high - u) if unknowns.bounded else step

    def after(step: np.ndarray) -> tuple[Model, tuple[np.ndarray, Prediction]]:
        full = np.zeros(len(unknowns.names))
        full[chosen] = step * scale
        moved = apply(model, unknowns, full)
        start = ahead(model, at[1], linear.motion @ full[:g])
        return moved, residuals(moved, data, start)

    def left_to_go(R: np.ndarray) -> np.ndarray:
        """What the next step would be, by the slope here and the information R from where the last one began."""
        slope = (linear.residual * weight[linear.row]) @ linear.jacobian
        return clipped(least_squares.descend(R, slope[chosen] * scale - u / widened() ** 2), R)

    if unknowns.bounded:
        here = current(model, unknowns)
        model = apply(model, unknowns, np.clip(here, unknowns.lower, unknowns.upper) - here)
        at = residuals(model, data, at[1].pose)
    u, weight = position(model), robust_weights(at[0], data, loss)
    linear = linearise(model, data, unknowns, at)
    rows = triangle()
    while True:
        if prior_scale is None and len(geometric) and not damping and count < _SETTLED and np.isfinite(rows).all():
            tau = _evidence(rows, u, widened(), geometric)
        largest = np.max(np.sum(rows[:, :-1] ** 2, axis=0), initial=1.0) if damping else 1.0
        step, R = least_squares.solve(rows, -u, widened(), float(damping * largest))
        begun = linear
        if count >= max_iterations or not np.isfinite(step).all():
            break
        step = clipped(step, R)
        trial, tried = after(step)
        count += 1
        if max_iterations == 1:
            model, at, converged = trial, tried, True
            break
        here, there = cost(u, at), cost(position(trial), tried)
        if not there <= here + rounding + 2 * np.sqrt(here * rounding):
            if damping and idle >= _IDLE:
                break  # no step leads on, and yet the slope does not vanish: χ² jumps here, as by the sign of a load
            damping = max(100 * damping, _LEAST_DAMPING)
            continue
        negligible = NEGLIGIBLE * max(1.0, here / data.mask.sum())
        idle = idle + 1 if here - there < negligible else 0
        model, at, u = trial, tried, position(trial)
        earlier = weight, width
        weight = robust_weights(at[0], data, loss)
        if len(effects) and not damping and count <= _SETTLED:
            width = _widths(u[effects], least_squares.variances(R)[effects], width, prior[effects])
        moved = np.abs(width / earlier[1] - 1).max(initial=0.0)
        steady = np.abs(weight - earlier[0]).max() < 1e-3 and moved < _STEADY
        linear = linearise(model, data, unknowns, at)
        if damping:  # what is left to go is asked without it
            R = least_squares.solve(rows, -u, widened())[1]
        left = left_to_go(R)
        gain = float(np.sum((R @ left) ** 2))
        near = np.abs(left).max(initial=0.0) < TOLERANCE or gain < _NOTHING
        converged = bool(steady and (near or (idle >= _IDLE and (not damping or gain < negligible))))
        if converged:
            trial, tried = after(left)  # known already, and worth more digits than it costs
            if cost(position(trial), tried) <= cost(u, at):
                model, at = trial, tried
            break
        damping = damping / 10 if damping > _LEAST_DAMPING else 0.0
        rows = triangle()
    if damping:
        R = least_squares.solve(rows, -u, widened())[1]  # what the data say, not how the search went
    return State(model, at[0], at[1].unsettled, R, begun, weight, tau, count, converged)


def _evidence(rows: np.ndarray, u: np.ndarray, prior: np.ndarray, geometric: np.ndarray) -> float:
    """The prior's scale τ that agrees with the geometric errors found, never below the stated tolerances.

    Along an eigenvector of the data's information λ the unshrunk estimate has variance τ² + 1/λ. Evidence asks that
    the shrunk ones have the size that they should have in the mean square (MacKay 1992). Where the data know many
    directions better than the drawing does, their median is asked for and not the mean: something that the model
    misses shows in a few directions, as errors of many tolerances, and must not make room for itself. Nothing here
    depends on an earlier τ, so that τ is found at once.

    Args:
        rows: (·, n + 1) what the data say of a step from u.
        prior: (n,) 1σ of the unknowns; that of geometry does not count.
    """
    corner = rows
    if len(geometric) < len(u):
        # In triangular form with the geometry last, its corner holds what the other unknowns leave of its information.
        others = np.setdiff1d(np.arange(len(u)), geometric)
        corner = least_squares.with_priors(rows[:, np.r_[others, geometric, -1]], -u[others], prior[others])
        corner = np.asarray(np.linalg.qr(corner, mode="r"))[len(others) :, len(others) :]
    J, y = corner[:, :-1], corner[:, -1]
    of_data, V = np.linalg.eigh(J.T @ J)
    known = of_data > 1
    many = known.sum() >= _MANY
    seen = known if many else of_data > 1e-6
    if not seen.any():
        return 1.0
    estimate = (V.T @ (J.T @ (y + J @ u[geometric])))[seen] / of_data[seen]
    share = _SCALES[:, None] ** 2 / (_SCALES[:, None] ** 2 + 1 / of_data[seen])
    if many:
        shrunk = np.sort(np.abs(estimate) * np.sqrt(share), axis=1)
        size = 0.5 * (shrunk[:, (len(estimate) - 1) // 2] + shrunk[:, len(estimate) // 2]) / (_MEDIAN * _SCALES)
    else:
        size = np.sqrt(np.sum((share * estimate) ** 2, axis=1) / np.sum(share, axis=1)) / _SCALES
    enough = np.flatnonzero(size <= 1)
    if not len(enough) or enough[0] == 0:
        return float(_SCALES[0 if len(enough) else -1])
    between = slice(enough[0] - 1, enough[0] + 1)
    return float(np.exp(np.interp(0.0, -np.log(np.maximum(size[between], 1e-300)), np.log(_SCALES[between]))))


def _widths(u: np.ndarray, variance: np.ndarray, width: np.ndarray, least: np.ndarray) -> np.ndarray:
    """1σ of the priors of effects: one that is seen to be larger than usual is given room for it, and so not shrunk."""
    gamma = 1.0 - variance / width**2
    seen = np.isfinite(gamma) & (gamma > 0.5)
    room = EFFECT_PRIOR_WIDTH * np.abs(u) / np.sqrt(np.where(seen, gamma, 1.0))
    return np.where(seen, np.maximum(room, least), width)


def robust_weights(error: np.ndarray, data: Measurements, loss: str) -> np.ndarray:
    """Weight (N,) of each row from its residual length per component, in σ: metres and radians count alike."""
    if loss == "linear":
        return np.ones(len(error))
    seen = ~np.isnan(error)
    z2 = np.sum(np.where(seen, error / data.sigma, 0.0) ** 2, axis=1) / np.maximum(seen.sum(axis=1), 1)
    z = np.sqrt(z2)
    scale = max(1.0, float(np.median(z)) / 0.9)  # a misfit common to all rows is no outlier
    z = z / (scale * ROBUST_AT)
    return np.where(z <= 1, 1.0, 1 / np.maximum(z, 1)) if loss == "huber" else 1 / (1 + z * z)
