"""Robot kinds: one file each. A kind names its dimensions and parameters and builds a :class:`Mechanism`.

A file of this folder that defines ``KIND`` is a kind; nothing else has to be told about it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib.mechanics.mechanism import Mechanism
from pcalib.registry import Registry
from pcalib.settings import Setting

LARGEST_LENGTH = 100.0
"""[m] the largest dimension that is accepted; what is more is a wrong unit. The largest cable robots span 60 m."""
SMALLEST_SIZE = 1e-4
"""[m] the smallest rod, arm or spacing that is accepted: a tenth of the thinnest joint's diameter."""


def size(name: str, low: float = SMALLEST_SIZE) -> Setting:
    """A length that is more than zero."""
    return Setting(name, "length", low=low, high=LARGEST_LENGTH)


def radius(name: str) -> Setting:
    """A radius, which may be zero."""
    return size(name, 0.0)


def offset(name: str) -> Setting:
    """A coordinate, of either sign."""
    return size(name, -LARGEST_LENGTH)


def azimuths(name: str, count: int) -> Setting:
    """A list of directions."""
    return Setting(name, "angle", low=-2 * np.pi, high=2 * np.pi, count=count)


def masses(*names: str) -> tuple[Setting, ...]:
    """Masses of parts; 1e4 kg is ten times the heaviest plate of a flight simulator."""
    return tuple(Setting(name, "mass", low=0.0, high=1e4) for name in names)


@dataclass(frozen=True)
class Kind:
    """What a robot file of this kind holds, and how its mechanism is built."""

    name: str
    dimensions: tuple[Setting, ...]
    """The keys of [geometry], with their ranges."""
    build: Callable[[Mapping[str, Any]], Mechanism]
    """Mechanism of the [geometry] table in SI (lists as arrays)."""
    masses: tuple[Setting, ...] = (*masses("arm", "rod", "plate"), radius("arm_com"))
    """The keys of [mass]."""


KINDS = Registry[Kind](__name__, "KIND", "robot kind", key="kind")
names, get = KINDS.names, KINDS.get
