"""Single components of the plate's rotation vector, where the others are not measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from pcalib import rotation
from pcalib.sensors.base import Scene, Seen, Sensor


class RotationComponent(Sensor):
    """θ = log R, plate → base; a turn ω of the plate moves it by J(θ)⁻¹·ω with the left Jacobian J."""

    name: ClassVar[str] = "rotation_component"
    title: ClassVar[str] = "single components of the rotation"
    quantities: ClassVar = {"rx": (3, "angle"), "ry": (4, "angle"), "rz": (5, "angle")}
    sigma: ClassVar[str] = "sigma_rot"
    usual_sigma: ClassVar[float] = 60e-6
    partial: ClassVar[bool] = True

    def see(self, scene: Scene, theta: Sequence[np.ndarray]) -> Seen:
        """See the class."""
        vector = rotation.log(scene.R)
        turn = np.linalg.inv(rotation.left_jacobian(vector))
        return Seen(vector, np.concatenate([0 * turn, turn], axis=-1), np.zeros((len(vector), 3, 0)))


SENSOR = RotationComponent()
