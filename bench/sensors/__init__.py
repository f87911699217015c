"""Sensors of the virtual robot that read no pose: one file each, with formulas of its own.

A file of this folder that defines ``SENSOR``, a subclass of :class:`Sensor`, is a sensor; its name is the file's, and
``[sensors.NAME]`` in a truth file sets it up. Files that start with `_` are none.
"""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bench.noises import generator
from pcalib import settings
from pcalib.registry import Registry
from pcalib.settings import Setting


@dataclass(frozen=True)
class Read:
    """What a sensor wrote down for N rows of a plan."""

    name: str
    """How the measurement file calls the sensor."""
    to: np.ndarray
    """(N,) str, station or surface; '' where there is but one."""
    value: np.ndarray
    """(N, 6) [m, rad] in the places of the file's columns, lengths first; NaN where nothing was read."""
    sigma: float
    """[m or rad] 1σ as its maker states it."""
    metadata: Mapping[str, str]
    """Lines of the file's metadata that it needs."""


class Sensor(ABC):
    """A sensor with given settings (SI)."""

    SETTINGS: ClassVar[tuple[Setting, ...]]
    name: str

    def __init__(self, name: str, values: Mapping[str, Any]):
        self.name, self.values = name, values

    @abstractmethod
    def read(self, tcp: np.ndarray, R: np.ndarray, rows: np.ndarray, seed: int) -> Read:
        """Measure N poses.

        Args:
            tcp: (N, 3) [m] measured points and R (N, 3, 3) plate → base, base frame.
            rows: (N,) numbers of the rows in the plan; what each draws depends on seed and number alone.
        """

    def noise(self, seed: int, rows: np.ndarray, count: int) -> np.ndarray:
        """Return (N, count) standard normal numbers, each row's own."""
        stream = zlib.crc32(self.name.encode())
        return np.stack([generator(seed, stream, int(row)).standard_normal(count) for row in rows])

    def to_table(self) -> dict[str, Any]:
        """Return the table that gives this sensor again."""
        return settings.write(self.values, self.SETTINGS)


_SENSORS: Registry[type[Sensor]] = Registry(__name__, "SENSOR", "sensor")


def make(name: str, table: Mapping[str, Any]) -> Sensor:
    """Return a sensor of a truth file.

    Raises:
        InputError: no such sensor, or a setting that it does not have or that is out of range.
    """
    kind = _SENSORS.get(name)
    return kind(name, settings.read(table, kind.SETTINGS, f"sensors.{name}"))


def names() -> Sequence[str]:
    """Return the sensors that there are."""
    return _SENSORS.names()
