"""Levenberg–Marquardt on scaled unknowns, one step at a time; weights and priors are re-estimated in between."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.fitting import evidence, least_squares
from pcalib.fitting.evidence import Weights
from pcalib.fitting.linearisation import Information, evaluate, information
from pcalib.fitting.unknowns import Unknowns, apply, current
from pcalib.model import Model
from pcalib.prediction import Prediction, ahead

TOLERANCE = 1e-5
"""A fit has converged when what is left to go is below this share of every unknown's natural size, or when χ² would
gain no more than this: neither shows in any figure of five digits."""
ROUNDING = 1e-13
"""[m, rad] accuracy to which forward kinematics closes the loops: no step is rejected for so small a rise."""
NEGLIGIBLE = 1e-3
"""Gain of a step in χ², in units of χ²/M, that no noise would let anyone see."""
_IDLE = 3
"""Number of such steps in a row that ends the search. Where a model misses something, Gauss–Newton creeps on along
directions that the data hardly know; damped steps are short by themselves and prove nothing."""
_AGAIN = 5
"""Most searches that are made again because they had to be damped; two are usual."""
_SETTLED = 10
"""Number of steps after which the scales of priors stay what they are, so that they cannot keep a fit from ending."""
_STEADY_ROWS, _STEADY_ROOM = 1e-3, 0.05
"""Changes of a row's weight and of an effect's prior below which a fit may end: such changes move results by far
less than σ."""
_LEAST_DAMPING = 1e-12
"""Share of the largest diagonal element of JᵀJ below which damping is none: the square root is rounding."""
_MORE_DAMPING, _LESS_DAMPING = 100.0, 0.1
"""Factors after a step that is rejected and one that is accepted."""

At = tuple[np.ndarray, Prediction]
"""Residuals (N, 6) of a model, and its prediction."""


@dataclass(frozen=True, eq=False)
class Task:
    """What is minimised: Σ w·|W·(measured − predicted)|² + Σ (u/prior)² over chosen unknowns u in natural sizes."""

    data: Measurements
    noise: Noise
    unknowns: Unknowns
    chosen: np.ndarray
    """Indices into `unknowns`; the others stay where the model has them."""
    loss: str = "linear"
    prior_scale: float | None = None
    """Common factor on the priors of the geometry; estimated (≥ 1) when None."""
    max_iterations: int = 60
    """1 takes one full step and does not judge it."""

    @cached_property
    def scale(self) -> np.ndarray:
        """(n,) natural sizes of the chosen unknowns."""
        return self.unknowns.scale[self.chosen]

    @cached_property
    def prior(self) -> np.ndarray:
        """(n,) 1σ of the priors in natural sizes; inf where there is none."""
        return self.unknowns.prior[self.chosen] / self.scale

    @cached_property
    def geometric(self) -> np.ndarray:
        """Positions in `chosen` of the geometric unknowns that have a prior."""
        return np.flatnonzero((self.chosen < self.unknowns.n_geometry) & np.isfinite(self.prior))

    @cached_property
    def effects(self) -> np.ndarray:
        """Positions in `chosen` of the effects' parameters."""
        g, e = self.unknowns.n_geometry, self.unknowns.n_effects
        return np.flatnonzero((self.chosen >= g) & (self.chosen < g + e) & np.isfinite(self.prior))

    @cached_property
    def rounding(self) -> float:
        """The change of χ² that rounding in forward kinematics can cause."""
        return float(np.sum((ROUNDING / self.data.sigma[self.data.mask]) ** 2))

    def held(self, weights: Weights) -> np.ndarray:
        """(n,) 1σ of the priors under some weights."""
        out = self.prior.copy()
        out[self.geometric] *= weights.scale * weights.gross
        out[self.effects] = weights.room
        return out

    def position(self, model: Model) -> np.ndarray:
        """(n,) where a model is."""
        return current(model, self.unknowns)[self.chosen] / self.scale

    def cost(self, u: np.ndarray, at: At, weights: Weights) -> float:
        """χ² and the priors' part; inf where loops do not close."""
        if not at[1].reached.all():
            return np.inf
        off = self.noise.whiten(at[0])
        return float(off @ (weights.row[self.noise.row] * off) + np.sum((u / self.held(weights)) ** 2))

    def within(self, step: np.ndarray, R: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The least-squares step within the bounds."""
        if not self.unknowns.bounded:
            return step
        low, high = (bound[self.chosen] / self.scale for bound in (self.unknowns.lower, self.unknowns.upper))
        return least_squares.within(R, step, low - u, high - u)

    def linearised(self, model: Model, at: At, weight: np.ndarray | None = None) -> Information:
        """What the data say at a model with weights (N,) of the rows."""
        alike = np.ones(len(self.data)) if weight is None else weight
        return information(model, self.data, self.unknowns, at, self.noise, alike)

    def scaled(self, linear: Information) -> np.ndarray:
        """(·, n + 1) what the data say of the chosen unknowns in natural sizes."""
        return linear.triangle[:, np.append(self.chosen, -1)] * np.append(self.scale, 1.0)


@dataclass(frozen=True, eq=False)
class State:
    """Where a search stands."""

    model: Model
    at: At
    u: np.ndarray
    """(n,) position, in natural sizes."""
    weights: Weights
    linear: Information
    """What the data say at the model, and"""
    rows: np.ndarray
    """(·, n + 1) the same of the chosen unknowns in natural sizes."""
    begun: Information
    """What the data said where the last step began: that is what `R` is made of."""
    R: np.ndarray
    """(n, n) triangular factor of the information there, without damping."""
    damping: float = 0.0
    iterations: int = 0
    idle: int = 0
    """Accepted steps in a row that gained nothing to speak of."""
    negligible: float = 0.0
    """Decrease of the cost that counts as nothing where the last step began."""
    accepted: bool = True
    converged: bool = False
    stuck: bool = False
    """No further step is possible."""
    turns: int = 0
    """Steps of this search."""
    stale: bool = False
    """The priors were last re-estimated before steps that had to be damped."""


def minimise(task: Task, model: Model, at: At) -> State:
    """Search from a model with residuals `at` until converged, stuck or out of iterations.

    A search that had to be damped never saw what its minimum says of the priors, and is made again from there.
    """
    state = search(task, start(task, model, at))
    for _ in range(_AGAIN):
        if not (state.converged and state.stale):
            break
        again = replace(start(task, state.model, state.at), iterations=state.iterations)
        state = search(task, again)
    return state


def search(task: Task, state: State) -> State:
    """Steps from a state until converged, stuck or out of iterations."""
    while not (state.converged or state.stuck):
        state = reweigh_priors(task, state)
        before = state.weights
        state = step(task, state)
        if state.accepted and not state.converged:
            state = relinearise(task, state)
            state = finish(task, state) if converged(task, state, before) else relaxed(state)
    if state.damping and state.stuck:  # the covariance is what the data say, not how the search went
        state = replace(state, R=least_squares.solve(state.rows, -state.u, task.held(state.weights))[1])
    return state


def start(task: Task, model: Model, at: At) -> State:
    """The state at a model, moved to its nearest bounds."""
    unknowns = task.unknowns
    if unknowns.bounded:
        here = current(model, unknowns)
        model = apply(model, unknowns, np.clip(here, unknowns.lower, unknowns.upper) - here)
        at = evaluate(model, task.data, at[1].pose)
    row = evidence.robust_weights(at[0], task.noise, task.loss)
    weights = Weights(row, task.prior_scale or 1.0, np.ones(len(task.geometric)), task.prior[task.effects])
    linear = task.linearised(model, at, row)
    return State(model, at, task.position(model), weights, linear, task.scaled(linear), linear, np.zeros((0, 0)))


def reweigh_priors(task: Task, state: State) -> State:
    """The state with the common scale of the priors that the data support here."""
    estimated = task.prior_scale is None and len(task.geometric) > 0
    if not estimated or not np.isfinite(state.rows).all():
        return state
    state = replace(state, turns=state.turns + 1, stale=state.stale or bool(state.damping))
    if state.damping or state.turns > _SETTLED:
        return state
    weights = state.weights
    prior = task.prior.copy()
    prior[task.effects] = weights.room
    scale, gross = evidence.priors(state.rows, state.u, prior, task.geometric, int(task.data.mask.sum()))
    weights = replace(weights, scale=scale, gross=gross)
    return replace(state, weights=weights, stale=False)


def step(task: Task, s: State) -> State:
    """One step of Levenberg–Marquardt: accepted with its state, or rejected with more damping."""
    held = task.held(s.weights)
    largest = np.max(np.sum(s.rows[:, :-1] ** 2, axis=0), initial=1.0) if s.damping else 1.0
    move, R = least_squares.solve(s.rows, -s.u, held, float(s.damping * largest))
    s = replace(s, begun=s.linear, R=R)
    if s.iterations >= task.max_iterations or not np.isfinite(move).all():
        return replace(s, accepted=False, stuck=True)
    model, at = _after(task, s, task.within(move, R, s.u))
    u = task.position(model)
    s = replace(s, iterations=s.iterations + 1)
    if task.max_iterations == 1:
        return replace(s, model=model, at=at, u=u, converged=True)
    here, there = task.cost(s.u, s.at, s.weights), task.cost(u, at, s.weights)
    if not there <= here + task.rounding + 2 * np.sqrt(here * task.rounding):
        if s.damping and s.idle >= _IDLE:  # χ² jumps here, as by the sign of a load, though its slope does not vanish
            return replace(s, accepted=False, stuck=True)
        damping = max(_MORE_DAMPING * s.damping, _LEAST_DAMPING)
        return replace(s, accepted=False, damping=damping)
    negligible = NEGLIGIBLE * max(1.0, here / task.data.mask.sum())
    idle = s.idle + 1 if here - there < negligible else 0
    return replace(s, model=model, at=at, u=u, idle=idle, negligible=negligible, accepted=True)


def relinearise(task: Task, s: State) -> State:
    """The state after an accepted step with weights of rows and effects re-estimated, and linearised anew."""
    row, room = evidence.robust_weights(s.at[0], task.noise, task.loss), s.weights.room
    if len(task.effects) and not s.damping and s.iterations <= _SETTLED:
        variance = least_squares.variances(s.R)[task.effects]
        room = evidence.effect_room(s.u[task.effects], variance, room, task.prior[task.effects])
    R = s.R
    if s.damping:  # what is left to go is asked without damping
        R = least_squares.solve(s.rows, -s.u, task.held(s.weights))[1]
    weights = replace(s.weights, row=row, room=room)
    linear = task.linearised(s.model, s.at, row)
    return replace(s, weights=weights, linear=linear, rows=task.scaled(linear), R=R)


def converged(task: Task, s: State, before: Weights) -> bool:
    """Whether a state that was just linearised is a minimum: its weights are steady and the next step is negligible."""
    rows, room = s.weights.change(before)
    if not (rows < _STEADY_ROWS and room < _STEADY_ROOM):
        return False
    left = _left(task, s)
    gain = float(np.sum((s.R @ left) ** 2))
    near = np.abs(left).max(initial=0.0) < TOLERANCE or gain < TOLERANCE
    tired = s.idle >= _IDLE and (not s.damping or gain < s.negligible)
    return bool(near or tired)


def relaxed(s: State) -> State:
    """The state with less damping, after a step that was accepted."""
    return replace(s, damping=_LESS_DAMPING * s.damping if s.damping > _LEAST_DAMPING else 0.0)


def finish(task: Task, s: State) -> State:
    """The minimum, with the last correction taken where it helps: it is known already and worth more digits."""
    model, at = _after(task, s, _left(task, s))
    u = task.position(model)
    if task.cost(u, at, s.weights) <= task.cost(s.u, s.at, s.weights):
        s = replace(s, model=model, at=at, u=u)
    return replace(s, converged=True)


def _left(task: Task, s: State) -> np.ndarray:
    """Estimate of the next step (n,): from the slope here and the information R at the start of the last step."""
    slope = s.rows[:, :-1].T @ s.rows[:, -1] - s.u / task.held(s.weights) ** 2
    return task.within(least_squares.descend(s.R, slope), s.R, s.u)


def _after(task: Task, s: State, move: np.ndarray) -> tuple[Model, At]:
    """The model after a move (n,) in natural sizes, and its residuals."""
    full = np.zeros(len(task.unknowns.names))
    full[task.chosen] = move * task.scale
    motion = s.linear.motion
    foreseen = None if motion is None else motion @ full[: task.unknowns.n_geometry]
    start = s.at[1].pose if foreseen is None else ahead(s.model, s.at[1], foreseen)
    model = apply(s.model, task.unknowns, full)
    return model, evaluate(model, task.data, start)
