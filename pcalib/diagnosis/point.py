"""A model on a set of poses: what a unit deviation of each actuator and rod does to the readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib import prediction, rotation
from pcalib.effects.base import Contribution, Situation
from pcalib.mechanics.kinematics import Closure
from pcalib.model import Model
from pcalib.prediction import Conditions, Prediction


@dataclass(frozen=True)
class Response:
    """Derivatives of the readings (N, 6) by unit deviations."""

    actuator: np.ndarray
    """(N, 6, nq) per rad or m of each actuator."""
    rod: np.ndarray
    """(N, 6, m) per metre of each rod."""


@dataclass(frozen=True)
class Point:
    """A model on a set of poses, with everything that effects and patterns are computed from."""

    model: Model
    prediction: Prediction
    situation: Situation
    closure: Closure
    JX: np.ndarray
    """(N, m, n_state)."""

    @classmethod
    def of(cls, model: Model, p: Prediction, conditions: Conditions) -> Point:
        """The state behind a prediction."""
        at = p.situation
        if at is None:
            at = model.situation(p.q, p.pose, conditions, p.deviation)
        closed, JX = prediction.closure_of(model, p)
        return cls(model, p, at, closed, JX)

    def columns(self, parts: list[Contribution]) -> np.ndarray:
        """Derivative of the readings by the size of each contribution, (N, 6, len(parts))."""
        return prediction.effect_columns(self.model, self.prediction, self.closure, self.JX, parts)

    def lever(self) -> np.ndarray:
        """(N, 3) [m] from the plate's origin to the measured point, measuring frame."""
        p, frame = self.prediction, self.model.frame
        arm = (p.pose.R @ p.tool[..., None])[..., 0]
        return arm if frame is None else arm @ frame.rotation.T

    def turn(self) -> np.ndarray:
        """(N, 6, 3) derivative of the readings by a turn of the measured body about the plate's origin."""
        arm = self.lever()
        return np.concatenate([-rotation.hat(arm), np.broadcast_to(np.eye(3), (len(arm), 3, 3))], axis=1)

    def rigid(self) -> np.ndarray:
        """(N, 6, 6) derivative of the readings by motions of the measured body along and about the axes."""
        return prediction.rigid(self.model, self.prediction)

    def response(self) -> Response:
        """Unit responses of every actuator and rod."""
        N, nq = self.situation.q.shape
        m = self.situation.tension.shape[1]
        ones = [np.broadcast_to(row, (N, nq)) for row in np.eye(nq)]
        rods = [np.broadcast_to(row, (N, m)) for row in np.eye(m)]
        return Response(
            self.columns([Contribution(actuator=one) for one in ones]),
            self.columns([Contribution(rod=rod) for rod in rods]),
        )
