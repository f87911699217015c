"""The library of physical effects: one file each, found by itself.

A file of this folder that defines ``EFFECT`` is an effect of that file's name; nothing else has to be told about it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from pcalib.effects.base import Contribution, Effect, EffectParameter, Situation
from pcalib.effects.library import LIBRARY as LIBRARY
from pcalib.effects.library import LibraryEffect, Places
from pcalib.errors import EffectError
from pcalib.robot import Robot

__all__ = ["Contribution", "Effect", "EffectParameter", "Situation", "get", "missing", "names", "parse", "require"]


names = LIBRARY.names


def get(
    name: str, per: str | None = None, robot: Robot | None = None, cycles: Sequence[int] | None = None
) -> LibraryEffect:
    """An effect of the library, fitted to a robot.

    Args:
        per: 'common', 'arm' or 'rod'; the first of the effect's variants when absent.
        robot: gives the arms and rods for separate parameters; the Delta when absent.
        cycles: of gear_ripple, per turn; those of the robot file, else 24, when absent.

    Raises:
        EffectError: no such effect or variant, or one that makes no sense on this robot.
    """
    kind = LIBRARY.get(name)
    places = Places() if robot is None else Places.of(robot.mechanism)
    options = {}
    if any(f.name == "cycles" for f in fields(kind)):
        wanted = cycles if cycles is not None else (robot.drive.get("ripple_per_turn") if robot is not None else None)
        if wanted is not None:
            options["cycles"] = tuple(int(n) for n in np.atleast_1d(wanted))
    elif cycles is not None:
        raise EffectError(f"effect {name} has no cycles per turn")
    effect = kind(per=per or kind.variants[0], places=places, **options)
    if robot is not None and (why := effect.unsuited(robot.mechanism)):
        raise EffectError(f"effect {name} makes no sense on robot '{robot.name}': {why}")
    return effect


def parse(spec: str, robot: Robot | None = None) -> Effect:
    """An effect as a command line names it: NAME, NAME:arm, NAME:rod, gear_ripple@24, or file.py:ClassName.

    Code is loaded only for a file named here.

    Raises:
        EffectError: it cannot be read that way; the message lists what is accepted.
    """
    if ".py" in spec:
        from pcalib.effects.user import load

        return load(spec, robot)
    text, _, cycles = spec.partition("@")
    name, _, per = text.partition(":")
    try:
        turns = [int(n) for n in cycles.split("+")] if cycles else None
        if turns is not None and min(turns) < 1:
            raise ValueError
    except ValueError:
        problem = f"'{spec}': '{cycles}' is not a list of cycles per turn"
        raise EffectError(f"{problem}\n  write positive whole numbers, e.g. gear_ripple@24+48") from None
    return get(name, per or None, robot, turns)


def missing(effect: Effect, columns: Mapping[str, np.ndarray]) -> list[str]:
    """Columns that an effect needs and the data lack, or have blanks in; `temp` serves for every temperature."""
    out = []
    for name in effect.needs:
        source = "temp" if name.startswith("temp_") and name not in columns and "temp" in columns else name
        if source not in columns or not np.isfinite(columns[source]).all():
            out.append(name)
    return out


def require(effect: Effect, columns: Mapping[str, np.ndarray], source: str | Path) -> None:
    """Refuse a file without the columns that an effect needs.

    Raises:
        EffectError: a column is absent, or has blanks.
    """
    if lacking := missing(effect, columns):
        raise EffectError(
            f"{source}: effect {effect.name} needs columns that the data do not have: {', '.join(lacking)}\n"
            "  add them to the file, with a value in every row"
        )
