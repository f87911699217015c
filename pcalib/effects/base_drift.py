"""A base, or a tracker, that creeps during the measurement."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from pcalib.effects.base import Contribution, EffectParameter, Situation
from pcalib.effects.library import LibraryEffect


class BaseDrift(LibraryEffect):
    """x → exp(ω·t)·x + v·t, R → exp(ω·t)·R with constant rates v [m/s], ω [rad/s], t from the first row.

    A creeping tracker is an exact alias. Tenths of a millimetre in two hours of warm-up are usual.
    """

    title: ClassVar[str] = "the base or the tracker creeps with time"
    variants: ClassVar[tuple[str, ...]] = ("common",)
    channels: ClassVar[tuple[str, ...]] = ("base",)
    wants: ClassVar[tuple[str, ...]] = ("time",)

    @property
    def needs(self) -> tuple[str, ...]:
        return ("time",)

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        v = tuple(EffectParameter(f"v{a}", "um_h", 1e-4 / 3600, -0.01 / 3600, 0.01 / 3600) for a in "xyz")
        w = tuple(EffectParameter(f"w{a}", "urad_h", 1e-4 / 3600, -0.02 / 3600, 0.02 / 3600) for a in "xyz")
        return v + w

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        return Contribution(base=at.column("time")[:, None] * np.asarray(theta, float))


EFFECT = BaseDrift
