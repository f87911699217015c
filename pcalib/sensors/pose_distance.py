"""Distances between the measured points of two poses: length gauge, hole plate, scale bar."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from pcalib.sensors.base import Scene, Seen, Sensor


class PoseDistance(Sensor):
    """d = |x − x_from|, where the other pose is a row of the file, named by its pose_id."""

    name: ClassVar[str] = "pose_distance"
    title: ClassVar[str] = "distances between poses"
    quantities: ClassVar = {"distance": (0, "length")}
    sigma: ClassVar[str] = "sigma_distance"
    usual_sigma: ClassVar[float] = 5e-6
    to: ClassVar[str | None] = "from"
    between: ClassVar[bool] = True

    def see(self, scene: Scene, theta: Sequence[np.ndarray]) -> Seen:
        """Derivatives are the unit vectors between both points."""
        assert scene.origin is not None
        away = scene.x - scene.origin
        d = np.linalg.norm(away, axis=1)
        u = (away / np.maximum(d, 1e-12)[:, None])[:, None, :]
        by = np.concatenate([u, 0 * u], axis=-1)
        return Seen(d[:, None], by, np.zeros((len(d), 1, 0)), -by)


SENSOR = PoseDistance()
