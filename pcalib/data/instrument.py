"""What a file states of its instrument, and the covariance of readings that follows from it.

Three statements add up: σ per component (`sigma_pos`, `sigma_rot`), a laser tracker's range and angle, and reflectors
whose measured places give the pose by a rigid fit. The last two make the readings of a row correlated.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pcalib import rotation
from pcalib.data.table import Table, is_number

_LENGTHS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
_ANGLES = {"urad": 1e-6, "mrad": 1e-3, "rad": 1.0, "deg": np.pi / 180, "arcsec": np.pi / 648000}
_NUMBERS = {
    **{f"sigma_range_{unit}": ("sigma_range", factor) for unit, factor in _LENGTHS.items()},
    "sigma_range_ppm": ("sigma_range_ratio", 1e-6),
    **{f"sigma_angle_{unit}": ("sigma_angle", factor) for unit, factor in _ANGLES.items()},
    **{f"sigma_reflector_{unit}": ("sigma_reflector", factor) for unit, factor in _LENGTHS.items()},
    **{f"tracker_{axis}_{unit}": (f"tracker_{axis}", f) for axis in "xyz" for unit, f in _LENGTHS.items()},
}
_REFLECTORS = {f"reflectors_{unit}": factor for unit, factor in _LENGTHS.items()}
_USUAL = ("sigma_range_um", "sigma_angle_urad", "sigma_reflector_um", *(f"tracker_{axis}_mm" for axis in "xyz"))
KEYS = {
    key: next((usual for usual in _USUAL if usual.startswith(quantity)), key)
    for key, (quantity, _) in _NUMBERS.items()
} | dict.fromkeys(_REFLECTORS, "reflectors_mm")
"""Metadata keys of an instrument, each with its usual spelling."""
_FLAT = 0.02
"""Ratio of the reflectors' second to their first principal extent from which on they fix a rotation about every axis:
1° off a line."""


@dataclass(frozen=True)
class Instrument:
    """1σ of an instrument's own readings [m, rad], and where it stands."""

    sigma_range: float = 0.0
    """[m] along the line of sight, and"""
    sigma_range_ratio: float = 0.0
    """further σ per distance, independent of it."""
    sigma_angle: float = 0.0
    """[rad] 1σ of both angles: σ across the line of sight over the distance."""
    station: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) [m] where the tracker stands, measuring frame."""
    sigma_reflector: float = 0.0
    """[m] per component of every reflector's place."""
    reflectors: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(K, 3) [m] reflectors from which a pose is computed, plate frame; none where the instrument reads poses."""

    def of_points(self, point: np.ndarray) -> np.ndarray:
        """Covariance (…, 3, 3) [m²] of measured points (…, 3) [m], measuring frame."""
        away = point - self.station
        distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-12)[..., None, None]
        sight = away[..., :, None] * away[..., None, :] / distance**2
        along = self.sigma_range**2 + (self.sigma_range_ratio * distance) ** 2
        across = (self.sigma_angle * distance) ** 2
        return along * sight + across * (np.eye(3) - sight) + self.sigma_reflector**2 * np.eye(3)

    def covariance(self, position: np.ndarray, turn: np.ndarray, tool: np.ndarray) -> np.ndarray:
        """Covariance (N, 6, 6) of readings x y z rx ry rz [m, rad], measuring frame.

        With reflectors at places b_i and a pose (x, R) fitted to their measured places p_i by least squares, a small
        error e of the places moves the pose by (δx, δθ) = A⁺·e with A_i = [I, −hat(R·(b_i − tool))].

        Args:
            position: (N, 3) [m]; a component that is not measured counts as the median of the others of its column.
            turn: (N, 3, 3) plate → measuring frame; where it is not measured, the plate counts as not turned.
            tool: (N, 3) [m] the measured point, plate frame.
        """
        known = ~np.isnan(position)
        columns = zip(position.T, known.T, self.station, strict=True)
        middle = np.array([np.median(x[k]) if k.any() else own for x, k, own in columns])
        point = np.where(known, position, middle)
        out = np.zeros((len(point), 6, 6))
        if not len(self.reflectors):
            out[:, :3, :3] = self.of_points(point)
            return out
        R = np.where(np.isnan(turn), np.eye(3), turn)
        lever = (self.reflectors - tool[:, None]) @ np.swapaxes(R, -1, -2)  # (N, K, 3)
        A = np.concatenate([np.broadcast_to(np.eye(3), (*lever.shape, 3)), -rotation.hat(lever)], axis=-1)
        A = A.reshape(len(point), -1, 6)
        each = self.of_points(point[:, None] + lever)  # (N, K, 3, 3)
        plus = np.linalg.pinv(A).reshape(len(point), 6, -1, 3)
        return np.einsum("nikc,nkcd,njkd->nij", plus, each, plus)

    def metadata(self, frame: str) -> dict[str, str]:
        """The keys that state this instrument in a file."""
        out = {}
        for key, factor, value in (
            ("sigma_range_um", 1e-6, self.sigma_range), ("sigma_range_ppm", 1e-6, self.sigma_range_ratio),
            ("sigma_angle_urad", 1e-6, self.sigma_angle), ("sigma_reflector_um", 1e-6, self.sigma_reflector),
        ):  # fmt: skip
            if value:
                out[key] = f"{value / factor:.15g}"
        if self.sigma_angle and frame == "base":
            out |= {f"tracker_{'xyz'[i]}_mm": f"{value * 1e3:.15g}" for i, value in enumerate(self.station)}
        if len(self.reflectors):
            out["reflectors_mm"] = "; ".join(" ".join(f"{c * 1e3:.15g}" for c in point) for point in self.reflectors)
        return out


def read(table: Table, frame: str) -> Instrument | None:
    """The instrument that a file's metadata state; None where they state none.

    Raises:
        InputError: a value that is no number, a quantity given twice, or a statement that is not complete.
    """
    given: dict[str, float] = {}
    used: dict[str, str] = {}
    points, wrong = np.zeros((0, 3)), table.metadata_error
    for key in table.metadata:
        if key not in KEYS:
            continue
        quantity, factor = _NUMBERS.get(key) or ("reflectors", _REFLECTORS[key])
        if quantity in used:
            raise wrong(key, f"'{quantity}' is given twice: '{used[quantity]}' and '{key}'", "keep one of them")
        used[quantity] = key
        text = table.metadata[key]
        if key in _REFLECTORS:
            rows = [part.split() for part in text.split(";")]
            if len(rows) < 3 or any(len(row) != 3 or not all(map(_finite, row)) for row in rows):
                raise wrong(
                    key, f"metadata '{key}' must hold three reflectors or more, not {text!r}",
                    "write x y z of each in the plate frame, e.g. 30 0 -10; -30 0 -10; 0 40 -10",
                )  # fmt: skip
            points = np.array(rows, float) * factor
            extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
            if extent[1] < _FLAT * extent[0] or extent[0] == 0:
                raise wrong(key, f"the reflectors of '{key}' lie on one line, which fixes no rotation about it", "")
            continue
        if not _finite(text) or (quantity[:7] != "tracker" and not float(text) > 0):
            what = "number" if quantity[:7] == "tracker" else "positive number"
            raise wrong(key, f"metadata '{key}' must be a {what}, not {text!r}", "e.g. 15")
        given[quantity] = float(text) * factor
    if not used:
        return None
    station = [given.pop(f"tracker_{axis}", None) for axis in "xyz"]
    first = next(iter(used.values()))
    ranged = "sigma_range" in given or "sigma_range_ratio" in given
    if ranged != ("sigma_angle" in given):
        raise wrong(
            first, "σ of range and of angle belong together",
            "state sigma_range_um (or sigma_range_ppm, or both) and sigma_angle_urad",
        )  # fmt: skip
    if ranged and frame == "base" and None in station:
        raise wrong(
            first, "σ of range and angle needs the place of the tracker in the base frame",
            "state tracker_x_mm, tracker_y_mm and tracker_z_mm, or # frame = tracker",
        )  # fmt: skip
    if len(points) and not (ranged or "sigma_reflector" in given):
        raise wrong(first, "the reflectors have no σ", "state sigma_reflector_um, or σ of range and angle")
    if not len(points) and "sigma_reflector" in given:
        raise wrong(first, "sigma_reflector needs the reflectors' places", "state reflectors_mm = x y z; x y z; x y z")
    if not ranged and not len(points):
        raise wrong(first, "the tracker's place is stated without its σ", "state sigma_range_um and sigma_angle_urad")
    origin = frame == "tracker" or None in station
    return Instrument(**given, station=np.zeros(3) if origin else np.array(station, float), reflectors=points)


def _finite(text: str) -> bool:
    return is_number(text) and bool(np.isfinite(float(text))) and abs(float(text)) < 1e12
