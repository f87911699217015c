"""Rods that grow with temperature."""

from __future__ import annotations

from bench.faults._growth import Growth, expansion


class ThermalRods(Growth):
    """Every rod grows along itself by α·(T − 20 °C), legs with their screws. Carbon 0–2 ppm/K, steel 12."""

    LETTER, PART, LEGS = "l", "rods", "s"
    NEEDS = ("temp_rods",)
    MJCF = "positions of bodies `tip11` …"
    SETTINGS = expansion(2e-06)


FAULT = ThermalRods
