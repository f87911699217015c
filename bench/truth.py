"""Truth files (TOML): what is really wrong with a virtual robot, and what instrument looks at it.

The form is in docs/bench.md. A truth that has been used is *sealed*: it then carries its robot, and every geometric
error by its value, so that nothing has to be drawn again.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from bench import faults, sensors
from bench.faults import Fault
from bench.instrument import Instrument
from bench.machine import Machine
from bench.sensors import Sensor
from pcalib import files, units
from pcalib import robot as robots
from pcalib.errors import InputError, unknown
from pcalib.robot import Robot
from pcalib.settings import Setting, is_number, read

SCHEMA = "pcbench.truth/1"
FORM = "see docs/bench.md for the form"
SECTIONS = ("schema", "robot", "geometry", "instrument", "sensors", "faults", "sealed")
DRAWN = (
    Setting("sigma_length", "length", 0.0, 0.0, 0.05, about="1σ of every length and coordinate"),
    Setting("sigma_angle", "angle", 0.0, 0.0, 0.2, about="1σ of every component of a rotation vector"),
    Setting("sigma_ratio", "ratio", 0.0, 0.0, 0.05, about="1σ of every pure number, such as a gear ratio"),
    Setting("seed", "whole", 0, 0.0, about="of the draw"),
)
STREAM = 0x6E0
LARGEST_ERROR = 1.0
"""[m, rad, 1] Largest accepted error of one parameter; a robot with such an error can no longer be assembled."""
_DIMENSIONS = {"m": "length", "rad": "angle", "1": "ratio"}


@dataclass(frozen=True, eq=False)
class Truth:
    """A robot as it really is."""

    robot: Robot
    errors: np.ndarray
    """(nk,) true minus nominal geometric parameters [m, rad, 1]."""
    instrument: Instrument
    faults: tuple[Fault, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    """What measures beside the instrument."""

    @property
    def values(self) -> np.ndarray:
        """(nk,) true geometric parameters."""
        return self.robot.mechanism.nominal + self.errors

    def machine(self) -> Machine:
        """Return the virtual robot.

        Raises:
            ReachError: it cannot be assembled.
            InputError: a fault does not suit this kind of robot.
        """
        return Machine(self.robot, self.values, self.faults)


def load(path: str | Path) -> Truth:
    """Read a truth file; the path of its robot is relative to it.

    Raises:
        InputError: not readable, not TOML, or a key that is missing, unknown, without unit or out of range.
    """
    return parse(files.read_text(path), path)


def parse(text: str, source: str | Path = "truth") -> Truth:
    """Return a truth from the text of its file; `source` names it in messages and gives the folder of its robot
    file."""
    table = files.parse_toml(text, source, FORM)
    with files.locating(text, source, FORM):
        return _from_table(table, Path(source).parent)


def draw_errors(robot: Robot, length: float, angle: float, seed: int, ratio: float = 0.0) -> np.ndarray:
    """Return (nk,) independent normal errors of every raw parameter with 1σ `length` [m], `angle` [rad], `ratio`
    [1]."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
    sigma = {"m": length, "rad": angle, "1": ratio}
    scale = np.array([sigma[unit] for unit in robot.mechanism.units])
    return scale * generator.standard_normal(len(scale))


def dumps(truth: Truth, sealed: Mapping[str, Any] | None = None) -> str:
    """Return the text of a sealed truth file: read again, it gives the same robot to the last bit.

    Args:
        sealed: how it was used, kept for the record under [sealed].
    """
    mechanism = truth.robot.mechanism
    suffix = {"m": "_m", "rad": "_rad", "1": ""}
    errors = {
        name + suffix[unit]: float(error)
        for name, unit, error in zip(mechanism.parameters, mechanism.units, truth.errors, strict=True)
        if error
    }
    table: dict[str, Any] = {"schema": SCHEMA}
    if sealed:
        table["sealed"] = dict(sealed)
    table["geometry"] = {"errors": errors}
    table["instrument"] = truth.instrument.to_table()
    if truth.sensors:
        table["sensors"] = {sensor.name: sensor.to_table() for sensor in truth.sensors}
    table["faults"] = {fault.name: fault.to_table() for fault in truth.faults}
    table["robot"] = tomllib.loads(truth.robot.text)
    return tomli_w.dumps(table)


def _from_table(table: Mapping[str, Any], folder: Path) -> Truth:
    for key in table:
        if key not in SECTIONS:
            raise InputError(unknown("key", key, SECTIONS), key=key)
    if table.get("schema", SCHEMA) != SCHEMA:
        raise InputError(f"schema is '{table['schema']}', not '{SCHEMA}'", key="schema")
    robot = _robot(table.get("robot"), folder)
    for section in ("geometry", "instrument", "sensors", "faults"):
        if not isinstance(table.get(section, {}), dict):
            raise InputError(f"'{section}' must be a section", key=section, remedy=f"write [{section}]")
    made = [faults.make(robot, name, settings) for name, settings in _sections(table, "faults")]
    faults.suit(robot, made)
    instrument = Instrument.from_table(table.get("instrument", {}))
    seen = tuple(sensors.make(name, settings) for name, settings in _sections(table, "sensors"))
    return Truth(robot, _errors(robot, table.get("geometry", {})), instrument, tuple(made), seen)


def _sections(table: Mapping[str, Any], section: str) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, settings in table.get(section, {}).items():
        if not isinstance(settings, dict):
            remedy = f"write [{section}.{name}]"
            raise InputError(f"'{name}' must be a section", section=section, key=name, remedy=remedy)
        yield name, settings


def _robot(given: Any, folder: Path) -> Robot:
    if isinstance(given, str):
        path = Path(given) if Path(given).is_absolute() else folder / given
        if not os.path.exists(path):  # which says no to a name that no file can have
            raise InputError(
                f"robot file '{given}' does not exist in {folder or '.'}", key="robot",
                remedy="the path is relative to the truth file",
            )  # fmt: skip
        with files.named_by(folder / "truth", path, "robot"):
            return robots.load(path)
    if isinstance(given, dict):
        return robots.parse(tomli_w.dumps(given), "[robot]")
    raise InputError("'robot' is missing", remedy='write robot = "delta.toml", or the robot file itself under [robot]')


def _errors(robot: Robot, table: Mapping[str, Any]) -> np.ndarray:
    """Return drawn errors plus listed ones."""
    drawn = read({key: v for key, v in table.items() if key != "errors"}, DRAWN, "geometry", {})
    errors = draw_errors(robot, drawn["sigma_length"], drawn["sigma_angle"], drawn["seed"], drawn["sigma_ratio"])
    return errors + listed_errors(robot, table.get("errors", {}))


def listed_errors(robot: Robot, listed: Any) -> np.ndarray:
    """Return (nk,) errors of a table such as [geometry.errors]: parameter with unit → true minus nominal; others
    zero.

    Raises:
        InputError: no table, an unknown parameter, or a value without unit or that is no number.
    """
    if not isinstance(listed, Mapping):
        remedy = "write [geometry.errors]"
        raise InputError("'errors' must be a section", section="geometry", key="errors", remedy=remedy)
    mechanism = robot.mechanism
    errors = np.zeros(len(mechanism.parameters))
    at = {name: i for i, name in enumerate(mechanism.parameters)}
    given: set[str] = set()
    for key, raw in flat(listed):
        name, unit = (key, None) if key in at else units.split(key)
        dimension = _DIMENSIONS[mechanism.units[at[name]]] if name in at else ""
        remedy = f"write one of {units.spellings(name, dimension)}"
        if name not in at:
            problem, remedy = unknown("parameter", name, at), ""
        elif (unit is None and dimension != "ratio") or (unit is not None and unit.dimension != dimension):
            said = "has no unit" if unit is None else f"'{unit.suffix}' is not a unit of {dimension}"
            problem = f"'{key}': {said}"
        elif not is_number(raw) or abs(raw * (1.0 if unit is None else unit.factor)) > LARGEST_ERROR:
            problem, remedy = f"'{key}' must be a number, and an error below 1 m or 1 rad, not {raw!r:.80}", ""
        elif name in given:
            problem, remedy = f"'{name}' is given twice", "keep one of them"
        else:
            problem = ""
        if problem:
            raise InputError(f"[geometry.errors] {problem}", section="geometry.errors", key=key, remedy=remedy)
        given.add(name)
        errors[at[name]] += raw * (1.0 if unit is None else unit.factor)
    return errors


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Return nested tables as dotted keys again: TOML reads `p1.x_mm = 0.1` without quotes as a table."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value
