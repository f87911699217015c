"""Rods that stretch and shorten under their own force."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, stiffness


class RodCompliance(PlacedEffect):
    """δl_r = c·T_r with c = 1/k [m/N], T > 0 tension; k = EA/l is 10–50 N/µm with joints, in thin tubes 0.5."""

    title = "rods stretch under load"
    variants = ("common", "arm", "rod")
    channels = ("rod",)
    wants = ("payload",)

    quantities = (EffectParameter("compliance", "um_N", 5e-8, 0.0, 1e-5, plausible=(0.0, 2e-6), alike=0.5),)

    def shapes(self, at: Situation) -> np.ndarray:
        return at.tension[None]

    def say(self, quantity: EffectParameter, value: float) -> str:
        return f"{super().say(quantity, value)} {stiffness(value, quantity.unit, 'rod')}"


EFFECT = RodCompliance
