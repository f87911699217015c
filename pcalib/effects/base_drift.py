"""A base, or a tracker, that creeps during the measurement."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import Contribution, EffectParameter, Situation
from pcalib.effects.library import LibraryEffect


class BaseDrift(LibraryEffect):
    """x → exp(ω·t)·x + v·t, R → exp(ω·t)·R with constant rates v [m/s], ω [rad/s], t from the first row.

    A tracker that creeps gives the same readings. Tenths of a millimetre in two hours of warm-up are usual.
    """

    title = "the base or the tracker creeps with time"
    variants = ("common",)
    channels = ("base",)
    wants = ("time",)

    needs = ("time",)

    quantities = (
        *(EffectParameter(f"v{a}", "um_h", 1e-4 / 3600, -0.01 / 3600, 0.01 / 3600) for a in "xyz"),
        *(EffectParameter(f"w{a}", "urad_h", 1e-4 / 3600, -0.02 / 3600, 0.02 / 3600) for a in "xyz"),
    )

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        return Contribution(base=at.column("time")[:, None] * np.asarray(theta, float))


EFFECT = BaseDrift
