"""The instrument measures every distance too long or too short: its wavelength, air or target is wrong."""

from __future__ import annotations

import numpy as np

from bench.commands import Commands
from bench.faults import Fault
from pcalib.settings import Setting


class TrackerScale(Fault):
    """All positions, from the instrument's own origin, are multiplied by 1 + s. Typical s: 10 ppm."""

    MJCF = "nothing: it is the instrument's"
    SETTINGS = (Setting("scale", "ratio", low=-0.1, high=0.1, typical=1e-5, about="s"),)
    STAGE = 1

    def seen(self, position: np.ndarray, R: np.ndarray, commands: Commands) -> tuple[np.ndarray, np.ndarray]:
        return position * (1 + self.values["scale"]), R


FAULT = TrackerScale
