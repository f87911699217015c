"""A two-axis electronic level on the plate: pendulums that swing in the planes of its axes."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bench.sensors import Read, Sensor
from pcalib import rotation
from pcalib.settings import Setting


class Inclinometer(Sensor):
    """Reads by how much each of its axes rises above the horizontal, where +z of the robot points up.

    Axis x rises when the plate turns back about y, axis y when it turns about x.
    """

    SETTINGS: ClassVar = (
        Setting("sigma", "angle", 20e-6, 0.0, 0.2, about="1σ of both axes"),
        Setting("zero", "angle", np.zeros(2), count=2, about="reading of each axis on a level table"),
        Setting("turn", "angle", 0.0, about="of its axes about the plate's normal"),
        Setting("level", "angle", np.zeros(2), count=2, about="turns of the base about x and y from the horizontal"),
    )

    def read(self, tcp: np.ndarray, R: np.ndarray, rows: np.ndarray, seed: int) -> Read:
        v = self.values
        level = rotation.exp(np.append(v["level"], 0.0))  # base → a frame whose z is against gravity
        c, s = np.cos(v["turn"]), np.sin(v["turn"])
        own = np.array([[c, s, 0.0], [-s, c, 0.0]])  # its axes, plate frame
        rise = np.arcsin(np.einsum("ij,njk,ak->nai", level, R, own)[..., 2])  # (N, 2)
        value = np.full((len(tcp), 6), np.nan)
        value[:, 3], value[:, 4] = rise[:, 1], -rise[:, 0]
        value[:, 3:5] += v["zero"] + v["sigma"] * self.noise(seed, rows, 2)
        return Read("inclinometer", np.full(len(tcp), "", object), value, v["sigma"], {})


SENSOR = Inclinometer
