"""Export of a calibrated robot as code for controllers or as a model for simulators, one file per target.

A file of this folder that defines ``TARGET``, a :class:`Target`, is a target of ``pcalib export --to``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pcalib.model import Model
from pcalib.registry import Registry


@dataclass(frozen=True)
class Target:
    """A format to which a model can be exported."""

    about: str
    """What it is, in one sentence."""
    write: Callable[[Model], Mapping[str, str]]
    """Model → text of each file, by name. Raises EffectError or InputError where the model cannot be written so."""
    next: str
    """What to do with the files, in one sentence; `{folder}` stands for where they are."""


TARGETS = Registry[Target]("pcalib.export", "TARGET", "target", helpers=("rods", "vectors"))
