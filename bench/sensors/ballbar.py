"""A telescoping ballbar between the tool and one of several balls, each row another."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bench.sensors import Read, Sensor
from pcalib.settings import ANY, Setting


class Ballbar(Sensor):
    """The distance between the centres of two balls; none where the bar is too long or too short for it."""

    SETTINGS: ClassVar = (
        Setting("sigma", "length", 2e-6, 0.0, 0.1, about="1σ"),
        Setting("stations", "length", None, count=ANY, about="places of the balls, x y z each, base frame"),
        Setting("shortest", "length", 0.0, 0.0, 10.0, about="below which the bar cannot be pushed together"),
        Setting("longest", "length", 10.0, 0.0, 10.0, about="above which it cannot be pulled apart"),
        Setting("offset", "length", 0.0, about="by which its length is longer than it reads"),
    )

    def read(self, tcp: np.ndarray, R: np.ndarray, rows: np.ndarray, seed: int) -> Read:
        v = self.values
        balls = np.reshape(v["stations"], (-1, 3))
        which = rows % len(balls)
        true = np.sqrt(((tcp - balls[which]) ** 2).sum(axis=1))
        length = np.where((true >= v["shortest"]) & (true <= v["longest"]), true, np.nan)
        value = np.full((len(tcp), 6), np.nan)
        value[:, 0] = length - v["offset"] + v["sigma"] * self.noise(seed, rows, 1)[:, 0]
        to = np.array([chr(ord("A") + i % 26) * (1 + i // 26) for i in which], object)
        return Read("distance", to, value, v["sigma"], {"distance_offset": "unknown"} if v["offset"] else {})


SENSOR = Ballbar
