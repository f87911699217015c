"""The base creeps, on its feet or on a floor that warms up."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.rig import Rig
from pcalib.settings import Setting


class BaseDrift(Fault):
    """The base body moves at constant rates: x → exp(ω·t)·x + v·t, with t counted from the first row.

    Tenths of a millimetre in two hours of warm-up are usual.
    """

    MJCF = "position and orientation of body `base`"
    SETTINGS = (
        Setting(
            "v", "velocity", np.zeros(3), -1e-5, 1e-5,
            typical=(1.5e-8, -1e-8, 2e-8), count=3, about="velocity of the base's origin",
        ),
        Setting(
            "w", "angular_velocity", np.zeros(3), -1e-5, 1e-5,
            typical=(1e-8, 2e-8, -1e-8), count=3, about="rate of turn",
        ),
    )
    SIZES = ("v", "w")
    NEEDS = ("time",)

    def prepare(self, rig: Rig, row: Row) -> None:
        rig.move_base(self.values["v"] * row.time, self.values["w"] * row.time)


FAULT = BaseDrift
