"""The rods grow with temperature."""

from __future__ import annotations

import numpy as np

from bench.faults._growth import Growth, expansion
from pcalib.robot import Robot


class ThermalRods(Growth):
    """Every rod (a leg: with its screw) grows along itself by α·(T − 20 °C). Carbon has 0–2 ppm/K, steel 12."""

    PART = "rods"
    NEEDS = ("temp_rods",)
    MJCF = "positions of bodies `tip11` …"
    SETTINGS = expansion(2e-06)

    def dimensions(self, robot: Robot) -> np.ndarray:
        return np.concatenate([robot.mechanism.rod_lengths, robot.mechanism.leg_scales])


FAULT = ThermalRods
