"""Units at the edges: every physical quantity in a file or on a command line carries its unit in its name.

Inside the code all values are SI (m, rad, kg, N, s); temperatures stay in °C because every effect
uses the difference from 20 °C.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from pcalib.errors import InputError


@dataclass(frozen=True)
class Unit:
    """One accepted spelling: its dimension and the factor to SI."""

    suffix: str
    dimension: str
    factor: float


_DEGREE = math.pi / 180.0
UNITS: dict[str, Unit] = {
    suffix: Unit(suffix, dimension, factor)
    for dimension, factors in {
        "length": {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0},
        "angle": {
            "urad": 1e-6, "mrad": 1e-3, "arcmin": _DEGREE / 60, "arcsec": _DEGREE / 3600, "deg": _DEGREE, "rad": 1.0,
            "rev": 2 * math.pi,
        },
        "mass": {"g": 1e-3, "kg": 1.0},
        "temperature": {"degC": 1.0},
        "time": {"s": 1.0, "min": 60.0, "h": 3600.0},
        "acceleration": {"m_s2": 1.0},
        "force": {"N": 1.0},
        "torque": {"Nm": 1.0},
        "stiffness": {"N_um": 1e6, "N_mm": 1e3, "N_m": 1.0},
        "rotational_stiffness": {"Nm_rad": 1.0, "kNm_rad": 1e3},
        "compliance": {"m_N": 1.0, "um_N": 1e-6, "mm_N": 1e-3},
        "rotational_compliance": {"rad_Nm": 1.0, "urad_Nm": 1e-6, "mrad_Nm": 1e-3},
        "tip_compliance": {"rad_N": 1.0, "urad_N": 1e-6},
        "expansion": {"1_K": 1.0, "ppm_K": 1e-6},
        "angle_per_kelvin": {"rad_K": 1.0, "urad_K": 1e-6},
        "length_per_kelvin": {"m_K": 1.0, "um_K": 1e-6},
        "ratio": {"ppm": 1e-6},
        "velocity": {"m_s": 1.0, "um_h": 1e-6 / 3600, "mm_h": 1e-3 / 3600},
        "angular_velocity": {"rad_s": 1.0, "urad_h": 1e-6 / 3600},
        "count": {"per_rev": 1.0},
        "travel": {"mm_rev": 1e-3 / (2 * math.pi), "m_rad": 1.0},
    }.items()
    for suffix, factor in factors.items()
}  # fmt: skip
_BY_LENGTH = sorted(UNITS, key=len, reverse=True)


def spellings(quantity: str, dimension: str) -> str:
    """Accepted names of a quantity: ``x_um, x_mm, x_cm, x_m``."""
    return ", ".join(f"{quantity}_{u.suffix}" for u in UNITS.values() if u.dimension == dimension)


def split(name: str) -> tuple[str, Unit | None]:
    """``"base_radius_mm"`` → ``("base_radius", Unit mm)``; the unit is None where no known suffix ends the name."""
    for suffix in _BY_LENGTH:
        if name.endswith("_" + suffix):
            return name[: -len(suffix) - 1], UNITS[suffix]
    return name, None


def resolve(names: list[str], wanted: dict[str, str], *, where: str = "key") -> dict[str, tuple[str, float]]:
    """Which of `names` give the `wanted` quantities (quantity → dimension), and the factor of each to SI.

    A name that is a wanted quantity with no unit, or with a unit of another dimension, and a quantity that is
    given twice, are errors that list the accepted spellings. Names of other quantities are ignored.
    """
    found: dict[str, tuple[str, float]] = {}
    for name in names:
        quantity, unit = split(name)
        bare = name if name in wanted else quantity
        if bare not in wanted:
            stem = name.rsplit("_", 1)[0]
            if stem in wanted and wanted[stem] != "count":
                raise InputError(
                    f"{where} '{name}': '{name[len(stem) + 1:]}' is not a known unit", key=name,
                    remedy=f"write one of {spellings(stem, wanted[stem])}",
                )
            continue
        dimension = wanted[bare]
        if bare == name and dimension not in ("none", "count"):
            raise InputError(
                f"{where} '{name}' has no unit", key=name, remedy=f"write one of {spellings(name, dimension)}"
            )
        if bare != name and (unit is None or unit.dimension != dimension):
            raise InputError(
                f"{where} '{name}': '{unit.suffix if unit else ''}' is not a unit of {dimension}", key=name,
                remedy=f"write one of {spellings(bare, dimension)}",
            )
        if bare in found:
            raise InputError(
                f"'{bare}' is given twice: {where}s '{found[bare][0]}' and '{name}'", key=name,
                remedy="keep one of them",
            )
        found[bare] = (name, 1.0 if unit is None or bare == name else unit.factor)
    return found


def factor(suffix: str) -> float:
    """Factor from a unit to SI; '1' is a pure number.

    Raises:
        InputError: no such unit.
    """
    if suffix == "1":
        return 1.0
    if suffix not in UNITS:
        raise InputError(f"unknown unit '{suffix}'", remedy=f"accepted: 1, {', '.join(UNITS)}")
    return UNITS[suffix].factor


def si(suffix: str) -> str:
    """The spelling of a unit's SI unit: ``urad_Nm`` → ``rad_Nm``; '1' where that is a pure number."""
    if suffix == "1":
        return "1"
    dimension = UNITS[suffix].dimension
    return next((u.suffix for u in UNITS.values() if u.dimension == dimension and u.factor == 1.0), "1")


_SPOKEN = {"um": "µm", "degC": "°C", "deg": "°", "m_s2": "m/s²", "1": "", "1_K": "1/K", "per_rev": "per turn"}


def spoken(suffix: str) -> str:
    """A unit as people write it: ``um_N`` → µm/N, ``kNm_rad`` → kN·m/rad."""
    if suffix in _SPOKEN:
        return _SPOKEN[suffix]
    parts = [re.sub(r"^u(?=m|rad)", "µ", part).replace("Nm", "N·m") for part in suffix.split("_")]
    return "/".join(parts)


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def parse_quantity(text: str, dimension: str, *, option: str = "value") -> np.ndarray:
    """``"0,0,-300mm"`` or ``"5deg"`` → SI array; the unit stands once at the end.

    Raises:
        InputError: no unit, an unknown or wrong unit, or text that is no number.
    """
    suffixes = [u.suffix for u in UNITS.values() if u.dimension == dimension]
    accepted = ", ".join(suffixes)
    match = re.fullmatch(rf"\s*({_NUMBER}(?:\s*,\s*{_NUMBER})*)\s*([A-Za-z_0-9]*)\s*", text)
    if not match:
        raise InputError(f"{option} '{text}' is not a list of numbers with a unit", remedy=f"units: {accepted}")
    unit = UNITS.get(match.group(2))
    if unit is None or unit.dimension != dimension:
        said = f"unknown unit '{match.group(2)}'" if match.group(2) else "no unit"
        example = f"{match.group(1)}{next(s for s in ('mm', 'deg', 'kg', *suffixes) if s in suffixes)}"
        raise InputError(f"{option} '{text}': {said}", remedy=f"end it with one of {accepted}, e.g. {example}")
    values = np.array([float(v) for v in match.group(1).split(",")]) * unit.factor
    if not np.isfinite(values).all():
        raise InputError(f"{option} '{text}' is beyond what a number can hold", remedy=f"units: {accepted}")
    return values
