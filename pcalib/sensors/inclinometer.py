"""A two-axis inclinometer on the plate: the turns of the plate about its own x and y against gravity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from pcalib import rotation
from pcalib.sensors.base import Block, Options, Scene, Seen, Sensor

_ZERO = 0.05
"""[rad] 1σ of the zero of each axis: how flat a block is screwed to a plate, and its own offset."""
_TURN = np.radians(5.0)
"""1σ of the turn of its axes about the plate's normal, by eye."""
_LEVEL = 0.01
"""[rad] 1σ per axis of the base against gravity, as a spirit level leaves it."""


class Inclinometer(Sensor):
    """With w the direction against gravity in the axes of the inclinometer, turned by γ about the plate's normal, and
    w₀ the same where the plate is parallel to the base: tilt_x = asin w_y − asin w₀_y + zero_x and
    tilt_y = −asin w_x + asin w₀_x + zero_y (both change sign where the robot's z points down).

    So the zero is what it reads on a plate that is parallel to the base. A zero on a level table would be hard to tell
    from the level of the base, and both would turn with γ: fits would have to follow a curved valley.
    """

    name: ClassVar[str] = "inclinometer"
    title: ClassVar[str] = "tilts of the plate against gravity"
    instruments: ClassVar = ("inclinometer",)
    quantities: ClassVar = {"tilt_x": (3, "angle"), "tilt_y": (4, "angle")}
    sigma: ClassVar[str] = "sigma_tilt"
    usual_sigma: ClassVar[float] = 50e-6

    def blocks(self, to: str, options: Options) -> tuple[Block, ...]:
        """Zero and turn of the inclinometer, and the level of the base."""
        return (
            Block("inclinometer", ("zero_x", "zero_y", "turn"), ("rad",) * 3, np.array([_ZERO, _ZERO, _TURN])),
            Block("level", ("x", "y"), ("rad",) * 2, np.full(2, _LEVEL)),
        )

    def start(self, scene: Scene, value: np.ndarray, to: str, options: Options) -> tuple[np.ndarray, ...]:
        """The mean difference as zero; axes along the plate's, and a base that is level."""
        predicted = self.see(scene, (np.zeros(3), np.zeros(2))).value
        return np.append(np.nan_to_num(np.nanmean(value - predicted, axis=0)), 0.0), np.zeros(2)

    def see(self, scene: Scene, theta: Sequence[np.ndarray]) -> Seen:
        """See the class."""
        (zero_x, zero_y, turn), level = theta
        n, side = len(scene.x), 1.0 if scene.up[2] >= 0 else -1.0
        tilt = np.append(level, 0.0)
        up, by_level = rotation.exp(tilt) @ scene.up, rotation.left_jacobian(tilt)[:, :2]
        Z = rotation.exp(np.array([0.0, 0.0, turn]))
        value, by = _tilts(Z.T @ rotation.transposed(scene.R), up, by_level)
        flat, by_flat = _tilts(Z.T[None], up, by_level)
        by_flat[..., 3:6] = 0.0
        value, by = side * (value - flat), side * (by - by_flat)
        zeros = np.broadcast_to(np.eye(2), (n, 2, 2))
        return Seen(value + [zero_x, zero_y], by[..., :6], np.concatenate([zeros, by[..., 6:]], axis=-1))


def _tilts(axes: np.ndarray, up: np.ndarray, by_level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """asin w_y and −asin w_x (n, 2) of w = axes·up, and their derivatives (n, 2, 9) by a motion of the plate (6), the
    turn of the axes and the level.

    Args:
        axes: (n, 3, 3) base → axes of the inclinometer.
        by_level: (3, 2) turn of `up` by the level.
    """
    w, turned = axes @ up, axes @ rotation.hat(up)  # a turn ω of the plate moves Rᵀu by Rᵀ(u × ω)
    dw = np.zeros((len(axes), 3, 9))
    dw[..., 3:6] = turned
    dw[..., 6] = np.stack([w[:, 1], -w[:, 0], 0 * w[:, 0]], axis=1)
    dw[..., 7:] = -turned @ by_level
    sine = w[:, [1, 0]] * [1.0, -1.0]
    cosine = np.sqrt(np.maximum(1.0 - sine**2, 1e-12))
    return np.arcsin(np.clip(sine, -1.0, 1.0)), dw[:, [1, 0]] * np.array([1.0, -1.0])[:, None] / cosine[..., None]


SENSOR = Inclinometer()
