"""A measuring instrument with a scale error."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import Contribution, EffectParameter, Situation
from pcalib.effects.library import LibraryEffect


class TrackerScale(LibraryEffect):
    """x_measured = (1 + κ)·x with κ dimensionless, x in the measuring frame; about 10 ppm,
    and 300 for a camera that was calibrated with a scale bar.

    A robot that is larger by the same ratio gives the same readings; only a length standard tells the two apart.
    """

    title = "the instrument's scale is off"
    variants = ("common",)
    channels = ("sensor",)
    wants = ("a scale bar, its ends measured as two tools: no pose can show it",)

    quantities = (EffectParameter("scale_error", "ppm", 1e-5, -1e-3, 1e-3, plausible=(-3e-4, 3e-4)),)

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        return Contribution(sensor=theta[0] * at.measured_point)


EFFECT = TrackerScale
