"""Distances from the measured point to stations: ballbar, draw wire, interferometer."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from pcalib.sensors.base import Block, Options, Scene, Seen, Sensor, best, point

_UNITS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
_STATED = 5e-3
"""[m] Where a station's place is stated, it is measured with a ruler."""
_ANYWHERE = 10.0
"""[m] 1σ of a station's place where nothing is stated: anywhere in the room."""
_LENGTH = 1e-3
"""[m] 1σ of the error of a bar's length, where it is an unknown."""


class Distance(Sensor):
    """d = |x − station| + offset."""

    name: ClassVar[str] = "distance"
    title: ClassVar[str] = "distances to stations"
    instruments: ClassVar = ("ballbar", "draw-wire", "interferometer")
    quantities: ClassVar = {"distance": (0, "length")}
    sigma: ClassVar[str] = "sigma_distance"
    usual_sigma: ClassVar[float] = 5e-6
    to: ClassVar[str | None] = "station"

    def option(self, key: str, text: str) -> object | None:
        """`station_A_mm = x y z` says about where station A is; `distance_offset = unknown` frees the bar's length."""
        if key == "distance_offset":
            if text not in ("none", "unknown"):
                raise ValueError("none, unknown")
            return text
        place = re.fullmatch(r"station_(.+)_(um|mm|cm|m)", key)
        return point(text) * _UNITS[place.group(2)] if place else None

    def blocks(self, to: str, options: Options) -> tuple[Block, ...]:
        """The place of the station, and where it is asked for the error of the bar's length."""
        out = (Block(f"station {to}", ("x", "y", "z"), ("m",) * 3, np.full(3, _ANYWHERE)),)
        if options.get("distance_offset") == "unknown":
            out += (Block("bar", ("offset",), ("m",), np.array([_LENGTH])),)
        return out

    def start(self, scene: Scene, value: np.ndarray, to: str, options: Options) -> tuple[np.ndarray, ...]:
        """The place from which the distances fit best, sought from all sides, or near the stated one."""
        x, d = scene.x, value[:, 0]

        def miss(place: np.ndarray) -> np.ndarray:
            return np.linalg.norm(x - place, axis=1) - d

        stated = next((p for k, p in options.items() if re.fullmatch(rf"station_{re.escape(to)}_\w+", k)), None)
        if isinstance(stated, np.ndarray):
            place = best(lambda p: np.r_[miss(p), (p - stated) / _STATED * np.std(miss(stated))], [stated])[0][1]
        else:
            sides = np.array([s for s in itertools.product((-1, 0, 1), repeat=3) if any(s)], float)
            sides /= np.linalg.norm(sides, axis=1)[:, None]
            place = best(miss, list(x.mean(axis=0) + np.mean(d) * sides))[0][1]
        return (place, np.zeros(1))[: len(self.blocks(to, options))]

    def see(self, scene: Scene, theta: Sequence[np.ndarray]) -> Seen:
        """Derivatives are the unit vectors from the station to the point."""
        away = scene.x - theta[0]
        d = np.linalg.norm(away, axis=1)
        u = (away / np.maximum(d, 1e-12)[:, None])[:, None, :]
        ones = [np.ones((len(d), 1, 1))] * (len(theta) - 1)
        offset = theta[1][0] if len(theta) > 1 else 0.0
        return Seen((d + offset)[:, None], np.concatenate([u, 0 * u], axis=-1), np.concatenate([-u, *ones], axis=-1))


SENSOR = Distance()
