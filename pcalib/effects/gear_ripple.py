"""Gears whose transmission error repeats many times per turn of the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, amplitude, harmonics, unsuited_without_angles
from pcalib.mechanics.mechanism import Mechanism

SCANNED = tuple(range(8, 121))
"""Cycles per turn that are tried where the robot file names none."""


@dataclass(frozen=True)
class GearRipple(PlacedEffect):
    """δq_i = Σ_n A_n·sin nq_i + B_n·cos nq_i [rad], n cycles per turn of the motor axis; up to 6 arcmin.

    n comes from `[drive] ripple_per_turn` of the robot file, or is scanned with all that was looked at counted.
    """

    cycles: tuple[int, ...] = (24,)

    title = "gears ripple"
    channels = ("actuator",)
    wants = ("a fine sweep of motor angles", "ripple_per_turn in the robot file")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "spec", f"{self.spec}@{'+'.join(map(str, self.cycles))}")

    def numbers(self) -> tuple[EffectParameter, ...]:
        return tuple(
            EffectParameter(f"{part}{n}", "arcsec", 2e-4, -1e-2, 1e-2)
            for n in self.cycles
            for part in ("sine", "cosine")
        )

    def unsuited(self, mechanism: Mechanism) -> str:
        return unsuited_without_angles(mechanism)

    def shapes(self, at: Situation) -> np.ndarray:
        return harmonics(at.q, self.cycles)

    def describe(self, theta: np.ndarray) -> str:
        pairs = np.reshape(theta, (len(self.cycles), 2, -1))
        members = self.places.members(self.per)
        return "; ".join(
            f"{n} per turn: amplitude {amplitude(pair, members, 'arcsec')}"
            for n, pair in zip(self.cycles, pairs, strict=True)
        )


EFFECT = GearRipple
