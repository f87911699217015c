"""Encoders whose zero moves with temperature."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.settings import Setting


class EncoderWarming(Fault):
    """The drive stands off by κ·(T − 20 °C), T the temperature of the base, which the motors sit on.

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
