"""Rods that grow with temperature."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect

REFERENCE = 20.0
"""[°C] temperature that dimensions are stated for."""


class ThermalRods(PlacedEffect):
    """l_r → l_r·(1 + α·(T − 20 °C)). Aluminium 23.6, CFRP 0–2 ppm/K."""

    title: ClassVar[str] = "rods grow with temperature"
    variants: ClassVar[tuple[str, ...]] = ("common", "arm", "rod")
    channels: ClassVar[tuple[str, ...]] = ("rod",)
    wants: ClassVar[tuple[str, ...]] = ("temperature",)

    @property
    def needs(self) -> tuple[str, ...]:
        return ("temp_rods",)

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        return (EffectParameter("expansion", "ppm_K", 1.5e-5, -5e-6, 1e-4),)

    def shapes(self, at: Situation) -> np.ndarray:
        warmer = at.column("temp_rods") - REFERENCE
        return (warmer[:, None] * np.broadcast_to(at.side.length, at.tension.shape))[None]


EFFECT = ThermalRods
