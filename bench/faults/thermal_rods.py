"""Rods that grow with temperature."""

from __future__ import annotations

import numpy as np

from bench.faults._growth import Growth, expansion
from pcalib.mechanics.mechanism import Mechanism


class ThermalRods(Growth):
    """Every rod grows along itself by α·(T − 20 °C), legs with their screws. Carbon 0–2 ppm/K, steel 12."""

    PART = "rods"
    NEEDS = ("temp_rods",)
    MJCF = "positions of bodies `tip11` …"
    SETTINGS = expansion(2e-06)

    def dimensions(self, mechanism: Mechanism) -> np.ndarray:
        return np.concatenate([mechanism.rod_lengths, mechanism.leg_scales])


FAULT = ThermalRods
