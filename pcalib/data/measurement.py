"""Measurement files: what the controller commanded, what the instrument saw, and under which conditions.

The form of the file is in docs/files.md; the same table is read from CSV and from Parquet.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pcalib import rotation, units
from pcalib.data import columns as cols
from pcalib.data import instrument as instruments
from pcalib.data import orientation, plausibility, spelling
from pcalib.data import readings as sensed
from pcalib.data import sigma as sigmas
from pcalib.data import table as tables
from pcalib.data.columns import Columns
from pcalib.data.instrument import Instrument
from pcalib.data.readings import Readings, SensorReadings
from pcalib.data.table import Table, is_number
from pcalib.errors import InputError
from pcalib.robot import Robot
from pcalib.shown import Tabled

FRAMES = {"base": "base", "tracker": "tracker", "artefact": "tracker"}
"""Measuring frames that a file may name, and how they are handled: an artefact's place is as unknown as a tracker's."""
MOST_ROUNDS = 1000
"""Largest number of rounds of measuring that a file may state: more is a mistake."""
MOST_PPM = 1e4
"""[ppm] σ of a scale from which on it is a mistake: one per cent."""
MOST_BETWEEN = 2000
"""Rows of a file with distances between poses: fits of more rows go chunk by chunk, and would part the poses."""
_UNIT = {"length": "mm", "angle": "deg", "mass": "kg", "temperature": "degC", "time": "s"}


TARGET_STATED, TARGET_UNSTATED = 5e-4, 1e-2
"""[m] 1σ of the place of a tracker's target where the file states tool points, as drawings and callipers have them, and
where it states none: then the target sits near the plate's origin. A target that may be anywhere would take up what a
missing effect does with the tilt of the plate, and commands would miss by that."""


@dataclass(frozen=True, eq=False)
class Measurements(Tabled):
    """N measured poses, SI."""

    q: np.ndarray
    """(N, nq) [rad or m], commanded actuator values."""
    position: np.ndarray
    """(N, 3) [m], measured point in the measuring frame; NaN where not measured."""
    rotation: np.ndarray
    """(N, 3, 3), plate → measuring frame; NaN where not measured."""
    mask: np.ndarray
    """(N, 6) bool, which of x y z rx ry rz is measured, rotation all or nothing; in rows of a sensor, which of three
    lengths and three angles it reads."""
    tool: np.ndarray
    """(N, 3) [m], the measured point in the plate frame."""
    payload: np.ndarray
    """(N,) [kg] at the tool point."""
    columns: Mapping[str, np.ndarray]
    """Further numbers, (N,), by quantity without unit: temp_arms, temp_rods, temp_base, temp [°C], time [s], dir1 …;
    the user's own under their full name and as they stand in the file."""
    pose_id: np.ndarray
    """(N,) int, rows with one id are replicates; −1: none."""
    check: np.ndarray
    """(N,) bool, held out: never used for fitting."""
    sigma: np.ndarray
    """(N, 6) [m, rad] 1σ of the instrument."""
    stated: tuple[bool, bool]
    """Whether the file states σ of positions and of rotations; where it does not, `sigma` holds the default."""
    lines: np.ndarray
    """(N,) int, line of each row in its file."""
    frame: str = "base"
    """'base', or 'tracker': then the registration is unknown."""
    robot_name: str = ""
    actuators: tuple[str, ...] = ("q1", "q2", "q3")
    actuator_dimension: str = "angle"
    source: str = "measurements"
    """The file, for messages."""
    notes: Mapping[str, np.ndarray] = field(default_factory=dict)
    """The user's own columns of text, (N,)."""
    correlation: np.ndarray | None = None
    """(N, 6, 6) correlation of each row's readings; None where they are independent."""
    instrument: Instrument | None = None
    """What the file states of the instrument beyond σ per component; `sigma` and `correlation` hold it already."""
    rounds: int = 1
    """Rounds of measuring that are joined in it: each is one more look at whether something is missing."""
    sigma_target: float = 0.0
    """[m] 1σ of the place of a tracker's target about the stated tool point; 0 where the file does not say."""
    sigma_scale: float = 0.0
    """1σ of the instrument's scale, as its certificate says: the relative error that all lengths share."""
    date: datetime.date | None = None
    """Day of the session, where the file says it."""
    written: np.ndarray | None = None
    """(N, 3) [rad] or (N, 4) the numbers of rx ry rz or qw qx qy qz as the file has them, so that another reading of
    them can be tried; None where there are none, or where the rotations were made in memory."""
    euler: str = ""
    """Order of turns where `written` holds Euler angles."""
    readings: Readings | None = None
    """What rows read that read no pose; their position and rotation are NaN. None where all rows read poses."""

    def __len__(self) -> int:
        return len(self.q)

    def __post_init__(self) -> None:
        n, nq = self.q.shape
        shapes = {
            "position": (n, 3), "rotation": (n, 3, 3), "mask": (n, 6), "tool": (n, 3), "payload": (n,),
            "pose_id": (n,), "check": (n,), "sigma": (n, 6), "lines": (n,),
        }  # fmt: skip
        if self.correlation is not None:
            shapes["correlation"] = (n, 6, 6)
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, not {shape}")
        if len(self.actuators) != nq or any(len(v) != n for v in (*self.columns.values(), *self.notes.values())):
            raise ValueError(f"actuators and columns do not match q {self.q.shape}")

    @classmethod
    def create(
        cls,
        robot: Robot,
        q: ArrayLike,
        position: ArrayLike,
        rotation: ArrayLike | None = None,
        *,
        tool: ArrayLike | None = None,
        payload: ArrayLike = 0.0,
        columns: Mapping[str, ArrayLike] | None = None,
        pose_id: ArrayLike | None = None,
        check: ArrayLike | None = None,
        sigma_pos: ArrayLike | None = None,
        sigma_rot: ArrayLike | None = None,
        instrument: Instrument | None = None,
        frame: str = "base",
        source: str = "measurements",
        readings: Readings | None = None,
        sigma_readings: ArrayLike | None = None,
    ) -> Measurements:
        """Measurements made in memory; everything but `q` and `position` may be left out.

        Args:
            q: (N, nq) [rad or m].
            position: (N, 3) [m], NaN where not measured.
            rotation: (N, 3, 3), NaN where not measured; None: position only.
            tool: (3,) or (N, 3) [m]; payload: number or (N,) [kg].
            sigma_pos: [m], sigma_rot: [rad], numbers, (N,), or (N, 3) by component; None: not stated.
            instrument: noise of a tracker or of reflectors, which adds to these.
            readings: of sensors that read no pose, in rows whose position and rotation are NaN.
            sigma_readings: [m, rad] of these, a number or (N,) or (N, 6); None: as usual for each, not stated.
        """
        q, position = np.array(q, float), np.array(position, float)
        n = len(q)
        if position.shape != (n, 3):
            raise ValueError(f"position has shape {position.shape}, not {(n, 3)}")
        turn = np.full((n, 3, 3), np.nan) if rotation is None else np.array(rotation, float)
        mask = _mask(position, turn)
        tool = np.array(np.broadcast_to(0.0 if tool is None else tool, (n, 3)), float)
        sigma, correlation, stated = sigmas.complete(position, turn, tool, sigma_pos, sigma_rot, instrument)
        if readings is not None:
            given = ~np.isnan(readings.value)
            own = None if sigma_readings is None else np.array(sigma_readings, float)
            own = own[:, None] if own is not None and own.ndim == 1 else own
            for sensor, _, rows in readings.parts:
                sigma[rows] = sensor.usual_sigma if own is None else np.broadcast_to(own, (n, 6))[rows]
            told = own is not None
            lengths, angles = (
                (was or not mask[:, part].any()) and (told or not given[:, part].any())
                for was, part in zip(stated, (slice(0, 3), slice(3, 6)), strict=True)
            )
            stated = (bool(lengths), bool(angles))
            mask = mask | given
        return cls(
            q, position, turn, mask, tool=tool,
            payload=np.array(np.broadcast_to(payload, n), float),
            columns={name: np.array(values, float) for name, values in (columns or {}).items()},
            pose_id=np.full(n, -1) if pose_id is None else np.array(pose_id, int),
            check=np.zeros(n, bool) if check is None else np.array(check, bool),
            sigma=sigma, stated=stated, lines=np.arange(1, n + 1), frame=frame, robot_name=robot.name,
            actuators=robot.mechanism.actuators, actuator_dimension=robot.mechanism.actuator_dimension, source=source,
            correlation=correlation, instrument=instrument, readings=readings,
        )  # fmt: skip

    def take(self, rows: np.ndarray | slice) -> Measurements:
        """The measurements of some rows: a mask, indices or a slice."""
        one = ("q", "position", "rotation", "tool", "payload", "pose_id", "check", "sigma", "lines")
        readings, mask = None if self.readings is None else self.readings.take(rows), self.mask[rows]
        if readings is not None and readings.origin is not None:
            mask = mask & ~readings.orphan[:, None]
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in one},
            mask=mask,
            columns={name: values[rows] for name, values in self.columns.items()},
            notes={name: values[rows] for name, values in self.notes.items()},
            correlation=None if self.correlation is None else self.correlation[rows],
            written=None if self.written is None else self.written[rows],
            readings=readings,
        )

    def whole(self, rows: np.ndarray) -> np.ndarray:
        """Rows (n,) and those from which their distances are measured, ascending."""
        if self.readings is None or self.readings.origin is None:
            return rows
        return np.union1d(rows, self.readings.origin[rows][self.readings.origin[rows] >= 0])

    @property
    def turned(self) -> np.ndarray:
        """(N,) bool, rows with a measured rotation."""
        return ~np.isnan(self.rotation[:, 0, 0])

    @property
    def values(self) -> np.ndarray:
        """(N, 6) [m, rad] all that is read: positions, rotation vectors, and what sensors read; NaN elsewhere."""
        out = np.full(self.mask.shape, np.nan)
        out[:, :3] = self.position
        out[self.turned, 3:] = rotation.log(self.rotation[self.turned])
        return out if self.readings is None else np.where(np.isnan(self.readings.value), out, self.readings.value)

    def beside(self, other: Measurements) -> np.ndarray:
        """(N, 6) [m, rad] by how much the readings differ from those of N other rows; NaN where one of them is."""
        out = self.values - other.values
        both = self.turned & other.turned
        out[both, 3:] = rotation.log(self.rotation[both] @ rotation.transposed(other.rotation[both]))
        return out

    @property
    def covariance(self) -> np.ndarray | None:
        """(N, 6, 6) [m, rad] covariance of each row's readings; None where they are independent."""
        if self.correlation is None:
            return None
        return self.correlation * self.sigma[:, :, None] * self.sigma[:, None, :]

    @property
    def target_known(self) -> float:
        """[m] 1σ of the place of a tracker's target: as stated, or what is usual for stated tools and for none."""
        return self.sigma_target or (TARGET_STATED if self.tool.any() else TARGET_UNSTATED)

    @property
    def sigma_stated(self) -> bool:
        """Whether the file states σ of all that it measures."""
        return all(said or not seen for said, seen in zip(self.stated, self.kinds, strict=True))

    @property
    def kinds(self) -> tuple[bool, bool]:
        """Whether any component of a position and any rotation is measured."""
        return bool(self.mask[:, :3].any()), bool(self.mask[:, 3:].any())

    @property
    def fit_rows(self) -> np.ndarray:
        """Indices of the rows to fit."""
        return np.flatnonzero(~self.check)


def load(path: str | Path, robot: Robot | None = None, measured: bool = True) -> Measurements:
    """Read a measurement file, Parquet where its name ends with .parquet, else CSV.

    Args:
        robot: supplies the actuators, and the joint range and workspace that values must keep to; without it the
            actuators are those of the header and values are not judged.
        measured: whether readings must be in it; a file of commands has none.

    Raises:
        InputError: whatever cannot be used, with file, line, column and remedy.
    """
    table = spelling.read(path)
    spelling.require_commands(table)
    names, dimension = cols.actuators(table, robot)
    plain = (*orientation.QUATERNION, *(f"dir{i + 1}" for i in range(len(names))), "pose_id", "set", *sensed.targets())
    keys = sigmas.KEYS | sigmas.AXES | sensed.sigma_keys()
    wanted = dict.fromkeys(names, dimension) | cols.POSITION | cols.ROTATION | cols.CONDITIONS
    columns = cols.assign(table, wanted | keys | sensed.quantities(), plain, len(names))
    cols.require(columns, dict.fromkeys(names, dimension), "it holds the commanded actuator values")
    options = sensed.options(table)
    plainly = {key: key for key in ("date", "rounds", "sigma_scale_ppm")}
    others = instruments.KEYS | plainly | dict.fromkeys(options, "surface_A")
    said = cols.metadata(table, keys | {"sigma_target": "length"}, ("frame", "robot", "euler"), others)
    frame = said.get("frame", "base")
    if frame not in FRAMES:
        raise table.metadata_error("frame", f"frame '{frame}' is unknown", f"accepted: {', '.join(FRAMES)}")
    frame = FRAMES[str(frame)]
    found = sensed.find(columns, said)

    q = columns.matrix(names)
    position = _position(columns, robot, optional=bool(found) or not measured)
    turn, written = orientation.read(columns, robot, said.get("euler"), in_part=frame == "base")
    mask = _mask(position, turn)
    tool = cols.tool(columns)
    numeric, text = cols.conditions(columns, len(names))
    instrument = instruments.read(table, str(frame))
    point = np.zeros_like(position) if tool is None else tool
    pos, rot = (sigmas.of_axes(columns, key, said) for key in sigmas.KEYS)
    sigma, correlation, stated = sigmas.complete(position, turn, point, pos, rot, instrument)
    if robot is not None:
        plausibility.joints(columns, robot, q)
        if tool is not None:
            plausibility.tools(columns, robot, tool)
        if frame == "base":
            turned = np.where(np.isnan(turn), np.eye(3), turn)
            plausibility.positions(columns, robot, position - (turned @ point[..., None])[..., 0])
    data = Measurements(
        q, position, turn, mask,
        tool=point, payload=cols.payload(columns), columns=numeric, pose_id=pose_ids(table), check=held_out(table),
        sigma=sigma, stated=stated, lines=table.lines, frame=str(frame), robot_name=str(said.get("robot", "")),
        actuators=names, actuator_dimension=dimension, source=table.source, notes=text,
        correlation=correlation, instrument=instrument, date=_date(table), written=written,
        rounds=_rounds(table), sigma_scale=_sigma_scale(table), sigma_target=float(said.get("sigma_target", 0.0)),
        euler=str(said.get("euler", "")),
    )  # fmt: skip
    return _with_readings(data, found, options, {key: table.metadata[key] for key in options}) if found else data


def _with_readings(
    data: Measurements, found: Sequence[SensorReadings], options: Mapping[str, object], written: Mapping[str, str]
) -> Measurements:
    """The data with a row of its own for what each sensor reads, after that of the pose if one is read beside it."""
    seen = np.unique(np.concatenate([part.row for part in found]))
    poses = np.flatnonzero(data.mask.any(axis=1) | ~np.isin(np.arange(len(data)), seen))
    # Each distance between poses has a row of its own for the other pose, before it, so that subsets keep both.
    pairs = [part for part in found if part.origin is not None]
    ends = np.concatenate([np.zeros(0, int), *(part.origin for part in pairs if part.origin is not None)]).astype(int)
    after = np.concatenate([np.zeros(0, int), *(part.row for part in pairs)]).astype(int)
    line = np.concatenate([poses, *(part.row for part in found), after])
    source = np.concatenate([poses, *(part.row for part in found), ends])
    last = len(source) - len(ends)
    order = np.argsort(line - 0.5 * (np.arange(len(line)) >= last), kind="stable")
    if len(ends) and len(order) > MOST_BETWEEN:
        raise InputError(
            f"{len(order)} rows with distances between poses", file=data.source, remedy=f"at most {MOST_BETWEEN}"
        )
    empty, rest = sensed.nothing(len(poses)), sensed.nothing(len(ends))
    name = np.concatenate([empty.sensor, *(np.full(len(p.row), p.sensor.name, object) for p in found), rest.sensor])
    to = np.concatenate([empty.to, *(_called(p, data.pose_id) for p in found), rest.to])
    value = np.concatenate([empty.value, *(part.value for part in found), rest.value])
    origin = None
    if len(ends):
        place = np.empty(len(order), int)
        place[order] = np.arange(len(order))
        origin = np.full(len(order), -1)
        first = len(poses)
        for part in found:
            if part.origin is not None:
                start = last + sum(len(p.row) for p in pairs[: pairs.index(part)])
                origin[place[first : first + len(part.row)]] = place[start : start + len(part.row)]
            first += len(part.row)
    all_read = Readings(name[order], to[order], value[order], options, written, origin)
    out = data.take(source[order])
    if len(ends):
        lone = (np.arange(len(source)) >= last)[order]
        out = replace(
            out, pose_id=np.where(lone, -1, out.pose_id), check=np.where(lone, data.check[line[order]], out.check),
            lines=np.where(lone, data.lines[line[order]], out.lines),
        )  # fmt: skip
    own = np.isin(np.arange(len(source)), np.arange(len(poses)), invert=True)[order]
    each = (np.repeat(part.sigma[:, None], 6, axis=1) for part in found)
    sigma = np.concatenate([data.sigma[poses], *each, data.sigma[ends]])[order]
    lengths, angles = (
        (data.stated[c] or not data.kinds[c])
        and all(part.stated or np.isnan(part.value[:, axes]).all() for part in found)
        for c, axes in enumerate((slice(0, 3), slice(3, 6)))
    )
    correlation = out.correlation
    if correlation is not None:
        correlation = np.where(own[:, None, None], np.eye(6), correlation)
    blank = own[:, None]
    return replace(
        out, position=np.where(blank, np.nan, out.position), rotation=np.where(blank[..., None], np.nan, out.rotation),
        mask=np.where(blank, ~np.isnan(all_read.value), out.mask), sigma=sigma, correlation=correlation,
        stated=(bool(lengths), bool(angles)), readings=all_read,
        written=None if out.written is None else np.where(blank, np.nan, out.written),
    )  # fmt: skip


def _called(part: SensorReadings, pose_id: np.ndarray) -> np.ndarray:
    """(n,) the station or surface of each reading; for distances between poses, the id of the other pose."""
    return part.to if part.origin is None else np.array([str(i) for i in pose_id[part.origin]], object)


def _date(table: Table) -> datetime.date | None:
    """The metadata `# date = 2026-06-01`."""
    text = table.metadata.get("date")
    if text is None:
        return None
    try:
        return datetime.date.fromisoformat(text.strip()[:10])
    except ValueError:
        remedy = "write year-month-day, e.g. # date = 2026-06-01"
        raise table.metadata_error("date", f"'{text}' is no date", remedy) from None


def _rounds(table: Table) -> int:
    """The metadata `# rounds = 2`."""
    text = table.metadata.get("rounds", "1").strip()
    if not (text.isascii() and text.isdigit() and 1 <= int(text[:5]) <= MOST_ROUNDS and len(text) <= 4):
        problem = f"rounds = {text} is no number of rounds of measuring"
        raise table.metadata_error("rounds", problem, f"write a whole number from 1 to {MOST_ROUNDS}")
    return int(text)


def _sigma_scale(table: Table) -> float:
    """The metadata `# sigma_scale_ppm = 5`."""
    text = table.metadata.get("sigma_scale_ppm", "0")
    value = float(text) if is_number(text) else np.nan
    if not 0 <= value < MOST_PPM:
        problem = f"sigma_scale_ppm = {text} is no 1σ of an instrument's scale"
        remedy = "write half of the expanded uncertainty (k = 2) of its certificate, in µm per metre, e.g. 5"
        raise table.metadata_error("sigma_scale_ppm", problem, remedy)
    return value * 1e-6


def save(path: str | Path, data: Measurements) -> None:
    """Write a measurement file, atomically: Parquet where the name ends with .parquet, else CSV.

    Raises:
        InputError: the file cannot be written.
    """
    tables.write(path, *written(data))


def instrument_metadata(data: Measurements) -> dict[str, str]:
    """Metadata of further rows by the same instrument: its frame and the order of Euler angles, where they are not the
    usual ones. σ needs no line: joined rows have that of the others."""
    frame = {} if data.frame == "base" else {"frame": data.frame}
    return frame | ({"euler": data.euler} if data.euler else {})


def written(data: Measurements) -> tuple[dict[str, np.ndarray | list[str]], dict[str, str]]:
    """Columns and metadata of the file that holds the measurements.

    Raises:
        InputError: no file can hold them.
    """
    if data.correlation is not None and data.instrument is None:
        raise InputError(
            "the readings of a row are correlated by no instrument that one file can state",
            remedy="keep measurements with different instruments in files of their own",
        )
    n = len(data)
    out: dict[str, np.ndarray | list[str]] = {}

    def put(quantity: str, dimension: str, values: np.ndarray) -> None:
        unit = units.UNITS[_UNIT[dimension]]
        out[f"{quantity}_{unit.suffix}"] = values / unit.factor

    for name, values in zip(data.actuators, data.q.T, strict=True):
        put(name, data.actuator_dimension, values)
    posed = np.ones(n, bool) if data.readings is None else data.readings.sensor == sensed.POSE
    if data.readings is None or data.mask[posed].any():
        for i, name in enumerate(cols.POSITION):
            put(name, "length", np.where(data.mask[:, i], data.position[:, i], np.nan))
    turned = data.turned
    if turned.any():
        vector = np.full((n, 3), np.nan)
        vector[turned] = rotation.log(data.rotation[turned])
        for i, name in enumerate(cols.ROTATION):
            put(name, "angle", vector[:, i])
    if data.tool.any():
        for i, name in enumerate(cols.TOOL):
            put(name, "length", data.tool[:, i])
    if data.payload.any():
        put("payload", "mass", data.payload)
    common = data.columns.get("temp")
    for name, values in data.columns.items():
        if name in cols.TEMPERATURES and common is not None and np.array_equal(values, common):
            continue
        dimension = cols.CONDITIONS.get(name)
        if dimension:
            put(name, dimension, values)
        else:
            out[name] = values
    if (data.pose_id >= 0).any():
        out["pose_id"] = [str(i) if i >= 0 else "" for i in data.pose_id]
    if data.check.any():
        out["set"] = ["check" if held else "fit" for held in data.check]
    head = {"robot": data.robot_name, "frame": data.frame} if data.robot_name else {"frame": data.frame}
    if data.sigma_target:
        head["sigma_target_mm"] = f"{data.sigma_target * 1e3:.15g}"
    if data.sigma_scale:
        head["sigma_scale_ppm"] = f"{data.sigma_scale * 1e6:.15g}"
    if data.rounds > 1:
        head["rounds"] = str(data.rounds)
    if data.date is not None:
        head["date"] = data.date.isoformat()
    if data.instrument is not None:
        head |= data.instrument.metadata(data.frame)
    sigma = sigmas.beside(data.sigma, data.instrument, data.position, data.rotation, data.tool)
    if data.readings is not None:
        out |= sensed.to_write(data.readings, data.sigma, data.stated, out)
        out |= sensed.from_poses(data.readings)
        head |= data.readings.written
    for key, stated in zip(sigmas.KEYS, data.stated, strict=True):
        for name, value in (sigmas.to_write(data.mask & posed[:, None], sigma, key) if stated else {}).items():
            if isinstance(value, np.ndarray):
                out[name] = value
            else:
                head[name] = f"{value:.15g}"
    out |= {name: [str(v) for v in values] for name, values in data.notes.items()}
    if data.readings is not None and data.readings.origin is not None:  # rows for other ends are made on reading
        keep = np.setdiff1d(np.arange(n), data.readings.origin[data.readings.origin >= 0])
        out = {name: [v[i] for i in keep] if isinstance(v, list) else v[keep] for name, v in out.items()}
    return out, head


def _mask(position: np.ndarray, turn: np.ndarray) -> np.ndarray:
    turned = ~np.isnan(turn.sum(axis=(1, 2)))
    return np.concatenate([~np.isnan(position), np.repeat(turned[:, None], 3, axis=1)], axis=1)


def _position(columns: Columns, robot: Robot | None, optional: bool = False) -> np.ndarray:
    """(N, 3) [m]; a column may be absent only where the plate cannot move that way, or all where they are optional."""
    free = (0, 1, 2) if robot is None else robot.mechanism.plate_dofs
    needed = {name: "length" for i, name in enumerate(cols.POSITION) if i in free}
    if not optional or any(name in columns for name in cols.POSITION):
        cols.require(columns, needed, "it holds the measured position, blank where not measured")
    nothing = np.full(len(columns.table), np.nan)
    return np.stack([columns.si(c, blank=True) if c in columns else nothing for c in cols.POSITION], axis=1)


def pose_ids(table: Table) -> np.ndarray:
    """(N,) int; whole numbers as they are, words numbered in order of appearance, blank is −1."""
    if "pose_id" not in table.columns:
        return np.full(len(table), -1)
    cells = table.texts("pose_id")
    try:
        return np.array([int(cell) if cell else -1 for cell in cells], np.int64)
    except (ValueError, OverflowError):
        number: dict[str, int] = {}
        return np.array([number.setdefault(cell, len(number)) if cell else -1 for cell in cells])


def held_out(table: Table) -> np.ndarray:
    """(N,) bool: set = check.

    Raises:
        InputError: a cell that is neither fit nor check.
    """
    if "set" not in table.columns:
        return np.zeros(len(table), bool)
    cells = table.texts("set")
    for row, cell in enumerate(cells):
        if cell not in ("fit", "check"):
            raise table.error(f"{cell!r} is no set", row=row, column="set", remedy="write fit or check")
    return np.array([cell == "check" for cell in cells])
