"""Gravity that does not point along the base's −z: the robot hangs crooked."""

from __future__ import annotations

import numpy as np

from pcalib import rotation
from pcalib.effects.base import Contribution, Effect, EffectParameter, Situation
from pcalib.effects.library import LibraryEffect


class GravityTilt(LibraryEffect):
    """g → exp(ρ)·g with ρ = (ρx, ρy, 0) [rad]: what the other effects add under that gravity, less what they add now.

    A rigid robot does not feel it: it is seen only through effects that answer to load (compliances, clearance),
    and only where one of them is in the model. More than 0.1 rad is not
    plausible, because it is seen by eye.
    """

    title = "the robot hangs crooked in gravity"
    variants = ("common",)
    channels = ("actuator", "rod", "elbow", "tool")
    linear = False
    indirect = True
    wants = ("a compliance in the model", "payload")

    quantities = tuple(EffectParameter(f"tilt_{a}", "mrad", 1e-2, -0.3, 0.3, plausible=(-0.1, 0.1)) for a in "xy")

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        total = Contribution()
        partners = [(effect, value) for effect, value in at.partners if effect.name != self.name]
        if not partners:
            return total
        tilted, now = self._both(at, theta)
        for effect, value in partners:
            total = total + effect.contribution(tilted, value) + effect.contribution(now, value).scaled(-1.0)
        return total

    def through(self, at: Situation, theta: np.ndarray, other: Effect, other_theta: np.ndarray) -> list[Contribution]:
        by = (other.basis(there, other_theta) for there in self._both(at, theta))
        return [tilted + now.scaled(-1.0) for tilted, now in zip(*by, strict=True)]

    def _both(self, at: Situation, theta: np.ndarray) -> tuple[Situation, Situation]:
        """The situation under tilted and under present gravity."""
        return at.under(rotation.exp(np.array([theta[0], theta[1], 0.0])) @ at.g), at.under(at.g)


EFFECT = GravityTilt
