"""A base, or a tracker, that creeps during the measurement."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import Contribution, EffectParameter, Situation
from pcalib.effects.library import LibraryEffect

HOUR = 3600.0
"""[s]"""


class BaseDrift(LibraryEffect):
    """x → exp(ω·t)·x + v·t, R → exp(ω·t)·R with constant rates v [m/s], ω [rad/s], t from the first row.

    A tracker that creeps gives the same readings. Tenths of a millimetre in two hours of warm-up are usual; more than
    1 mm or 2 mrad an hour is not plausible of a frame that stands.
    """

    title = "the base or the tracker creeps with time"
    variants = ("common",)
    channels = ("base",)
    wants = ("time",)

    needs = ("time",)

    quantities = tuple(
        EffectParameter(f"{what}{axis}", unit, 1e-4 / HOUR, -most / HOUR, most / HOUR, (-usual / HOUR, usual / HOUR))
        for what, unit, most, usual in (("v", "um_h", 0.01, 1e-3), ("w", "urad_h", 0.02, 2e-3))
        for axis in "xyz"
    )

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        return Contribution(base=at.column("time")[:, None] * np.asarray(theta, float))


EFFECT = BaseDrift
