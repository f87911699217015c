"""Play in the drives: the arm hangs back behind its motor."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect


class Backlash(PlacedEffect):
    """δq_i = −(b/2)·dir_i [rad or m], b > 0 the whole gap: the arm lags behind its last motion.

    Where the direction is absent or 0, the load chooses the side: δq_i = (b/2)·sign τ_i. Gears have 1–3 arcmin,
    worn ones up to 15; belts and screws some 20 µm, worn ones up to 0.5 mm.
    """

    title = "play in the drives"
    channels = ("actuator",)
    wants = ("direction of motion",)

    quantities = (EffectParameter("gap", "arcmin", 3e-4, 0.0, 2e-2, plausible=(0.0, 4.4e-3)),)
    sliding = (EffectParameter("gap", "um", 2e-5, 0.0, 2e-3, plausible=(0.0, 5e-4)),)

    def shapes(self, at: Situation) -> np.ndarray:
        direction = at.directions()
        return 0.5 * np.where(direction != 0, -direction, np.sign(at.torque))[None]


EFFECT = Backlash
