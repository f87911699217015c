"""A calibrated robot: geometry, effects and measuring frame; :mod:`pcalib.modelfile` writes and reads its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pcalib import rotation
from pcalib.effects.base import Effect, Situation
from pcalib.mechanics.kinematics import RIGID, Deviation
from pcalib.mechanics.mechanism import Pose
from pcalib.posterior import Posterior
from pcalib.robot import Robot
from pcalib.sensors.base import Block
from pcalib.unexplained import Unexplained


@dataclass(frozen=True)
class FittedEffect:
    """An effect with its parameter values."""

    effect: Effect
    theta: np.ndarray
    """(np,) [SI]."""
    spec: str = ""
    """How a command line names it: `drive_compliance`, `drive_compliance:arm`, `my.py:WormGear`."""
    sigma: np.ndarray | None = None
    """(np,) 1σ from the fit."""


@dataclass(frozen=True)
class Frame:
    """Where a tracker stands and how its target sits: it reads y = R·(x_C + R_C·(t + offset)) + translation, and the
    rotation R·R_C·turn."""

    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    """(3, 3) base → measuring frame."""
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) [m], base origin in the measuring frame."""
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) [m], plate frame: the target's place beyond the stated tool point."""
    turn: np.ndarray | None = None
    """(3, 3) axes of the tracked body → plate frame; None where they are taken to be the plate's own."""
    sigma_offset: float = 1e-2
    """[m] 1σ of the target's place about the stated tool point, as the data tell or as is usual."""

    def unknowns(self, offset: bool = True) -> int:
        """Number of unknowns: translation and rotation, the target's offset, and its turn where that is unknown.

        Args:
            offset: whether the target's offset, and its turn, are among them.
        """
        return 6 if not offset else 9 if self.turn is None else 12

    def moved(self, step: np.ndarray) -> Frame:
        """The frame further along `prediction.frame_columns`: translation, rotation, the target's offset and turn.

        Args:
            step: (6, 9 or 12) [m, rad].
        """
        n = len(step)
        turn = self.turn
        if turn is not None and n > 9:
            turn = rotation.renormalise(rotation.exp(step[9:12]) @ turn)
        return Frame(
            rotation.renormalise(rotation.exp(step[3:6]) @ self.rotation),
            self.translation + step[:3],
            self.offset + step[6:9] if n > 6 else self.offset,
            turn,
            self.sigma_offset,
        )


@dataclass(frozen=True)
class Conditions:
    """Tool, payload and recorded conditions of N poses."""

    tool: np.ndarray
    """(N, 3) [m] TCP in the plate frame."""
    payload: np.ndarray
    """(N,) [kg]."""
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Further columns of the data, (N,) each [SI], by name without unit."""
    targeted: np.ndarray | None = None
    """(N,) bool, where the tracker's target is measured, whose offset counts; None: everywhere."""

    @classmethod
    def of(cls, n: int, tool: np.ndarray | Sequence[float] | float = 0.0) -> Conditions:
        """N unloaded poses with one tool."""
        return cls(np.broadcast_to(np.asarray(tool, float), (n, 3)), np.zeros(n))

    def take(self, rows: np.ndarray | slice) -> Conditions:
        """The conditions of some rows."""
        targeted = None if self.targeted is None else self.targeted[rows]
        return Conditions(self.tool[rows], self.payload[rows], {c: v[rows] for c, v in self.columns.items()}, targeted)

    def point(self, frame: Frame) -> np.ndarray:
        """(N, 3) [m] the measured points in the plate frame, the target's offset included."""
        if self.targeted is None:
            return self.tool + frame.offset
        return self.tool + self.targeted[:, None] * frame.offset


METHODS = ("map", "base", "linear")
LOSSES = ("linear", "huber", "cauchy")


@dataclass(frozen=True)
class FitOptions:
    """Options of :func:`pcalib.fitting.identification.fit`; a model keeps them, so that a refit uses the same."""

    method: str = METHODS[0]
    loss: str = LOSSES[0]
    fixed: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Name → (low, high) of the change from nominal [SI]."""
    prior: Mapping[str, float] = field(default_factory=dict)
    """1σ by unit ('m', 'rad', '1') or parameter name [SI]."""

    @property
    def named(self) -> tuple[str, ...]:
        """Names of parameters in `fixed`, `bounds` and `prior`, sorted."""
        return tuple(sorted({*self.fixed, *self.bounds, *(p for p in self.prior if p not in ("m", "rad", "1"))}))


@dataclass(frozen=True)
class Model:
    """Robot + geometry + effects + frame: what a fit produces and every command uses."""

    robot: Robot
    k: np.ndarray
    """(nk,) geometric parameters of `robot.mechanism`."""
    level: str = "nominal"
    effects: tuple[FittedEffect, ...] = ()
    frame: Frame | None = None
    """None where data are measured in the base frame."""
    sigma: np.ndarray | None = None
    """(nk,) 1σ of k from the fit; NaN where the level does not free a parameter."""
    posterior: Posterior | None = None
    """Covariance of geometry and effects from the fit; None where it is not known."""
    options: FitOptions = FitOptions()
    """How it was fitted."""
    time_origin: float | None = None
    """[s] reading of the data's clock from which effects count time: that of the first row that was fitted."""
    history: tuple[Mapping[str, Any], ...] = ()
    """One entry per step (fit, add, drop), oldest first, each with what is needed to go back to it."""
    uncertainty: Unexplained | None = None
    """What the fit left unexplained, and the conditions that were measured; None where it is not known."""
    setup: tuple[Block, ...] = ()
    """What is unknown of the sensors that measured: stations, surfaces, zeros."""

    @classmethod
    def nominal(cls, robot: Robot) -> Model:
        """The robot as drawn."""
        return cls(robot, robot.mechanism.nominal.copy())

    def with_geometry(self, k: np.ndarray) -> Model:
        """The same model at other geometric parameters."""
        return replace(self, k=np.asarray(k, float))

    def situation(self, q: np.ndarray, pose: Pose, conditions: Conditions, deviation: Deviation = RIGID) -> Situation:
        """What effects see at plate poses that close the loops with commands q (N, nq) and deviations."""
        columns, position = conditions.columns, None
        if self.time_origin and "time" in columns:  # a clock may read seconds of the day, or since 1970
            columns = {**columns, "time": columns["time"] - self.time_origin}
        if self.frame is not None:
            position = pose.tcp(conditions.point(self.frame)) @ self.frame.rotation.T + self.frame.translation
        return Situation.at(
            self.robot, self.k, q, pose, conditions.tool, conditions.payload, columns, deviation=deviation,
            position=position, partners=[(f.effect, f.theta) for f in self.effects],
        )  # fmt: skip

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Names of the coordinates of the level, then of the parameters of the effects: what the posterior is about."""
        own = [f"{fitted.effect.name}.{p.name}" for fitted in self.effects for p in fitted.effect.parameters]
        return (*self.robot.mechanism.levels[self.level].columns, *own)

    @property
    def errors(self) -> np.ndarray:
        """(nk,) k minus nominal."""
        return self.k - self.robot.mechanism.nominal
