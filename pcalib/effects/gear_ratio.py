"""A gear ratio, belt or screw pitch that is not what the controller believes."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import ClosedForm, EffectParameter, Situation
from pcalib.effects.library import PlacedEffect


class GearRatio(PlacedEffect):
    """δq_i = g·q_i, g dimensionless. More than 0.1 % suggests wrong units or a wrong tooth count.

    Belts reach 0.5 % by the thickness of their teeth.
    """

    title = "the gear ratio is off"
    channels = ("actuator",)
    wants = ("wide range of motor positions",)

    quantities = (EffectParameter("ratio_error", "ppm", 5e-4, -2e-2, 2e-2, plausible=(-5e-3, 5e-3)),)

    def shapes(self, at: Situation) -> np.ndarray:
        return at.q[None]

    def closed_form(self, theta: np.ndarray) -> ClosedForm:
        return ClosedForm(ratio=self.placed(theta)[0])


EFFECT = GearRatio
