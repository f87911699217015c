"""The encoders have few bits: each drive stops at the step that is nearest to its command."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.settings import Setting


class EncoderSteps(Fault):
    """The shaft goes to the whole multiple of a step that is nearest to the command.

    The error repeats exactly, so that replicates do not show it. An encoder of fifteen bits has steps of 192 µrad.
    """

    MJCF = "the target of motor joint `q1`"
    SETTINGS = (Setting("step", "drive", low=0.0, high=0.05, typical=2 * np.pi / 2**15, about="the step"),)

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        return np.round(theta / self.values["step"]) * self.values["step"]


FAULT = EncoderSteps
