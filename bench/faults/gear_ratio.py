"""A gear, belt or screw moves a little more, or less, than the controller assumes."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.settings import Setting


class GearRatio(Fault):
    """The shaft goes to (1 + g)·q. An error above 0.1 % is more likely a wrong unit than a wrong gear."""

    MJCF = "the target of motor joint `q1`"
    SETTINGS = (Setting("error", "ratio", low=-0.1, high=0.1, typical=2e-4, per="actuator", about="g of each drive"),)
    STAGE = 1

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        return theta * (1 + self.values["error"])


FAULT = GearRatio
