"""The instrument creeps on its stand, so that what stands still seems to creep the other way."""

from __future__ import annotations

import numpy as np

from bench.commands import Commands
from bench.faults import Fault
from pcalib import rotation
from pcalib.settings import Setting


class TrackerDrift(Fault):
    """The instrument moves at constant rates in its own axes: x → exp(−ω·t)·(x − v·t), with t from the first row.

    Tenths of a millimetre in two hours are usual. The data are those of a base that drifts the other way.
    """

    MJCF = "nothing: it is the instrument's"
    SETTINGS = (
        Setting(
            "v", "velocity", np.zeros(3), -1e-5, 1e-5,
            typical=(1.5e-8, -1e-8, 2e-8), count=3, about="velocity of the instrument's origin",
        ),
        Setting(
            "w", "angular_velocity", np.zeros(3), -1e-5, 1e-5,
            typical=(1e-8, 2e-8, -1e-8), count=3, about="rate of turn",
        ),
    )
    SIZES = ("v", "w")
    NEEDS = ("time",)

    def seen(self, position: np.ndarray, R: np.ndarray, commands: Commands) -> tuple[np.ndarray, np.ndarray]:
        time = commands.columns["time"][:, None]
        back = np.swapaxes(rotation.exp(time * self.values["w"]), 1, 2)
        return (back @ (position - time * self.values["v"])[:, :, None])[:, :, 0], back @ R


FAULT = TrackerDrift
