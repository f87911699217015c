"""The zero of a motor slips once: a belt jumps a tooth, or a coupling turns on its shaft."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.faults._dated import ROW
from pcalib.settings import Setting


class MotorSlip(Fault):
    """Before a row the shafts move away from what their encoders read, and stay there. Typical: 100–1000 µrad."""

    MJCF = "the target of motor joint `q1`"
    SETTINGS = (Setting("slip", "drive", low=-0.05, high=0.05, typical=1.6e-4, per="actuator", about="how far"), ROW)
    STAGE = 1

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        return theta + self.values["slip"] if row.index >= self.values["row"] - 1 else theta


FAULT = MotorSlip
