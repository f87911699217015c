"""A gear wheel that runs out: an error that comes many times per turn of the arm."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.settings import Setting


class GearRipple(Fault):
    """A pinion turns n times per turn of the arm and is mounted off its centre: the mesh runs ahead and behind.

    The encoder on the pinion's shaft knows nothing of it: the arm stands at q + A·sin(n·q + φ). Up to 6 arcmin.
    """

    MJCF = "the target of motor joint `q1`"
    SETTINGS = (
        Setting("amplitude", "angle", low=0.0, high=0.05, typical=3e-4, per="actuator", about="A, the largest error"),
        Setting("cycles", "count", 24.0, 1.0, 10000.0, about="n"),
        Setting("phase", "angle", 0.0, per="actuator", about="φ"),
    )
    ROTARY = True
    STAGE = 1

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        return theta + self.values["amplitude"] * np.sin(self.values["cycles"] * theta + self.values["phase"])


FAULT = GearRipple
