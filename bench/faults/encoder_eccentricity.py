"""The encoder discs sit off the centres of their shafts, which gives an error once per turn."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.faults._encoder import invert
from pcalib.settings import Setting


class EncoderEccentricity(Fault):
    """The centre of a disc of radius r is ε·r away from that of its shaft.

    Seen from the reading head, the disc's centre stands at the angle atan2(−ε·sin(s + φ), 1 − ε·cos(s + φ)) when the
    shaft stands at s. The encoder therefore reads s + atan2(ε·sin(s + φ), 1 − ε·cos(s + φ)), and the controller turns
    the shaft until this reading is the command. An offset of 10 µm on a disc of 50 mm diameter is ε = 400 µrad.
    """

    MJCF = "the target of motor joint `q1`"
    SETTINGS = (
        Setting("amplitude", "angle", low=0.0, high=0.1, typical=4e-4, per="actuator", about="ε, the largest error"),
        Setting("phase", "angle", 0.0, typical=0.7, per="actuator", about="φ, where the centre stands at zero"),
    )
    ROTARY = True

    def reading(self, shaft: np.ndarray) -> np.ndarray:
        """Return what the encoders read when the shafts stand at `shaft` (nq,) [rad]."""
        turn, e = shaft + self.values["phase"], self.values["amplitude"]
        return shaft + np.arctan2(e * np.sin(turn), 1 - e * np.cos(turn))

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        return invert(self.reading, theta)


FAULT = EncoderEccentricity
