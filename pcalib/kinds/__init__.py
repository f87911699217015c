"""Robot kinds: one file each. A kind names its dimensions and parameters and builds a :class:`Mechanism`.

A file of this folder that defines ``KIND`` is a kind; nothing else has to be told about it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcalib.errors import InputError, unknown
from pcalib.mechanics.mechanism import Mechanism


@dataclass(frozen=True)
class Kind:
    """What a robot file of this kind holds, and how its mechanism is built."""

    name: str
    dimensions: Mapping[str, str]
    """[geometry] quantity → dimension ('length', 'angle', 'travel', 'none'); a list quantity ends with '[]'."""
    build: Callable[[Mapping[str, Any]], Mechanism]
    """Mechanism of the [geometry] table in SI (lists as arrays)."""
    joint_dimension: str = "angle"
    masses: Mapping[str, str] = field(
        default_factory=lambda: {"arm": "mass", "arm_com": "length", "rod": "mass", "plate": "mass"}
    )
    optional: frozenset[str] = frozenset()
    """[geometry] quantities that a file may leave out."""


def names() -> list[str]:
    """The kinds that exist, by file name."""
    return sorted(m.name for m in pkgutil.iter_modules(__path__))


def get(name: str) -> Kind:
    """The kind of that name.

    Raises:
        InputError: no such kind.
    """
    if name not in names():
        raise InputError(unknown("robot kind", name, names()), column="kind")
    return importlib.import_module(f"{__name__}.{name}").KIND


def table(dimensions: Mapping[str, Any], quantity: str, count: int) -> np.ndarray:
    """A list of the [geometry] table, of the right length.

    Raises:
        InputError: it has another length.
    """
    values = np.asarray(dimensions[quantity], float)
    if values.shape != (count,):
        raise InputError(f"[geometry] '{quantity}' needs {count} numbers, not {values.size}", column=quantity)
    return values
