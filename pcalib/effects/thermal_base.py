"""A base that grows with temperature."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, pivots
from pcalib.mechanics.mechanism import Mechanism

REFERENCE = 20.0
"""[°C] temperature that dimensions are stated for."""


class ThermalBase(PlacedEffect):
    """p_i → p_i·(1 + α·(T − 20 °C)) about the base origin. Aluminium 23.6, steel 12 ppm/K."""

    title: ClassVar[str] = "the base grows with temperature"
    variants: ClassVar[tuple[str, ...]] = ("common",)
    channels: ClassVar[tuple[str, ...]] = ("elbow",)
    wants: ClassVar[tuple[str, ...]] = ("temperature",)

    @property
    def needs(self) -> tuple[str, ...]:
        return ("temp_base",)

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        return (EffectParameter("expansion", "ppm_K", 1.5e-5, -5e-6, 1e-4),)

    def unsuited(self, mechanism: Mechanism) -> str:
        return "" if hasattr(mechanism.actuation, "p") else "its base points are no parameters of their own"

    def shapes(self, at: Situation) -> np.ndarray:
        warmer = at.column("temp_base") - REFERENCE
        return (warmer[:, None, None] * pivots(at))[None]


EFFECT = ThermalBase
