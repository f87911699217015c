"""Play in the rods' ball joints, taken up by the sign of the rod force."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect


class JointClearance(PlacedEffect):
    """l_r → l_r + (c/2)·sign T_r [m], c > 0 the whole gap; 4–12 µm, in worn plastic joints 200.

    It is constant, and so invisible, where no rod force changes sign.
    """

    title = "play in the rod joints"
    variants = ("common", "arm", "rod")
    channels = ("rod",)
    wants = ("poses at which rod forces change sign",)

    quantities = (EffectParameter("gap", "um", 1e-5, 0.0, 1e-3, plausible=(0.0, 2e-4)),)

    def shapes(self, at: Situation) -> np.ndarray:
        return 0.5 * np.sign(at.tension)[None]


EFFECT = JointClearance
