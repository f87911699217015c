"""Settings of faults and instruments: named, with a dimension, a range and a default, read strictly from TOML.

Like all files of the project, a truth file names the unit of every quantity: ``gap_um = 12``, ``gap_mm = 0.012``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib import units
from pcalib.errors import InputError, unknown

REQUIRED = None
"""Default of a setting that must be given."""


@dataclass(frozen=True)
class Setting:
    """One key of a table."""

    name: str
    dimension: str
    """A dimension of `pcalib.units`, or 'number', 'whole', 'flag', 'word'."""
    default: Any = REQUIRED
    """[SI]"""
    low: float = -np.inf
    """[SI] smallest sensible value; a number outside low…high is refused."""
    high: float = np.inf
    per: str = ""
    """'actuator' or 'rod': one number each, or one for all; 'axis': three numbers; '': one number."""
    typical: Any = None
    """[SI] usual size, one number for all of a 'per'; None: the default."""
    words: tuple[str, ...] = ()
    """Accepted values of a 'word'."""
    about: str = ""
    """What it is, in a few words."""

    @property
    def spellings(self) -> str:
        """Accepted keys."""
        return units.spellings(self.name, self.dimension) or self.name


def read(
    table: Mapping[str, Any], settings: Sequence[Setting], where: str, counts: Mapping[str, int]
) -> dict[str, Any]:
    """Values in SI of one TOML table: every setting once, defaults where absent, nothing else.

    Args:
        where: the table's name, for messages.
        counts: how many numbers a setting 'per' something has.

    Raises:
        InputError: a key that is unknown, missing, without unit, of the wrong type or out of range.
    """
    dimensioned = {s.name: s.dimension for s in settings if _has_unit(s)}
    plain = {s.name for s in settings if not _has_unit(s)}
    try:
        found = units.resolve([key for key in table if key not in plain], dimensioned, where="key")
    except InputError as error:
        # Where in the file: the key that the message quotes first.
        raise InputError(f"[{where}] {error.problem}", column=_quoted(error.problem), remedy=error.remedy) from None
    found |= {name: (name, 1.0) for name in plain if name in table}
    used = {key for key, _ in found.values()}
    for key in table:
        if key not in used:
            accepted = [name for s in settings for name in s.spellings.split(", ")]
            raise InputError(f"[{where}] {unknown('key', key, accepted)}", column=key)
    out: dict[str, Any] = {}
    for setting in settings:
        if setting.name in found:
            key, factor = found[setting.name]
            out[setting.name] = _value(setting, key, table[key], factor, where, counts)
        elif setting.default is REQUIRED:
            missing = f"[{where}] '{setting.name}' is missing"
            raise InputError(missing, column=where, remedy=f"write one of {setting.spellings}")
        else:
            out[setting.name] = spread(setting, setting.default, counts)
    return out


def is_number(value: Any) -> bool:
    """Whether a value from TOML is a finite number."""
    try:
        return not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value)
    except OverflowError:  # TOML's whole numbers have no end
        return False


def _quoted(text: str) -> str | None:
    """The first word in quotes."""
    return text.split("'")[1] if text.count("'") > 1 else None


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
    def wrong(what: str) -> InputError:
        return InputError(f"[{where}] '{key}' must be {what}, not {raw!r}", column=key)

    if setting.dimension == "flag":
        if not isinstance(raw, bool):
            raise wrong("true or false")
        return raw
    if setting.dimension == "word":
        if not isinstance(raw, str) or (setting.words and raw not in setting.words):
            raise wrong("one of " + ", ".join(f'"{w}"' for w in setting.words) if setting.words else "text")
        return raw
    many = isinstance(raw, list)
    count = counts.get(setting.per, 1)
    numbers = raw if many else [raw]
    if not all(is_number(v) for v in numbers):
        raise wrong("a number" if count == 1 else f"a number or a list of {count} numbers")
    if (many and len(numbers) != count) or (setting.per == "axis" and not many):
        raise wrong(f"a list of {count} numbers" if count > 1 else "a number")
    if setting.dimension == "whole" and any(v != int(v) for v in numbers):
        raise wrong("a whole number")
    si = np.array(numbers, float) * factor
    if (si < setting.low).any() or (si > setting.high).any():
        low, high = setting.low / factor, setting.high / factor
        bounds = f"at least {low:g}" if np.isinf(high) else f"from {low:g} to {high:g}"
        raise InputError(f"[{where}] '{key}' must be {bounds}, not {raw!r}", column=key)
    return spread(setting, si if many else float(si[0]), counts)


def spread(setting: Setting, value: Any, counts: Mapping[str, int]) -> Any:
    """One array per setting with 'per', whatever was given; whole numbers as int."""
    if setting.per:
        return np.broadcast_to(np.asarray(value, float), (counts[setting.per],)).copy()
    if setting.dimension == "whole":
        return int(value)
    return float(value) if isinstance(value, np.number) else value
