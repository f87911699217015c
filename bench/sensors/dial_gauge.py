"""A dial gauge in the tool on a flat or a ball."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bench.sensors import Read, Sensor
from pcalib.settings import Setting


class DialGauge(Sensor):
    """The height of the tool point over a surface, beside its zero."""

    SETTINGS: ClassVar = (
        Setting("sigma", "length", 5e-6, 0.0, 0.1, about="1σ"),
        Setting("shape", "word", "plane", words=("plane", "sphere"), about="of the surface"),
        Setting("place", "length", np.array([0.0, 0.0, -0.9]), count=3, about="a point of the plane, or the centre"),
        Setting("slope", "number", np.zeros(2), count=2, about="rise of the plane per length, along x and y"),
        Setting("radius", "length", 0.02, 0.0, 10.0, about="of the sphere"),
        Setting("zero", "length", 0.0, about="reading on the surface"),
    )

    def read(self, tcp: np.ndarray, R: np.ndarray, rows: np.ndarray, seed: int) -> Read:
        v = self.values
        away = tcp - np.asarray(v["place"])
        if v["shape"] == "sphere":
            height = np.linalg.norm(away, axis=1) - v["radius"]
        else:
            a, b = v["slope"]
            height = (away[:, 2] - a * away[:, 0] - b * away[:, 1]) / np.sqrt(1 + a * a + b * b)
        value = np.full((len(tcp), 6), np.nan)
        value[:, 0] = height + v["zero"] + v["sigma"] * self.noise(seed, rows, 1)[:, 0]
        return Read("probe", np.full(len(tcp), "A", object), value, v["sigma"], {"surface_A": v["shape"]})


SENSOR = DialGauge
