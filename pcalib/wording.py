"""How numbers are written for people, in reports, recordings and tables."""

from __future__ import annotations

import numpy as np

PARAMETER = {"m": ("mm", 1e3, 3), "rad": ("°", 180 / np.pi, 4), "1": ("", 1.0, 6)}
"""Unit, factor from SI and decimals in which a geometric parameter of unit 'm', 'rad' or '1' is shown."""

DEVIATION = {"m": "µm", "rad": "µrad", "1": "ppm"}
"""Unit in which a deviation of such a parameter is shown, a millionth."""


def deviation(value: float, unit: str, sign: str = "-") -> str:
    """A deviation of a geometric parameter of unit 'm', 'rad' or '1' [SI]: in millionths, lengths and angles from
    10 mm or mrad on in thousandths."""
    if unit != "1" and abs(value) >= 9.9995e-3:
        return f"{number(1e3 * value, 2, sign)} m{unit}"
    return f"{number(1e6 * value, 1, sign)} {DEVIATION[unit]}"


def figure(value: float, digits: int = 3, sign: str = "-") -> str:
    """A number with the given count of significant digits, without exponent up to a million: '2970', not '2.97e+03'."""
    text = f"{value:{sign}.{digits}g}"
    return f"{float(text):{sign}.0f}" if "e+" in text and abs(value) < 1e6 else text


def small(value: float, unit: str, digits: int = 3) -> str:
    """A small length or angle [SI] with the given count of digits, in µm or µrad, or mm or mrad."""
    large = abs(value) >= 0.9995e-3
    return f"{figure(value * (1e3 if large else 1e6), digits)} {'m' if large else 'µ'}{unit}"


def size(metres: float) -> str:
    """An error [m] in µm, or in mm from 1 mm; '–' if it is NaN."""
    if not np.isfinite(metres):
        return "–"
    micro = metres * 1e6
    if abs(micro) >= 999.5:
        return f"{metres * 1e3:.2f} mm"
    if abs(micro) >= 99.5:
        return f"{micro:.0f} µm"
    return f"{micro:.1f} µm" if abs(micro) >= 0.05 or micro == 0 else f"{micro:.1e} µm"


def angle(radians: float) -> str:
    """A small rotation [rad] in µrad, or in mrad from 10 mrad; '–' if it is NaN."""
    if not np.isfinite(radians):
        return "–"
    micro = radians * 1e6
    return f"{radians * 1e3:.1f} mrad" if abs(micro) >= 9999.5 else f"{micro:.{1 if abs(micro) < 99.5 else 0}f} µrad"


def round_size(metres: float) -> str:
    """A round length, as on a scale: '10 µm', '1 mm'."""
    return f"{metres * 1e3:g} mm" if metres >= 0.999e-3 else f"{metres * 1e6:g} µm"


def number(value: float, digits: int, sign: str = "-") -> str:
    """A number with a typographic minus sign, without a sign before zero; '–' if it is not finite."""
    if not np.isfinite(value):
        return "–"
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}".replace("-", "−")


def capital(text: str) -> str:
    """The text with its first letter as a capital, as a sentence begins."""
    return text[:1].upper() + text[1:]


def short(text: str, most: int) -> str:
    """The text, cut to the given count of characters."""
    return text if len(text) <= most else text[: most - 1] + "…"


def clipped(text: str, most: int) -> str:
    """A list of sizes, cut behind a whole entry to at most the given count of characters."""
    if len(text) <= most:
        return text
    end = max(text.rfind(mark, 0, most - 1) for mark in (", ", "; "))
    return f"{text[: end + 1]} …" if end > 0 else short(text, most)


def some_lines(numbers: np.ndarray, most: int = 8) -> str:
    """'lines 3, 7, 9, …': at most the given count of lines, and whether there are more."""
    more = ", …" if len(numbers) > most else ""
    return f"line{'s' * (len(numbers) > 1)} {', '.join(str(int(line)) for line in numbers[:most])}{more}"


def lines(numbers: np.ndarray) -> str:
    """'lines 3, 7 and 9'; no more than five are named."""
    said = [str(line) for line in numbers]
    if len(said) == 1:
        return f"line {said[0]}"
    if len(said) > 5:
        said = [*said[:5], f"{len(said) - 5} more"]
    return f"lines {', '.join(said[:-1])} and {said[-1]}"
