"""Noise of instruments: one file each, which draws the errors of readings and knows their covariance.

A file of this folder that defines ``NOISE``, a subclass of :class:`Noise`, is a noise; its name is the file's, and
``[instrument] noise = "NAME"`` in a truth file chooses it. Files that start with `_` are none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pcalib.data.instrument import Instrument
from pcalib.registry import Registry
from pcalib.settings import Setting

STREAM = 0x1257
"""Keeps the draws of the instrument apart from all others of one seed."""
EXTRA = 2
"""Stream of what a noise draws beyond six numbers a row; those six and the joints have streams of one number."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What the instrument looks at: N rows, in its own axes and from its own place where `frame` is 'tracker'."""

    position: np.ndarray
    """(N, 3) [m] measured points, measuring frame."""
    R: np.ndarray
    """(N, 3, 3) orientation of the plate, measuring frame."""
    tool: np.ndarray
    """(N, 3) [m] measured points, plate frame."""
    station: np.ndarray
    """(3,) [m] where the instrument stands, measuring frame."""
    rows: np.ndarray
    """(N,) numbers of the rows in the plan, which is the order in which they are measured."""
    normals: np.ndarray
    """(N, 6) standard normal numbers, one row's independent of the others'."""
    seed: int

    @property
    def distance(self) -> np.ndarray:
        """(N,) [m] from the instrument to the measured points."""
        return np.linalg.norm(self.position - self.station, axis=1)

    def more(self, count: int, rows: np.ndarray | None = None) -> np.ndarray:
        """Return (N, count) further standard normal numbers of the given rows, those of the scene where absent."""
        wanted = (self.rows if rows is None else rows).tolist()
        return np.stack([generator(self.seed, EXTRA, row).standard_normal(count) for row in wanted])


class Noise:
    """Base of all noises: settings, errors of the readings, and their covariance."""

    SETTINGS: ClassVar[tuple[Setting, ...]] = ()
    """Numbers of this noise, beside those that every instrument has."""
    BESIDE: ClassVar[tuple[bool, bool]] = (True, True)
    """Whether a data file that describes the instrument also states σ of positions, and σ of rotations."""

    def __init__(self, values: Mapping[str, Any]):
        self.values = values

    def errors(self, scene: Scene) -> np.ndarray:
        """Return (N, 6) [m, rad] errors of position and of rotation (left-multiplied rotation vector), measuring
        frame."""
        raise NotImplementedError

    def covariance(self, scene: Scene) -> np.ndarray:
        """Return (N, 6, 6), covariance of the errors within each row; correlation between rows is not part of it."""
        raise NotImplementedError

    def stated(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        """Return (N,) [m] and (N,) [rad] 1σ per component as the maker states it: one number each, the mean of all
        rows and directions."""
        variance = np.mean(np.diagonal(self.covariance(scene), axis1=1, axis2=2), axis=0)
        n = len(scene.rows)
        return np.full(n, np.sqrt(variance[:3].mean())), np.full(n, np.sqrt(variance[3:].mean()))

    def description(self, scene: Scene) -> Instrument | None:
        """Return what a data file states of the instrument, so that the covariance follows; None if σ says all."""
        return None


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return the random numbers of one stream, or of one row of it: they depend on the seed and this key alone."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(STREAM, *key))))


def isotropic(sigma_pos: np.ndarray, sigma_rot: np.ndarray) -> np.ndarray:
    """Return (N, 6, 6) covariance of independent components with 1σ (N,) [m] and (N,) [rad]."""
    return np.stack([*[sigma_pos**2] * 3, *[sigma_rot**2] * 3], axis=1)[:, :, None] * np.eye(6)


NOISES = Registry[type[Noise]](__name__, "NOISE", "noise", key="noise")
names, get = NOISES.names, NOISES.get


def all_settings() -> tuple[Setting, ...]:
    """Return the settings of all noises; a setting that two of them share is listed once."""
    found = {setting.name: setting for name in names() for setting in get(name).SETTINGS}
    return tuple(found.values())
