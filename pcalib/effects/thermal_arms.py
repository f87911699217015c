"""Arms that grow with temperature."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import ClosedForm, Situation
from pcalib.effects.library import EXPANSION, PlacedEffect, pivots, unsuited_without_arms, warmer
from pcalib.mechanics.mechanism import Mechanism


class ThermalArms(PlacedEffect):
    """a_r → a_r·(1 + α·(T − 20 °C)), the whole vector: length and spacing grow together.

    Aluminium 23.6, CFRP 0–2 ppm/K.
    """

    title = "arms grow with temperature"
    channels = ("elbow",)
    wants = ("temperature",)

    needs = ("temp_arms",)

    quantities = (EXPANSION,)

    def unsuited(self, mechanism: Mechanism) -> str:
        return unsuited_without_arms(mechanism)

    def shapes(self, at: Situation) -> np.ndarray:
        return (warmer(at, "arms")[:, None, None] * (at.side.A - pivots(at)))[None]

    def closed_form(self, theta: np.ndarray) -> ClosedForm:
        return ClosedForm(arms=self.placed(theta)[0])


EFFECT = ThermalArms
