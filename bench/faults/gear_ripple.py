"""A gear wheel runs out, which gives an error many times per turn of the arm."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.settings import Setting


class GearRipple(Fault):
    """A pinion turns n times per turn of the arm and is mounted off its centre, so that the mesh runs ahead and behind.

    The encoder on the shaft of the pinion does not see this error: the arm stands at q + A·sin(n·q + φ). A is 6 arcmin
    at most.
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
