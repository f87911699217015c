"""What a sensor is: an instrument that reads no pose, but lengths and angles that follow from it.

A sensor reads up to three lengths and three angles a row. They stand in the six places that x y z rx ry rz have in the
rows of an instrument that reads poses, so that fits and diagnoses see six scalars with σ and derivatives a row and need
not know who read them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True)
class Scene:
    """Poses in front of a sensor, in the base frame."""

    x: np.ndarray
    """(n, 3) [m] the measured points."""
    R: np.ndarray
    """(n, 3, 3) plate → base."""
    up: np.ndarray
    """(3,) unit vector against gravity, where the base stands as the robot file says."""
    origin: np.ndarray | None = None
    """(n, 3) [m] measured points of the poses from which distances are measured; None for other sensors."""


@dataclass(frozen=True)
class Seen:
    """Readings that a sensor should give, s scalars a row in the order of its quantities."""

    value: np.ndarray
    """(n, s) [m, rad]."""
    by_twist: np.ndarray
    """(n, s, 6) derivatives by a motion (v, ω) of the plate about the measured point, base frame."""
    own: np.ndarray
    """(n, s, p) derivatives by the unknowns of the set-up, block by block."""
    by_origin: np.ndarray | None = None
    """(n, s, 6) derivatives by a motion of the plate in the pose from which is measured, about its measured point."""


@dataclass(frozen=True)
class Block:
    """Unknowns of a set-up that belong together, such as the place of a station."""

    name: str
    """How messages and model files call them: 'station A'."""
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    """'m' or 'rad' of each."""
    prior: np.ndarray
    """(p,) [SI] 1σ of each about zero."""
    theta: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(p,) [SI] values; empty where they are not known yet."""

    def at(self, theta: np.ndarray) -> Block:
        """The block with values."""
        return replace(self, theta=np.asarray(theta, float))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its unknowns in a fit: 'station A.x'."""
        return tuple(f"{self.name}.{p}" for p in self.parameters)


Options = Mapping[str, object]
"""What the metadata of a file say about its sensors: key → value, as the sensors read it."""


class Sensor(ABC):
    """A kind of sensor; each is a file of `pcalib.sensors` that defines SENSOR."""

    name: ClassVar[str]
    title: ClassVar[str]
    """How sentences call it."""
    instruments: ClassVar[tuple[str, ...]] = ()
    """Instruments of that kind, as `pcalib plan --instrument` names them."""
    quantities: ClassVar[Mapping[str, tuple[int, str]]]
    """Column without unit → (place 0 … 5 of its reading in a row, dimension); lengths are 0 … 2 and angles 3 … 5."""
    sigma: ClassVar[str]
    """Name without unit of the column or metadata key with its 1σ."""
    usual_sigma: ClassVar[float]
    """[SI] 1σ taken where a file states none."""
    to: ClassVar[str | None] = None
    """Column that names what is measured to; None where there is but one."""
    between: ClassVar[bool] = False
    """Whether it measures from one pose to another: its column `to` then holds the `pose_id` of the other."""
    partial: ClassVar[bool] = False
    """Whether it reads those rows only in which some of its quantities are blank: all of them make a pose."""

    def option(self, key: str, text: str) -> object | None:
        """The value of a metadata key of this sensor; None where the key is not its own.

        Raises:
            ValueError: the text is none of the accepted values; says which are.
        """
        return None

    def blocks(self, to: str, options: Options) -> tuple[Block, ...]:
        """The unknowns of a set-up, without values; none here. Blocks of one name are one, whatever is measured to."""
        return ()

    def start(self, scene: Scene, value: np.ndarray, to: str, options: Options) -> tuple[np.ndarray, ...]:
        """First values of each block, from poses as drawn and readings (n, s) there, NaN where there is none."""
        return ()

    @abstractmethod
    def see(self, scene: Scene, theta: Sequence[np.ndarray]) -> Seen:
        """What it should read at poses with values of the blocks."""


_TRIES = 30
"""Most evaluations from one start: a good start takes ten, and gross readings may prevent convergence."""

Function = Callable[[np.ndarray], np.ndarray]
"""From the unknowns (p,) of a set-up to (n,) residuals, or to their (n, p) derivatives."""


def best(residual: Function, starts: Sequence[np.ndarray], slopes: Function | None = None) -> np.ndarray:
    """The best of the least-squares solutions from several starts.

    Args:
        slopes: derivatives of the residuals; differences are taken where they are absent.
    """
    from scipy.optimize import least_squares

    jac: Any = "2-point" if slopes is None else slopes
    found = [least_squares(residual, start, jac=jac, x_scale="jac", max_nfev=_TRIES) for start in starts]
    return min(found, key=lambda one: one.cost).x


def point(text: str) -> np.ndarray:
    """(3,) the numbers of 'x y z'.

    Raises:
        ValueError: there are not three.
    """
    try:
        values = np.array(text.replace(",", " ").split(), float)
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError("three numbers, x y z")
    return values
