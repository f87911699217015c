"""Friction in loaded drives: the arm stops short of where its motor is, by the side it came from."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, drive_unit


class FrictionHysteresis(PlacedEffect):
    """δq_i = −c·dir_i·|τ_i| [rad or m]: friction grows with the load and winds the drive up; about 10 µrad/(N·m)."""

    title: ClassVar[str] = "friction winds the drives up"
    channels: ClassVar[tuple[str, ...]] = ("actuator",)
    wants: ClassVar[tuple[str, ...]] = ("direction of motion", "payload")

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(f"dir{i + 1}" for i in range(len(self.places.arms)))

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        unit = drive_unit(self.places, "urad_Nm", "um_N")
        prior, high = (1e-5, 1e-3) if self.places.dimension == "angle" else (2e-8, 2e-6)
        return (EffectParameter("per_load", unit, prior, 0.0, high),)

    def shapes(self, at: Situation) -> np.ndarray:
        return -(at.directions() * np.abs(at.torque))[None]


EFFECT = FrictionHysteresis
