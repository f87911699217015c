"""Gears whose transmission error repeats many times per turn of the arm."""

from __future__ import annotations

from dataclasses import dataclass

from pcalib.effects.base import EffectParameter
from pcalib.effects.library import Harmonic

SCANNED = tuple(range(8, 121))
"""Cycles per turn that are tried where the robot file names none."""


@dataclass(frozen=True)
class GearRipple(Harmonic):
    """δq_i = Σ_n A_n·sin nq_i + B_n·cos nq_i [rad], n cycles per turn of the motor axis.

    Strain-wave gears have 0.5–1.5 arcmin; more than 3 (1e-3 rad) is not plausible.

    n is `[drive] ripple_per_turn` of the robot file; without it, a diagnosis scans n and corrects p for the scan.
    """

    cycles: tuple[int, ...] = (24,)

    title = "gears ripple"
    wants = ("a fine sweep of motor angles", "ripple_per_turn in the robot file")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "spec", f"{self.spec}@{'+'.join(map(str, self.cycles))}")

    def numbers(self) -> tuple[EffectParameter, ...]:
        return tuple(
            EffectParameter(f"{part}{n}", "arcsec", 2e-4, -1e-2, 1e-2, plausible=(-1e-3, 1e-3))
            for n in self.cycles
            for part in ("sine", "cosine")
        )

    def prefix(self, n: int) -> str:
        return f"{n} per turn: "


EFFECT = GearRipple
