"""How numbers are written for people, in reports, recordings and tables."""

from __future__ import annotations

import numpy as np

from pcalib import units
from pcalib.model import FittedEffect

PARAMETER = {"m": ("mm", 1e3, 3), "rad": ("°", 180 / np.pi, 4), "1": ("", 1.0, 6)}
"""Unit, factor from SI and decimals in which a geometric parameter of unit 'm', 'rad' or '1' is shown."""

DEVIATION = {"m": "µm", "rad": "µrad", "1": "ppm"}
"""Unit in which a deviation of such a parameter is shown, a millionth."""


def deviation(value: float, unit: str, sign: str = "-") -> str:
    """A deviation of a geometric parameter of unit 'm', 'rad' or '1' [SI]."""
    return f"{number(1e6 * value, 1, sign)} {DEVIATION[unit]}"


def size(metres: float) -> str:
    """An error: µm, or mm from 1 mm on; '–' where there is none."""
    if not np.isfinite(metres):
        return "–"
    micro = metres * 1e6
    if abs(micro) >= 999.5:
        return f"{metres * 1e3:.2f} mm"
    if abs(micro) >= 99.5:
        return f"{micro:.0f} µm"
    return f"{micro:.1f} µm" if abs(micro) >= 0.05 or micro == 0 else f"{micro:.1e} µm"


def angle(radians: float) -> str:
    """A small rotation: µrad, or mrad from 10 mrad on; '–' where there is none."""
    if not np.isfinite(radians):
        return "–"
    micro = radians * 1e6
    return f"{radians * 1e3:.1f} mrad" if abs(micro) >= 9999.5 else f"{micro:.{1 if abs(micro) < 99.5 else 0}f} µrad"


def round_size(metres: float) -> str:
    """A round length, as on a scale: '10 µm', '1 mm'."""
    return f"{metres * 1e3:g} mm" if metres >= 0.999e-3 else f"{metres * 1e6:g} µm"


def number(value: float, digits: int, sign: str = "-") -> str:
    """A number with a true minus sign, and none before zero; '–' where there is none."""
    if not np.isfinite(value):
        return "–"
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}".replace("-", "−")


def short(text: str, most: int) -> str:
    """Text cut to so many characters, where there is no room for more."""
    return text if len(text) <= most else text[: most - 1] + "…"


def clipped(text: str, most: int) -> str:
    """A list of sizes cut to so many characters, behind a whole one."""
    if len(text) <= most:
        return text
    end = max(text.rfind(mark, 0, most - 1) for mark in (", ", "; "))
    return f"{text[: end + 1]} …" if end > 0 else short(text, most)


def effect(fitted: FittedEffect) -> str:
    """An effect and its fitted values, in its own words where it has some."""
    describe = getattr(fitted.effect, "describe", None)
    if describe is not None:
        return str(describe(fitted.theta))
    values = []
    for i, p in enumerate(fitted.effect.parameters):
        factor = units.factor(p.unit)
        text = f"{p.name} = {fitted.theta[i] / factor:.4g}"
        if fitted.sigma is not None and np.isfinite(fitted.sigma[i]):
            text += f" ± {fitted.sigma[i] / factor:.2g}"
        values.append(f"{text} {units.spoken(p.unit)}".strip())
    return f"{fitted.effect.name}: {', '.join(values)}"
