"""Levenberg–Marquardt on scaled unknowns, with priors whose common scale the data may widen and robust row weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib import least_squares
from pcalib.linearisation import Linearisation, linearise, residuals
from pcalib.measurement import Measurements
from pcalib.model import Model
from pcalib.prediction import Prediction
from pcalib.unknowns import Unknowns, apply, current

LOSSES = ("linear", "huber", "cauchy")
ROBUST_AT = 2.5
"""Rows further off than this many σ (per component) weigh less under a robust loss."""
TOLERANCE = 1e-5
"""A fit has converged when what is left to go is below this share of every unknown's natural size."""
ROUNDING = 1e-13
"""[m, rad] what forward kinematics leaves open in a reading: no step is rejected for it."""
_LEAST_DAMPING = 1e-12
"""Share of the largest diagonal element of JᵀJ: less is none."""


@dataclass(frozen=True)
class State:
    """Where a minimisation ended."""

    model: Model
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad]."""
    R: np.ndarray
    """Triangular factor of the information in scaled unknowns."""
    linear: Linearisation
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
    max_iterations: int = 30,
) -> State:
    """Minimise the cost over the chosen unknowns, each in units of its natural size.

    Args:
        chosen: indices into `unknowns`; the others stay where the model has them.
        at: residuals of the model on the data.
        prior_scale: common factor on the priors of geometry; estimated (≥ 1) when absent.
        max_iterations: 1 takes one full step and asks no questions.
    """
    scale = unknowns.scale[chosen]
    prior = unknowns.prior[chosen] / scale
    held = np.isfinite(prior)
    geometric = np.flatnonzero((chosen < unknowns.n_geometry) & held)
    low, high = unknowns.lower[chosen] / scale, unknowns.upper[chosen] / scale
    rounding = float(np.sum((ROUNDING / data.sigma[data.mask]) ** 2))
    tau = prior_scale or 1.0
    damping, converged, count, last = 0.0, False, 0, np.inf

    def widened() -> np.ndarray:
        out = prior.copy()
        out[geometric] *= tau
        return out

    def position(model: Model) -> np.ndarray:
        return current(model, unknowns)[chosen] / scale

    def cost(u: np.ndarray, at: tuple[np.ndarray, Prediction]) -> float:
        if not (at[1].status == "ok").all():
            return np.inf
        misfit = np.nansum(weight[:, None] * (at[0] / data.sigma) ** 2)
        return float(misfit + np.sum((u / widened())[held] ** 2))

    u, weight = position(model), robust_weights(at[0], data, loss)
    linear = linearise(model, data, unknowns, at)
    while True:
        root = np.sqrt(weight)[linear.row]
        J = linear.jacobian[:, chosen] * (scale * root[:, None])
        largest = float(np.max(np.sum(J * J, axis=0), initial=1.0))
        step, R = least_squares.solve(J, root * linear.residual, -u, widened(), damping * largest)
        if count >= max_iterations or not np.isfinite(step).all():
            break
        if unknowns.bounded:
            step = least_squares.within(R, step, low - u, high - u)
        full = np.zeros(len(unknowns.names))
        full[chosen] = step * scale
        trial = apply(model, unknowns, full)
        tried = residuals(trial, data, at[1])
        count += 1
        if max_iterations > 1:
            before = cost(u, at)
            if not cost(position(trial), tried) <= before + rounding + 2 * np.sqrt(before * rounding):
                damping = max(100 * damping, _LEAST_DAMPING)
                continue
        model, at, u = trial, tried, position(trial)
        # What is left to go shrinks as steps do: the next would be about (size/last)·size.
        size = float(np.abs(step).max(initial=0.0))
        left, last = size * (min(1.0, size / last) if np.isfinite(last) else 1.0), size
        earlier = (weight, tau)
        weight = robust_weights(at[0], data, loss)
        if prior_scale is None and len(geometric) and not damping:
            tau = _evidence(u[geometric], R, geometric, tau)
        steady = np.abs(weight - earlier[0]).max() < 1e-3 and abs(tau / earlier[1] - 1) < 5e-2
        converged = max_iterations == 1 or bool(left < TOLERANCE and steady and not damping)
        damping = damping / 10 if damping > _LEAST_DAMPING else 0.0
        if converged:
            break
        linear = linearise(model, data, unknowns, at)
    return State(model, at[0], R, linear, weight, tau, count, converged)


def _evidence(u: np.ndarray, R: np.ndarray, geometric: np.ndarray, tau: float) -> float:
    """The prior's scale that makes the geometric errors found most likely, never below the stated tolerances."""
    well = np.sum(1 - least_squares.variances(R)[geometric] / tau**2)
    return float(np.clip(np.sqrt(np.sum(u * u) / max(well, 1e-3)), 1.0, 100.0)) if np.isfinite(well) else tau


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
