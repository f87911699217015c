"""Play in the drives: the arm hangs back behind its motor."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, drive_unit


class Backlash(PlacedEffect):
    """δq_i = −(b/2)·dir_i [rad or m], b > 0 the whole gap: the arm lags behind its last motion.

    Where the direction is absent or 0, the load chooses the side: δq_i = (b/2)·sign τ_i. Gears have 1–3 arcmin.
    """

    title: ClassVar[str] = "play in the drives"
    channels: ClassVar[tuple[str, ...]] = ("actuator",)
    wants: ClassVar[tuple[str, ...]] = ("direction of motion",)

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        unit = drive_unit(self.places, "arcmin", "um")
        prior, high = (3e-4, 2e-2) if self.places.dimension == "angle" else (2e-5, 2e-3)
        return (EffectParameter("gap", unit, prior, 0.0, high),)

    def shapes(self, at: Situation) -> np.ndarray:
        direction = at.directions()
        return 0.5 * np.where(direction != 0, -direction, np.sign(at.torque))[None]


EFFECT = Backlash
