"""Distances from the measured point to stations: ballbar, draw wire, interferometer."""

from __future__ import annotations

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
        """The place of the station, and where `distance_offset` is unknown the error of the bar's length."""
        out = (Block(f"station {to}", ("x", "y", "z"), ("m",) * 3, np.full(3, _ANYWHERE)),)
        if options.get("distance_offset") == "unknown":
            out += (Block("bar", ("offset",), ("m",), np.array([_LENGTH])),)
        return out

    def start(self, scene: Scene, value: np.ndarray, to: str, options: Options) -> tuple[np.ndarray, ...]:
        """The place from which the distances fit best, sought near the stated one or from those of :func:`_places`."""
        x, d = scene.x, value[:, 0]

        def miss(place: np.ndarray) -> np.ndarray:
            return np.linalg.norm(x - place, axis=1) - d

        stated = next((p for k, p in options.items() if re.fullmatch(rf"station_{re.escape(to)}_\w+", k)), None)
        if isinstance(stated, np.ndarray):
            place = best(lambda p: np.r_[miss(p), (p - stated) / _STATED * np.std(miss(stated))], [stated])
        else:
            place = best(miss, _places(x, d), lambda p: (p - x) / np.linalg.norm(x - p, axis=1)[:, None])
        return (place, np.zeros(1))[: len(self.blocks(to, options))]

    def see(self, scene: Scene, theta: Sequence[np.ndarray]) -> Seen:
        """Distances at the poses; their derivatives by the points are the unit vectors from the station to them."""
        away = scene.x - theta[0]
        d = np.linalg.norm(away, axis=1)
        u = (away / np.maximum(d, 1e-12)[:, None])[:, None, :]
        ones = [np.ones((len(d), 1, 1))] * (len(theta) - 1)
        offset = theta[1][0] if len(theta) > 1 else 0.0
        return Seen((d + offset)[:, None], np.concatenate([u, 0 * u], axis=-1), np.concatenate([-u, *ones], axis=-1))


def _places(x: np.ndarray, d: np.ndarray) -> list[np.ndarray]:
    """Places (3,) from which points x (n, 3) are about d (n,) away.

    |y|² − d² = 2 y·c − |c|² is linear in the place c, with y the points about their middle. Where all points lie near a
    plane, it hardly shows on which side of it c is: its height then follows from |c|², and both sides are places.
    """
    y = x - x.mean(axis=0)
    axes = np.linalg.svd(y)[2]
    known = np.sum(y**2, axis=1) - d**2

    def solved(along: np.ndarray) -> tuple[np.ndarray, float]:
        c, minus = np.split(np.linalg.lstsq(np.column_stack([2 * y @ along.T, np.ones(len(y))]), known)[0], [-1])
        return c @ along, float(-minus[0])

    (whole, _), (flat, square) = solved(axes), solved(axes[:2])
    height = np.sqrt(max(square - flat @ flat, 1e-12)) * axes[2]
    return [x.mean(axis=0) + c for c in (whole, flat + height, flat - height)]


SENSOR = Distance()
