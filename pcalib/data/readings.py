"""What sensors read that read no pose, row by row; in files, such readings may stand beside a pose or alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pcalib import sensors, units
from pcalib.data import sigma as sigmas
from pcalib.data.columns import Columns
from pcalib.data.table import Table
from pcalib.sensors.base import Sensor

POSE = ""
"""Name of what reads poses."""
_SHOWN = {"length": "mm", "angle": "deg"}


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of N rows."""

    sensor: np.ndarray
    """(N,) str, name of the sensor that a row was read with; '' where it reads a pose."""
    to: np.ndarray
    """(N,) str, the station or surface that was measured to; '' where there is but one."""
    value: np.ndarray
    """(N, 6) [m, rad] in the places of the sensor's quantities; NaN elsewhere, and in rows that read a pose."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Metadata of the sensors."""
    written: Mapping[str, str] = field(default_factory=dict)
    """Metadata of the sensors as text, as the file has them."""
    origin: np.ndarray | None = None
    """(N,) int, row of the pose from which a distance is measured, −1 where there is none; None: no row has one."""

    def take(self, rows: np.ndarray | slice) -> Readings:
        """The readings of some rows; distances from poses that are not among them lose their other end."""
        origin = None
        if self.origin is not None:
            chosen = np.arange(len(self.sensor))[rows]
            place = np.full(len(self.sensor) + 1, -1)  # the last is that of −1
            place[chosen] = np.arange(len(chosen))
            origin = place[self.origin[rows]]
        return Readings(self.sensor[rows], self.to[rows], self.value[rows], self.options, self.written, origin)

    @property
    def orphan(self) -> np.ndarray:
        """(N,) bool, distances between poses of which the other pose is not here."""
        lone = np.zeros(len(self.sensor), bool) if self.origin is None else self.origin < 0
        return lone & np.isin(self.sensor, [s.name for s in sensors.every() if s.between])

    @property
    def parts(self) -> list[tuple[Sensor, str, np.ndarray]]:
        """Sensor, what is measured to, and rows of all readings that belong together, in the order of their names."""
        if not len(self.sensor):
            return []
        between = [s.name for s in sensors.every() if s.between]
        to = np.where(np.isin(self.sensor, between), "", self.to)
        pairs = sorted({(s, t) for s, t in zip(self.sensor.tolist(), to.tolist(), strict=True) if s != POSE})
        lone = self.orphan
        found = [(sensors.get(s), t, np.flatnonzero((self.sensor == s) & (to == t) & ~lone)) for s, t in pairs]
        return [part for part in found if len(part[2])]

    @staticmethod
    def joined(parts: Sequence[Readings | None], lengths: Sequence[int]) -> Readings | None:
        """The readings of several data sets, one after the other; None where no data set has any."""
        known = [part for part in parts if part is not None]
        if not known:
            return None
        each = [nothing(n) if part is None else part for part, n in zip(parts, lengths, strict=True)]
        options = {k: v for part in known for k, v in part.options.items()}
        written = {k: v for part in known for k, v in part.written.items()}
        sensor, to, value = (np.concatenate([getattr(p, n) for p in each]) for n in ("sensor", "to", "value"))
        if all(part.origin is None for part in each):
            return Readings(sensor, to, value, options, written)
        shift = np.cumsum([0, *lengths])
        origin = np.concatenate([
            np.full(n, -1) if part.origin is None else np.where(part.origin < 0, -1, part.origin + first)
            for part, first, n in zip(each, shift, lengths, strict=False)
        ])  # fmt: skip
        return Readings(sensor, to, value, options, written, origin)


def nothing(n: int) -> Readings:
    """Readings of n rows that read poses."""
    return Readings(np.full(n, POSE, object), np.full(n, "", object), np.full((n, 6), np.nan))


@dataclass(frozen=True)
class SensorReadings:
    """Readings of one sensor in a table."""

    sensor: Sensor
    row: np.ndarray
    """(n,) rows of the table that have one."""
    to: np.ndarray
    """(n,) str."""
    value: np.ndarray
    """(n, 6) [m, rad], NaN where nothing is measured."""
    sigma: np.ndarray
    """(n,) [m or rad]."""
    stated: bool
    """Whether the file states σ."""
    origin: np.ndarray | None = None
    """(n,) int, rows of the table from which is measured; None for other sensors."""


def quantities() -> dict[str, str]:
    """Columns of all sensors that carry a unit → dimension."""
    return {q: d for sensor in sensors.every() for q, (_, d) in sensor.quantities.items()}


def sigma_keys() -> dict[str, str]:
    """Columns and metadata with 1σ of the sensors → dimension."""
    return {s.sigma: next(iter(s.quantities.values()))[1] for s in sensors.every()}


def targets() -> tuple[str, ...]:
    """Columns that name what is measured to."""
    return tuple(s.to for s in sensors.every() if s.to is not None)


def options(table: Table) -> dict[str, object]:
    """The metadata keys of sensors, as they read them.

    Raises:
        InputError: a value that a sensor does not accept.
    """
    out = {}
    for key, text in table.metadata.items():
        for sensor in sensors.every():
            try:
                value = sensor.option(key, text)
            except ValueError as accepted:
                raise table.metadata_error(key, f"metadata '{key}' is {text!r}", f"accepted: {accepted}") from None
            if value is not None:
                out[key] = value
    return out


def find(columns: Columns, sigma: Mapping[str, float | str]) -> list[SensorReadings]:
    """The readings of every sensor that a table has.

    Args:
        sigma: σ of sensors in the metadata [SI].

    Raises:
        InputError: a reading that does not say what it was measured to, or a station of no reading.
    """
    out = []
    table = columns.table
    for sensor in sensors.every():
        given = [q for q in sensor.quantities if q in columns]
        alike = (s for s in sensors.every() if s is not sensor and set(s.quantities) & set(sensor.quantities))
        rival = next((s.to for s in alike if s.to), "")
        if not given or (sensor.between and str(sensor.to) not in columns):
            continue
        value = np.full((len(table), 6), np.nan)
        for q in given:
            value[:, sensor.quantities[q][0]] = columns.si(q, blank=True)
        blank = np.isnan(value[:, [sensor.quantities[q][0] for q in given]])
        row = np.flatnonzero(~blank.all(axis=1) & (blank.any(axis=1) | (not sensor.partial)))
        if rival in columns:  # the reading belongs to whose column says to what
            row = row[[not str(table.texts(rival)[r]).strip() for r in row]]
        to, origin = np.full(len(table), "", object), None
        if sensor.between and len(row):
            row, origin = _origins(table, str(sensor.to), row)
        elif sensor.to is not None and len(row):
            if sensor.to not in columns:
                raise table.error(
                    f"column '{sensor.to}' is missing: it names what {columns.name(given[0])} is measured to",
                    remedy="give each station or surface a name, e.g. A",
                )
            to[:] = [str(cell).strip() for cell in table.texts(sensor.to)]
            lacking = row[to[row] == ""]
            if len(lacking):
                raise table.error(
                    f"{columns.name(given[0])} is given and no {sensor.to}", row=int(lacking[0]), column=sensor.to,
                    remedy="name what it is measured to, e.g. A",
                )  # fmt: skip
        own = sigmas.stated(columns, sensor.sigma, sigma.get(sensor.sigma), sensor.usual_sigma)
        each = sensor.usual_sigma if own is None else own
        out.append(SensorReadings(
            sensor, row, to[row], value[row], np.broadcast_to(each, len(table))[row].astype(float), own is not None,
            origin,
        ))  # fmt: skip
    return [found for found in out if len(found.row)]


def _origins(table: Table, column: str, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows that say from which pose they measure, and the first row of that pose.

    Raises:
        InputError: a pose that no row has.
    """
    first: dict[str, int] = {}
    if "pose_id" in table.columns:
        for i, cell in enumerate(table.texts("pose_id")):
            first.setdefault(str(cell).strip(), i)
    named = [str(cell).strip() for cell in table.texts(column)]
    row = row[[bool(named[r]) for r in row]]
    for r in row:
        if named[r] not in first:
            raise table.error(
                f"there is no pose '{named[r]}'", row=int(r), column=column, remedy="name a pose_id of the file"
            )
    return row, np.array([first[named[r]] for r in row], int)


def from_poses(readings: Readings) -> dict[str, list[str]]:
    """The column that names the poses from which distances are measured; none where there are none."""
    if readings.origin is None:
        return {}
    return {"from": [str(t) if o >= 0 else "" for o, t in zip(readings.origin, readings.to, strict=True)]}


def to_measure(readings: Readings) -> dict[str, list[str]]:
    """Columns of a plan that say what each row is to be measured with: the sensor, and the station or surface."""
    out = {"sensor": [str(name) for name in readings.sensor]}
    for sensor in dict.fromkeys(sensor for sensor, _, _ in readings.parts):
        if sensor.to is not None and not sensor.between:
            out[sensor.to] = _named(readings, sensor, out.get(sensor.to))
    return out


def _named(readings: Readings, sensor: Sensor, before: Sequence[str] | None) -> list[str]:
    """What a sensor measures to, row by row, beside what stood there `before`."""
    rest = [""] * len(readings.sensor) if before is None else before
    return [str(t) if s == sensor.name else b for s, t, b in zip(readings.sensor, readings.to, rest, strict=True)]


def to_write(
    readings: Readings, sigma: np.ndarray, stated: tuple[bool, bool], poses: Mapping[str, np.ndarray | list[str]]
) -> dict[str, np.ndarray | list[str]]:
    """Columns of a file that hold the readings.

    Args:
        poses: columns of rows that read poses, beside which readings may stand.
        sigma: (N, 6) [m, rad].
        stated: whether σ of lengths and of angles is stated.
    """
    out: dict[str, np.ndarray | list[str]] = {}
    named: dict[str, list[str]] = {}
    for sensor in dict.fromkeys(sensor for sensor, _, _ in readings.parts):
        mine = readings.sensor == sensor.name
        for q, (place, dimension) in sensor.quantities.items():
            unit = units.UNITS[_SHOWN[dimension]]
            name = f"{q}_{unit.suffix}"
            rest = poses.get(name, np.full(len(mine), np.nan))
            out[name] = np.where(mine, readings.value[:, place] / unit.factor, np.asarray(rest, float))
        if sensor.to is not None and not sensor.between:
            named[sensor.to] = _named(readings, sensor, named.get(sensor.to))
        place, dimension = next(iter(sensor.quantities.values()))
        if stated[place // 3]:
            unit = units.UNITS[_SHOWN[dimension]]
            each = sigma[:, place] / unit.factor
            out[f"{sensor.sigma}_{unit.suffix}"] = each if sensor.partial else np.where(mine, each, np.nan)
    return out | named
