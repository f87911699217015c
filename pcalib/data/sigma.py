"""σ of readings in files: as stated, by default, with the noise of an instrument, and written again."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pcalib import units
from pcalib.data import columns as cols
from pcalib.data.columns import Columns
from pcalib.data.instrument import Instrument

DEFAULT_SIGMA_POS = 15e-6
"""[m] 1σ per component taken where a file states none: a laser tracker at arm's length."""
DEFAULT_SIGMA_ROT = 60e-6
"""[rad] 1σ per component taken where a file states none."""
KEYS = {"sigma_pos": "length", "sigma_rot": "angle"}
AXES = {f"sigma_{axis}": dimension for axis, dimension in zip(
    ("x", "y", "z", "rx", "ry", "rz"), ("length",) * 3 + ("angle",) * 3, strict=True
)}  # fmt: skip
"""σ of single components along and about the axes of the measuring frame, such as the depth of a camera."""
_SHOWN = {"length": "mm", "angle": "deg"}
_AXES = (slice(0, 3), slice(3, 6))
_ROUNDING = 1e-9
"""Two variances that differ by less than this share are equal: files keep some fifteen digits."""


def stated(
    columns: Columns, key: str, common: float | str | None, usual: float | None = None
) -> np.ndarray | float | None:
    """σ of each row: its own, else that of the metadata; None where the file states none.

    Args:
        usual: σ of rows that are blank in a file whose metadata state none; None: no row may be blank there.
    """
    every = None if common is None else float(common)
    if key not in columns:
        return every
    name, rest = columns.name(key), usual if every is None else every
    values = columns.si(key, blank=rest is not None)
    if (values < cols.SMALLEST_SIGMA).any():
        row = int(np.argmax(values < cols.SMALLEST_SIGMA))
        raise columns.table.error("σ must be positive", row=row, column=name, remedy="e.g. 0.02")
    return values if rest is None else np.where(np.isnan(values), rest, values)


def of_axes(columns: Columns, key: str, said: Mapping[str, float | str]) -> np.ndarray | float | None:
    """σ of positions or of rotations: one number, (N,) by row, or (N, 3) where components have their own; None where
    the file states none."""
    common = stated(columns, key, said.get(key))
    names = list(AXES)[_AXES[list(KEYS).index(key)]]
    each = [stated(columns, name, said.get(name)) for name in names]
    if all(one is None for one in each):
        return common
    rest = (DEFAULT_SIGMA_POS if KEYS[key] == "length" else DEFAULT_SIGMA_ROT) if common is None else common
    n = len(columns.table)
    return np.stack([np.broadcast_to(rest if one is None else one, n) for one in each], axis=1)


def complete(
    position: np.ndarray,
    turn: np.ndarray,
    tool: np.ndarray,
    sigma_pos: ArrayLike | None,
    sigma_rot: ArrayLike | None,
    instrument: Instrument | None,
) -> tuple[np.ndarray, np.ndarray | None, tuple[bool, bool]]:
    """(N, 6) σ of all readings, their (N, 6, 6) correlation, None where there is none, and which σ are stated.

    A stated σ and the instrument's noise add up. A default stands only where neither is stated.
    """
    given = (sigma_pos, sigma_rot)
    told = [value is not None for value in given]
    sigma = np.empty((len(position), 6))
    for axes, value, default in zip(_AXES, given, (DEFAULT_SIGMA_POS, DEFAULT_SIGMA_ROT), strict=True):
        one = np.asarray(default if value is None else value, float)
        sigma[:, axes] = one if one.ndim == 2 else np.broadcast_to(one, len(sigma))[:, None]
    if instrument is None:
        return sigma, None, (told[0], told[1])
    whole = instrument.covariance(position, turn, tool)
    by_instrument = (True, len(instrument.reflectors) > 0)
    for axes, own, other in zip(_AXES, told, by_instrument, strict=True):
        if other and not own:
            sigma[:, axes] = 0.0
    whole += sigma[:, :, None] ** 2 * np.eye(6)
    sigma = np.sqrt(np.diagonal(whole, axis1=1, axis2=2))
    return sigma, whole / (sigma[:, :, None] * sigma[:, None, :]), (True, told[1] or by_instrument[1])


def beside(sigma: np.ndarray, instrument: Instrument | None, *pose: np.ndarray) -> np.ndarray:
    """(N, 6) the part of σ that the instrument's noise at a pose (position, rotation, tool) does not contain."""
    if instrument is None:
        return sigma
    own = np.diagonal(instrument.covariance(*pose), axis1=1, axis2=2)
    rest = sigma**2 - own
    return np.sqrt(np.where(np.abs(rest) < _ROUNDING * own, 0.0, rest))


def to_write(mask: np.ndarray, sigma: np.ndarray, key: str) -> dict[str, float | np.ndarray]:
    """Names and values of σ in a file: a number where all rows share it, else (N,); components have their own names
    where they differ."""
    axes = _AXES[list(KEYS).index(key)]
    unit = units.UNITS[_SHOWN[KEYS[key]]]
    seen = np.where(mask[:, axes], sigma[:, axes], np.nan)
    if not np.nan_to_num(seen, nan=0.0).any():
        return {}
    row = sigma[:, axes.start].copy()
    some = np.flatnonzero(~np.isnan(seen).all(axis=1))
    row[some] = np.nanmax(seen[some], axis=1)
    named = {key: row}
    if np.any(np.nan_to_num(np.abs(seen - row[:, None])) > np.sqrt(_ROUNDING) * row[:, None]):
        named = dict(zip(list(AXES)[axes], sigma[:, axes].T, strict=True))
    out: dict[str, float | np.ndarray] = {}
    for name, values in named.items():
        alike = np.ptp(values[some]) == 0
        out[f"{name}_{unit.suffix}"] = (values[some][0] if alike else values) / unit.factor
    return out
