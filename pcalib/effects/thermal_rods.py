"""Rods that grow with temperature."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import ClosedForm, Situation
from pcalib.effects.library import EXPANSION, PlacedEffect, warmer


class ThermalRods(PlacedEffect):
    """l_r → l_r·(1 + α·(T − 20 °C)). Aluminium 23.6, CFRP 0–2 ppm/K."""

    title = "rods grow with temperature"
    variants = ("common", "arm", "rod")
    channels = ("rod",)
    wants = ("temperature",)

    needs = ("temp_rods",)

    quantities = (EXPANSION,)

    def shapes(self, at: Situation) -> np.ndarray:
        return (warmer(at, "rods")[:, None] * np.broadcast_to(at.side.length, at.tension.shape))[None]

    def closed_form(self, theta: np.ndarray) -> ClosedForm:
        return ClosedForm(rods=self.placed(theta)[0])


EFFECT = ThermalRods
