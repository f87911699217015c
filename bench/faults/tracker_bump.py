"""The instrument is bumped once, and everything that it measures afterwards seems to have moved."""

from __future__ import annotations

import numpy as np

from bench.commands import Commands
from bench.faults import Fault
from bench.faults._dated import ROW
from pcalib import rotation
from pcalib.settings import Setting


class TrackerBump(Fault):
    """Before a row the instrument moves by v and turns by ω, in its own axes: x → exp(−ω)·(x − v) from there on.

    A knock at a tripod: 20–200 µm and µrad.
    """

    MJCF = "nothing: it is the instrument's"
    SETTINGS = (
        Setting(
            "shift", "length", np.zeros(3), -0.01, 0.01,
            typical=(3e-5, -2e-5, 3e-5), count=3, about="v, how far its origin moves",
        ),
        Setting(
            "turn", "angle", np.zeros(3), -0.01, 0.01,
            typical=(3e-5, 2e-5, -3e-5), count=3, about="ω, by what rotation vector it turns",
        ),
        ROW,
    )  # fmt: skip
    SIZES = ("shift", "turn")

    def seen(self, position: np.ndarray, R: np.ndarray, commands: Commands) -> tuple[np.ndarray, np.ndarray]:
        after = commands.index >= self.values["row"] - 1
        back = rotation.exp(-self.values["turn"])
        moved = (position - self.values["shift"]) @ back.T
        return np.where(after[:, None], moved, position), np.where(after[:, None, None], back @ R, R)


FAULT = TrackerBump
