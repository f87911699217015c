"""Drives that give way under load: gearboxes, belts and couplings as springs."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, drive_unit, stiffness


class DriveCompliance(PlacedEffect):
    """δq_i = c·τ_i with c = 1/k [rad/(N·m), or m/N on carriages], τ_i the load the drive holds.

    The arm moves the way its load turns it. Gearboxes have 41–120 kN·m/rad, belts about 15 (maker's data).
    """

    title: ClassVar[str] = "drives give way under load"
    channels: ClassVar[tuple[str, ...]] = ("actuator",)
    wants: ClassVar[tuple[str, ...]] = ("payload",)

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        unit = drive_unit(self.places, "urad_Nm", "um_N")
        prior, high = (5e-5, 5e-3) if self.places.dimension == "angle" else (1e-7, 1e-5)
        return (EffectParameter("compliance", unit, prior, 0.0, high),)

    def shapes(self, at: Situation) -> np.ndarray:
        return at.torque[None]

    def say(self, quantity: EffectParameter, value: float) -> str:
        return f"{super().say(quantity, value)} {stiffness(value, quantity.unit, 'drive')}"


EFFECT = DriveCompliance
