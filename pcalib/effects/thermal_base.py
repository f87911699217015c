"""A base that grows with temperature."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import ClosedForm, Situation
from pcalib.effects.library import EXPANSION, PlacedEffect, pivots, warmer
from pcalib.mechanics.mechanism import Mechanism


class ThermalBase(PlacedEffect):
    """p_i → p_i·(1 + α·(T − 20 °C)) about the base origin. Aluminium 23.6, steel 12 ppm/K."""

    title = "the base grows with temperature"
    variants = ("common",)
    channels = ("elbow",)
    wants = ("temperature",)

    needs = ("temp_base",)

    quantities = (EXPANSION,)

    def unsuited(self, mechanism: Mechanism) -> str:
        return "" if len(mechanism.base_points) else "its base points are no parameters of their own"

    def shapes(self, at: Situation) -> np.ndarray:
        return (warmer(at, "base")[:, None, None] * pivots(at))[None]

    def closed_form(self, theta: np.ndarray) -> ClosedForm:
        return ClosedForm(base=self.placed(theta)[0])


EFFECT = ThermalBase
