"""The zeros of the encoders move with temperature."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.settings import Setting


class EncoderWarming(Fault):
    """Every drive is off by κ·(T − 20 °C), where T is the temperature of the base, on which the motors sit.

    Typical κ: 1–10 µrad/K.
    """

    MJCF = "the target of motor joint `q1`"
    SETTINGS = (
        Setting(
            "per_kelvin", "drive_per_kelvin", low=-1e-3, high=1e-3,
            typical=5e-6, per="actuator", about="κ of each drive",
        ),
    )
    NEEDS = ("temp_base",)

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        return theta + self.values["per_kelvin"] * row.warming("base")


FAULT = EncoderWarming
