"""Arms that grow with temperature."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, pivots, unsuited_without_arms
from pcalib.mechanics.mechanism import Mechanism

REFERENCE = 20.0
"""[°C] temperature that dimensions are stated for."""


class ThermalArms(PlacedEffect):
    """a_r → a_r·(1 + α·(T − 20 °C)), the whole vector: length and spacing grow together.

    Aluminium 23.6, CFRP 0–2 ppm/K.
    """

    title: ClassVar[str] = "arms grow with temperature"
    channels: ClassVar[tuple[str, ...]] = ("elbow",)
    wants: ClassVar[tuple[str, ...]] = ("temperature",)

    @property
    def needs(self) -> tuple[str, ...]:
        return ("temp_arms",)

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        return (EffectParameter("expansion", "ppm_K", 1.5e-5, -5e-6, 1e-4),)

    def unsuited(self, mechanism: Mechanism) -> str:
        return unsuited_without_arms(mechanism)

    def shapes(self, at: Situation) -> np.ndarray:
        warmer = at.column("temp_arms") - REFERENCE
        return (warmer[:, None, None] * (at.side.A - pivots(at)))[None]


EFFECT = ThermalArms
