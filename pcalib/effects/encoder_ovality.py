"""Encoders whose reading errs twice per turn."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, amplitude, harmonics, unsuited_without_angles
from pcalib.mechanics.mechanism import Mechanism


class EncoderOvality(PlacedEffect):
    """δq_i = A·sin 2q_i + B·cos 2q_i [rad]. From an oval disc or a wobbling shaft; some ten arc seconds."""

    title = "encoder discs run oval"
    channels = ("actuator",)
    wants = ("wide range of motor angles",)

    quantities = tuple(EffectParameter(part, "arcsec", 1e-4, -1e-2, 1e-2) for part in ("sine", "cosine"))

    def unsuited(self, mechanism: Mechanism) -> str:
        return unsuited_without_angles(mechanism)

    def shapes(self, at: Situation) -> np.ndarray:
        return harmonics(at.q, (2,))

    def describe(self, theta: np.ndarray) -> str:
        return "amplitude " + amplitude(np.reshape(theta, (2, -1)), self.places.members(self.per), "arcsec")


EFFECT = EncoderOvality
