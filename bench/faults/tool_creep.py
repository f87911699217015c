"""The mount of the tool settles: the tool leans more and more, fast at first."""

from __future__ import annotations

import math

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib import rotation
from pcalib.settings import Setting


class ToolCreep(Fault):
    """The tool turns about its mount by ρ·log10(1 + t/τ), with t from the first row. Typical |ρ|: 50–500 µrad."""

    MJCF = "the tool vector in the frame of body `tool`"
    SETTINGS = (
        Setting(
            "turn", "angle", low=-0.1, high=0.1,
            typical=(2e-4, 1e-4, 0.0), count=3, about="ρ, rotation vector per decade of time",
        ),
        Setting("onset", "time", 60.0, 1e-3, 1e6, about="τ"),
    )
    NEEDS = ("time",)

    def mount(self, tcp: np.ndarray, row: Row) -> np.ndarray:
        decades = math.log10(1 + max(row.time, 0.0) / self.values["onset"])
        return rotation.exp(self.values["turn"] * decades) @ tcp


FAULT = ToolCreep
