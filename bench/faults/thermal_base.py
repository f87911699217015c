"""The base grows with temperature."""

from __future__ import annotations

import numpy as np

from bench.faults._growth import Growth, expansion
from pcalib.robot import Robot


class ThermalBase(Growth):
    """The base grows from its centre by α·(T − 20 °C), with the motors. Steel has 12 ppm/K, aluminium 23.6."""

    PART = "base"
    NEEDS = ("temp_base",)
    MJCF = "positions of the arm (tower, foot) bodies in the base"
    SETTINGS = expansion(1.2e-05)

    def dimensions(self, robot: Robot) -> np.ndarray:
        return robot.mechanism.base_points


FAULT = ThermalBase
