"""Drives that give way under load: gearboxes, belts and couplings as springs."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, stiffness


class DriveCompliance(PlacedEffect):
    """δq_i = c·τ_i with c = 1/k [rad/(N·m), or m/N on carriages], τ_i the load the drive holds.

    The arm moves the way its load turns it. Gearboxes have 41–120 kN·m/rad, belts about 15 (maker's data),
    the smallest strain-wave gears 1; toothed belts of printers pull with 0.2–1 N/µm.
    """

    title = "drives give way under load"
    channels = ("actuator",)
    wants = ("payload",)

    quantities = (EffectParameter("compliance", "urad_Nm", 5e-5, 0.0, 5e-3, plausible=(0.0, 1e-3), alike=0.5),)
    sliding = (EffectParameter("compliance", "um_N", 1e-7, 0.0, 1e-5, plausible=(0.0, 5e-6), alike=0.5),)

    def shapes(self, at: Situation) -> np.ndarray:
        return at.torque[None]

    def say(self, quantity: EffectParameter, value: float) -> str:
        return f"{super().say(quantity, value)} {stiffness(value, quantity.unit, 'drive')}"


EFFECT = DriveCompliance
