"""Sensors, one file each: what they read, what their set-up leaves unknown, and how readings follow from a pose."""

from __future__ import annotations

from functools import cache

from pcalib.registry import Registry
from pcalib.sensors.base import Sensor

_SENSORS: Registry[Sensor] = Registry("pcalib.sensors", "SENSOR", "sensor", helpers=("base",))


@cache
def every() -> tuple[Sensor, ...]:
    """All sensors, in the order of their names."""
    return tuple(_SENSORS.get(name) for name in _SENSORS.names())


def get(name: str) -> Sensor:
    """The sensor of that name."""
    return _SENSORS.get(name)
