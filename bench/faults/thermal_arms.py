"""The arms grow with temperature."""

from __future__ import annotations

import numpy as np

from bench.faults._growth import Growth, expansion
from pcalib.robot import Robot


class ThermalArms(Growth):
    """The arms grow from their motor axes: every elbow point moves out by α·(T − 20 °C). Aluminium has 23.6 ppm/K."""

    PART = "arms"
    ROTARY = True
    NEEDS = ("temp_arms",)
    MJCF = "positions of the rod bodies in the arms"
    SETTINGS = expansion(2.36e-05)

    def dimensions(self, robot: Robot) -> np.ndarray:
        return robot.mechanism.arm_joints


FAULT = ThermalArms
