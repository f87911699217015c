"""The robot is mounted out of level, so that gravity does not point along the base's −z."""

from __future__ import annotations

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.rig import Rig
from pcalib import rotation
from pcalib.settings import Setting


class GravityTilt(Fault):
    """Gravity is turned by the rotation vector (x, y, 0), typically 1–10 mrad. It does not move a rigid robot."""

    MJCF = "`option/gravity`"
    SETTINGS = (
        Setting("x", "angle", 0.0, -0.5, 0.5, typical=5e-3, about="about the base's x axis"),
        Setting("y", "angle", 0.0, -0.5, 0.5, typical=-3e-3, about="about the base's y axis"),
    )
    SIZES = ("x", "y")
    loaded = True

    def prepare(self, rig: Rig, row: Row) -> None:
        turn = rotation.exp(np.array([self.values["x"], self.values["y"], 0.0]))
        rig.model.opt.gravity = turn @ rig.model.opt.gravity


FAULT = GravityTilt
