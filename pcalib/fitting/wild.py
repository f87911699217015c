"""Readings of sensors that are far off where most are near: a lost decimal point, or two rows that changed places.

The set-up of a sensor is found from its readings, and a single wild one spoils that. So it is found from small groups
of them too, and the group counts whose set-up agrees best with half of all readings (least median of squares, Rousseeuw
1984).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcalib import prediction
from pcalib.data.measurement import Measurements
from pcalib.model import Conditions, Model
from pcalib.robot import Robot
from pcalib.sensors.base import Options, Scene, Sensor

LARGE = {"length": 5e-3, "angle": np.radians(3.0)}
"""[m, rad] Differences from the robot as drawn below which no reading is wild."""
TIMES = 8.0
"""Times the median difference above which a reading is wild."""
GROUPS = 12
"""Groups of readings that are tried: if one reading in ten is wild, a group of eight has none in 43 % of cases, and
among twelve there is none without in one case of a thousand."""
ROWS = 100
"""Readings of one sensor and station that a set-up is found from."""
LOOKED_AT = 2000
"""Readings of one sensor and station that are looked at, evenly spaced."""
MOST = 0.2
"""Share of readings beyond which the others cannot say that they are wild."""


@dataclass(frozen=True)
class Wild:
    """Readings of one sensor that are far off where most are near."""

    rows: np.ndarray
    """Rows of the data."""
    what: str
    """What they are: 'distances to stations (A)'."""
    dimension: str
    """'length' or 'angle'."""
    limit: float
    """[m, rad] difference from the robot as drawn above which a reading counts as wild, and"""
    typical: float
    """the median of all."""


def wild(data: Measurements, robot: Robot) -> tuple[Wild, ...]:
    """What sensors read that is far from the robot as drawn, where most of the same sensor is near."""
    if data.readings is None:
        return ()
    model = Model.nominal(robot)
    out = []
    for sensor, to, rows in data.readings.parts:
        if sensor.between:
            continue  # a difference of two poses has no set-up that could be spoilt
        rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), LOOKED_AT)).astype(int)]
        some = data.take(rows)
        p = prediction.predict(model, some.q, Conditions(some.tool, some.payload, some.columns))
        ok = p.status == "ok"
        x, R = prediction.in_base(p)
        size = float(np.linalg.norm(robot.gravity))
        up = -robot.gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
        value = data.readings.value[rows][:, [place for place, _ in sensor.quantities.values()]]
        dimension = next(iter(sensor.quantities.values()))[1]
        off = _off(sensor, to, data.readings.options, Scene(x[ok], R[ok], up), value[ok], LARGE[dimension])
        if off is None:
            continue
        typical = float(np.median(off))
        limit = max(TIMES * typical, LARGE[dimension])
        far = off > limit
        if typical < LARGE[dimension] and 0 < far.mean() < MOST:
            where = f"{sensor.title} ({to})" if to else sensor.title
            out.append(Wild(rows[ok][far], where, dimension, limit, typical))
    return tuple(out)


def _off(sensor: Sensor, to: str, options: Options, scene: Scene, value: np.ndarray, large: float) -> np.ndarray | None:
    """(n,) differences of readings (n, s) from what they should be with the set-up that suits half of them best; None
    where they are too few to say.

    Args:
        large: difference below which none is wild.
    """
    unknowns = sum(len(block.parameters) for block in sensor.blocks(to, options))
    n, enough = len(value), max(8, 2 * unknowns)
    if n < 2 * enough:
        return None

    def differences(group: np.ndarray) -> np.ndarray:
        theta = sensor.start(_part(scene, group), value[group], to, options)
        seen = sensor.see(scene, theta).value
        return np.nanmax(np.abs(value - seen), axis=1, initial=0.0, where=~np.isnan(value))

    every = np.linspace(0, n - 1, min(n, ROWS)).astype(int)
    best = differences(every)
    if best.max() <= large:
        return best
    rng = np.random.default_rng(0)
    for _ in range(GROUPS):
        off = differences(rng.choice(n, enough, replace=False))
        if np.median(off) < np.median(best):
            best = off
    near = np.flatnonzero(best <= max(TIMES * float(np.median(best)), 1e-12))
    again = differences(near[np.linspace(0, len(near) - 1, min(len(near), ROWS)).astype(int)])
    return again if np.median(again) < np.median(best) else best


def _part(scene: Scene, rows: np.ndarray) -> Scene:
    return replace(scene, x=scene.x[rows], R=scene.R[rows])
