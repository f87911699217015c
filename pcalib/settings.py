"""Settings of TOML files: named, with a dimension, a range and a default, and read strictly.

Robot files, truth files and campaign specs are read by this one reader. All of them name the unit of every quantity:
``gap_um = 12`` or ``gap_mm = 0.012``. (A typed reader such as msgspec cannot know keys that end with any unit, nor the
nearest accepted name, nor the line; its messages would have to be translated by as much code as stands here.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib import units
from pcalib.errors import BadInput, InputError, unknown

REQUIRED = None
"""Default of a setting that must be given."""
ABSENT = object()
"""Default of a setting that has no value where it is not given: `read` leaves it out."""
ANY = -1
"""As the count of a setting: a list of any length."""


@dataclass(frozen=True)
class Setting:
    """One key of a table."""

    name: str
    dimension: str
    """A dimension of `pcalib.units`, or 'number', 'whole', 'flag', 'word'."""
    default: Any = REQUIRED
    """[SI]"""
    low: float = -np.inf
    """[SI] Smallest value that is accepted."""
    high: float = np.inf
    """[SI] Largest value that is accepted."""
    per: str = ""
    """'actuator' or 'rod': one number each, or one number for all; '': one number, or a list of `count`."""
    count: int = 0
    """How many numbers a list has; 0: the setting is one number, `ANY`: a list of any length."""
    typical: Any = None
    """[SI] usual size, one number for all of a 'per'; None: the default."""
    words: tuple[str, ...] = ()
    """Accepted values of a 'word'."""
    about: str = ""
    """What the setting is, in a few words."""

    @property
    def spellings(self) -> str:
        """Accepted keys."""
        return units.spellings(self.name, self.dimension) or self.name


def section(table: Mapping[str, Any], name: str, settings: Sequence[Setting]) -> dict[str, Any]:
    """Values in SI of the section [name] of a TOML file.

    Raises:
        InputError: there is no such section, or a key of it is wrong.
    """
    found = table.get(name)
    if not isinstance(found, Mapping):
        keys = ", ".join(s.name for s in settings)
        said = "is missing" if found is None else "must be a section"
        raise InputError(f"section [{name}] {said}", key=name, remedy=f"write [{name}] with {keys}, each with its unit")
    return read(found, settings, name)


def read(
    table: Mapping[str, Any], settings: Sequence[Setting], where: str, counts: Mapping[str, int] = {}
) -> dict[str, Any]:
    """Values in SI of one TOML table: every setting once, defaults where absent, nothing else.

    Args:
        where: the section's name, for messages.
        counts: how many numbers a setting 'per' something has.

    Raises:
        InputError: a key is unknown, missing, without unit, of the wrong type or out of range.
    """
    dimensioned = {s.name: s.dimension for s in settings if _has_unit(s)}
    plain = {s.name for s in settings if not _has_unit(s)}
    try:
        found = units.resolve([key for key in table if key not in plain], dimensioned, where="key")
    except InputError as error:
        raise error.but(problem=f"[{where}] {error.problem}", section=where) from None
    found |= {name: (name, 1.0) for name in plain if name in table}
    used = {key for key, _ in found.values()}
    for key in table:
        if key not in used:
            accepted = [name for s in settings for name in s.spellings.split(", ")]
            problem = f"[{where}] {unknown('key', key, accepted)}"
            raise InputError(problem, code=BadInput.UNKNOWN_KEY, section=where, key=key)
    out: dict[str, Any] = {}
    for setting in settings:
        if setting.name in found:
            key, factor = found[setting.name]
            out[setting.name] = _value(setting, key, table[key], factor, where, counts)
        elif setting.default is REQUIRED:
            problem, remedy = f"[{where}] '{setting.name}' is missing", f"write one of {setting.spellings}"
            raise InputError(problem, section=where, key=setting.name, remedy=remedy)
        elif setting.default is not ABSENT:
            out[setting.name] = spread(setting, setting.default, counts)
    return out


def is_number(value: Any) -> bool:
    """Whether a value from TOML is a finite number."""
    return not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value)


def write(values: Mapping[str, Any], settings: Sequence[Setting]) -> dict[str, Any]:
    """A table that :func:`read` turns into the same values, to the last bit: in SI units where there are any."""
    out = {}
    for setting in settings:
        value = values[setting.name]
        if _has_unit(setting):
            accepted = [u for u in units.UNITS.values() if u.dimension == setting.dimension]
            unit = next((u for u in accepted if u.factor == 1.0), accepted[0])
            plain = value.tolist() if isinstance(value, np.ndarray) else value
            many = isinstance(plain, list)
            numbers = [_inverse(v, unit.factor) for v in (plain if many else [plain])]
            out[f"{setting.name}_{unit.suffix}"] = numbers if many else numbers[0]
        else:
            out[setting.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return out


def _inverse(value: float, factor: float) -> float:
    """The number that times `factor` is `value`, exactly where there is one."""
    near = value / factor
    tried = (near, float(np.nextafter(near, np.inf)), float(np.nextafter(near, -np.inf)))
    return next((v for v in tried if v * factor == value), near)


def _has_unit(setting: Setting) -> bool:
    return setting.dimension not in ("number", "whole", "flag", "word")


def _value(setting: Setting, key: str, raw: Any, factor: float, where: str, counts: Mapping[str, int]) -> Any:
    def wrong(what: str, remedy: str = "") -> InputError:
        problem = f"[{where}] '{key}' must be {what}, not {raw!r:.80}"
        return InputError(problem, section=where, key=key, remedy=remedy)

    if setting.dimension == "flag":
        if not isinstance(raw, bool):
            raise wrong("true or false")
        return raw
    if setting.dimension == "word":
        if not isinstance(raw, str) or (setting.words and raw not in setting.words):
            raise wrong("one of " + ", ".join(f'"{w}"' for w in setting.words) if setting.words else "text")
        return raw
    many = isinstance(raw, list)
    numbers = raw if many else [raw]
    count = setting.count or counts.get(setting.per, 1)
    form = "a list of numbers" if count == ANY else f"a list of {count} numbers" if count > 1 else "a number"
    fine = count in (ANY, len(numbers)) and (setting.per or setting.count) if many else not setting.count
    if not fine or not all(map(is_number, numbers)):
        raise wrong(f"a number or {form}" if setting.per and count > 1 else form)
    if setting.dimension == "whole" and any(v != int(v) for v in numbers):
        raise wrong("a whole number" if not many else "a list of whole numbers")
    si = np.array(numbers, float) * factor
    if (si < setting.low).any() or (si > setting.high).any():
        low, high = setting.low / factor, setting.high / factor
        bounds = f"at least {low:g}" if np.isinf(high) else f"from {low:g} to {high:g}"
        degrees = f"write {setting.name}_deg if these are degrees" if key.endswith("_rad") else ""
        raise wrong(bounds, degrees)
    return spread(setting, si if many else float(si[0]), counts)


def spread(setting: Setting, value: Any, counts: Mapping[str, int]) -> Any:
    """A value as `read` gives it: one array per setting with 'per', whatever was given; whole numbers as int."""
    if setting.per:
        return np.broadcast_to(np.asarray(value, float), (counts[setting.per],)).copy()
    if setting.count:
        return np.array(value, float)
    if setting.dimension == "whole":
        return int(value)
    return float(value) if isinstance(value, np.number) else value
