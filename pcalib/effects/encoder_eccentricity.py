"""Encoders whose reading errs once per turn."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, amplitude, harmonics, unsuited_without_angles
from pcalib.mechanics.mechanism import Mechanism


class EncoderEccentricity(PlacedEffect):
    """δq_i = A·sin q_i + B·cos q_i [rad]. A disc of 50 mm that runs 10 µm off centre errs by 83″."""

    title = "encoder discs run off centre"
    channels = ("actuator",)
    wants = ("wide range of motor angles",)

    quantities = tuple(EffectParameter(part, "arcsec", 2e-4, -1e-2, 1e-2) for part in ("sine", "cosine"))

    def unsuited(self, mechanism: Mechanism) -> str:
        return unsuited_without_angles(mechanism)

    def shapes(self, at: Situation) -> np.ndarray:
        return harmonics(at.q, (1,))

    def describe(self, theta: np.ndarray) -> str:
        return "amplitude " + amplitude(np.reshape(theta, (2, -1)), self.places.members(self.per), "arcsec")


EFFECT = EncoderEccentricity
