"""Heights of the measured point over a plane or a sphere: dial gauge, touch probe, displacement sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from pcalib import rotation
from pcalib.sensors.base import Block, Options, Scene, Seen, Sensor, best

_ANYWHERE = 10.0
"""[m] 1σ of places: anywhere in the room."""
_ANY_TURN = 3.0
"""[rad] 1σ of the direction of a plane: any."""
_KEY = "surface_"


class Probe(Sensor):
    """Over a plane with normal n at height c from the origin: n·x − c. Over a sphere: |x − centre| − radius.

    A probe's own zero is part of c or of the radius. The normal is z turned by the rotation vector (rx, ry, 0).
    """

    name: ClassVar[str] = "probe"
    title: ClassVar[str] = "heights over a surface"
    instruments: ClassVar = ("dial-gauge", "probe")
    quantities: ClassVar = {"probe": (0, "length")}
    sigma: ClassVar[str] = "sigma_probe"
    usual_sigma: ClassVar[float] = 5e-6
    to: ClassVar[str | None] = "surface"

    def option(self, key: str, text: str) -> object | None:
        """`surface_A = plane` or `sphere`."""
        if not key.startswith(_KEY):
            return None
        if text not in ("plane", "sphere"):
            raise ValueError("plane, sphere")
        return text

    def blocks(self, to: str, options: Options) -> tuple[Block, ...]:
        """A plane has two turns and a height, a sphere a centre and a radius."""
        if options.get(_KEY + to) == "sphere":
            return (Block(f"surface {to}", ("x", "y", "z", "radius"), ("m",) * 4, np.full(4, _ANYWHERE)),)
        prior = np.array([_ANY_TURN, _ANY_TURN, _ANYWHERE])
        return (Block(f"surface {to}", ("rx", "ry", "height"), ("rad", "rad", "m"), prior),)

    def start(self, scene: Scene, value: np.ndarray, to: str, options: Options) -> tuple[np.ndarray, ...]:
        """The surface that fits the points best."""
        x, d = scene.x, value[:, 0]
        middle = x.mean(axis=0)
        if options.get(_KEY + to) == "sphere":
            # |x|² − d² = 2 x·c + 2 d·r + (r² − |c|²), linear where the last is taken as an unknown of its own
            A = np.column_stack([2 * (x - middle), np.ones(len(x))])
            c = np.linalg.lstsq(A, np.sum((x - middle) ** 2, axis=1), rcond=None)[0]
            first = np.append(c[:3] + middle, np.sqrt(max(c[3] + c[:3] @ c[:3], 1e-12)) - np.mean(d))
            return (best(lambda s: np.linalg.norm(x - s[:3], axis=1) - s[3] - d, [first]),)

        def miss(plane: np.ndarray) -> np.ndarray:
            return x @ _normal(plane) - plane[2] - d

        normals = np.linalg.svd(x - middle)[2]
        starts = [np.append(_turn(n), n @ middle - d.mean()) for n in (normals[2], -normals[2])]
        return (best(miss, starts),)

    def see(self, scene: Scene, theta: Sequence[np.ndarray]) -> Seen:
        """See the class."""
        surface, x = theta[0], scene.x
        if len(surface) == 4:
            away = x - surface[:3]
            d = np.linalg.norm(away, axis=1)
            n = away / np.maximum(d, 1e-12)[:, None]
            value, own = d - surface[3], np.column_stack([-n, -np.ones(len(x))])
        else:
            normal = _normal(surface)
            n = np.broadcast_to(normal, x.shape)
            turn = -rotation.hat(normal) @ rotation.left_jacobian(np.append(surface[:2], 0.0))[:, :2]
            value, own = x @ normal - surface[2], np.column_stack([x @ turn, -np.ones(len(x))])
        return Seen(value[:, None], np.concatenate([n, 0 * n], axis=1)[:, None], own[:, None])


def _normal(plane: np.ndarray) -> np.ndarray:
    return rotation.exp(np.append(plane[:2], 0.0))[:, 2]


def _turn(normal: np.ndarray) -> np.ndarray:
    """(2,) rotation vector about x and y [rad] that turns the z axis into a unit normal (3,)."""
    angle, side = np.arccos(np.clip(normal[2], -1.0, 1.0)), np.array([-normal[1], normal[0]])
    size = np.linalg.norm(side)
    return angle * (side / size if size > 0 else np.array([1.0, 0.0]))


SENSOR = Probe()
