"""Readers of measurements in forms of other origin: each gives a measurement file and the robot file that goes with it.

A file of this folder that defines ``IMPORTER`` is a reader; nothing else has to be told about it. The form that it
reads stands in its docstring.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcalib import units
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError, unknown
from pcalib.registry import Registry
from pcalib.robot import Robot


@dataclass(frozen=True)
class Option:
    """A number, or several, that the file does not hold and the reader needs."""

    default: tuple[float, ...]
    """In `unit`."""
    unit: str
    """A spelling of `pcalib.units`; '' for a plain number."""
    text: str
    """What it is."""

    @property
    def si(self) -> np.ndarray:
        """The default in SI."""
        return np.array(self.default) * (units.UNITS[self.unit].factor if self.unit else 1.0)


@dataclass(frozen=True)
class Imported:
    """What a reader made of a file."""

    data: Measurements
    robot: Robot
    notes: tuple[str, ...] = ()
    """What the user should know."""


@dataclass(frozen=True)
class Importer:
    """A reader of one form of file."""

    name: str
    summary: str
    options: Mapping[str, Option]
    read: Callable[[Path, Mapping[str, np.ndarray]], Imported]
    """From the file and all options in SI."""


IMPORTERS = Registry[Importer](
    __name__, "IMPORTER", "form", remedy="'pcalib import --help' describes them", separator="-"
)  # fmt: skip
names, get = IMPORTERS.names, IMPORTERS.get


def run(name: str, path: str | Path, given: Iterable[str] = ()) -> Imported:
    """Read a file in a form of that name.

    Args:
        given: options as ``name=value<unit>``, e.g. ``rod=288mm``; defaults elsewhere.

    Raises:
        InputError: no such form or option, an option without its unit, or a file that is not of the form.
    """
    importer = get(name)
    values = {key: option.si for key, option in importer.options.items()}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--set '{text}' has no value", remedy="write name=value, e.g. rod=288mm")
        if key not in importer.options:
            raise InputError(unknown(f"setting of form {name}", key, importer.options))
        values[key] = _parsed(key, value, importer.options[key])
    return importer.read(Path(path), values)


def _parsed(key: str, text: str, option: Option) -> np.ndarray:
    if option.unit:
        found = units.parse_quantity(text, units.UNITS[option.unit].dimension, option=key)
    else:
        try:
            found = np.array([float(part) for part in text.split(",")])
        except ValueError:
            raise InputError(f"{key}={text}: not a number") from None
    if len(found) != len(option.default):
        count = len(option.default)
        raise InputError(f"{key}={text}: {count} number{'s' * (count > 1)} needed, not {len(found)}")
    return found
