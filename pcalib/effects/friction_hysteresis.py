"""Friction in loaded drives: the arm stops short of its motor's position, on the side from which it came."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect


class FrictionHysteresis(PlacedEffect):
    """δq_i = −c·dir_i·|τ_i| [rad or m]: friction grows with the load and winds the drive up; about 10 µrad/(N·m).

    Above 200 µrad/(N·m) a drive would not turn back by itself.
    """

    title = "friction winds the drives up"
    channels = ("actuator",)
    wants = ("direction of motion", "payload")

    quantities = (EffectParameter("per_load", "urad_Nm", 1e-5, 0.0, 1e-3, plausible=(0.0, 2e-4)),)
    sliding = (EffectParameter("per_load", "um_N", 2e-8, 0.0, 2e-6, plausible=(0.0, 1e-6)),)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "needs", tuple(f"dir{i + 1}" for i in range(len(self.places.arms))))

    def shapes(self, at: Situation) -> np.ndarray:
        return -(at.directions() * np.abs(at.torque))[None]


EFFECT = FrictionHysteresis
