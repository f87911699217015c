"""The encoder discs sit at a tilt on their shafts, which gives an error twice per turn."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.faults._encoder import invert
from pcalib.settings import Setting


class EncoderOvality(Fault):
    """A disc that is tilted by β is read as if it were stretched by κ = 1/cos β across the axis of its tilt.

    The encoder reads atan2(κ·sin(s + φ), cos(s + φ)) − φ when the shaft stands at s. The amplitude of its error is
    A = (κ − 1)/(κ + 1) = tan²(β/2). Typical A: 50–500 µrad.
    """

    MJCF = "the target of motor joint `q1`"
    SETTINGS = (
        Setting("amplitude", "angle", low=0.0, high=0.1, typical=2e-4, per="actuator", about="A, the largest error"),
        Setting("phase", "angle", 0.0, typical=0.3, per="actuator", about="φ, where the axis of tilt stands at zero"),
    )
    ROTARY = True

    def reading(self, shaft: np.ndarray) -> np.ndarray:
        """Return what the encoders read when the shafts stand at `shaft` (nq,) [rad]."""
        A, turn = self.values["amplitude"], shaft + self.values["phase"]
        stretch = (1 + A) / (1 - A)
        # The angle between (cos, sin) and (cos, κ·sin), which needs no unwinding.
        return shaft + np.arctan2((stretch - 1) * np.sin(turn) * np.cos(turn), 1 + (stretch - 1) * np.sin(turn) ** 2)

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        return invert(self.reading, theta)


FAULT = EncoderOvality
