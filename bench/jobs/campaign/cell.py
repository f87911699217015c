"""One cell of a campaign, every number of it fixed: geometry, poses, instrument, faults, methods, verification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import tomli_w

from bench import faults
from bench import plan as plans
from bench.instrument import Instrument
from bench.jobs import methods as ladder
from bench.jobs.campaign import geometry
from bench.jobs.campaign.geometry import GeometryErrors
from bench.jobs.campaign.random_faults import RandomFault
from bench.jobs.methods import Method
from pcalib import compensation, effects, settings, units
from pcalib import robot as robots
from pcalib.errors import EffectError, InputError, unknown
from pcalib.fitting import identification
from pcalib.robot import Robot
from pcalib.settings import Setting

KINDS = (*plans.NAMES, "joint", "d-optimal")
"""Where poses come from: the bench's plans; 'joint': uniform in joint space; 'd-optimal': those that tell most."""
POSES = (
    Setting("kind", "word", "random", words=KINDS, about="where poses come from"),
    Setting("poses", "whole", 40, 1, 100_000, about="how many are measured"),
    Setting("candidates", "whole", 600, 10, 100_000, about="poses that 'd-optimal' chooses from"),
    Setting("inside", "number", 1.0, 0.1, 1.0, about="size of the part of the workspace that random poses keep to"),
)
VERIFY = (
    Setting("targets", "whole", 200, 1, 100_000, about="TCP positions per tool"),
    Setting("places", "word", "random", words=("random", "border", "grid", "rings"), about="where in the workspace"),
    Setting("spacing", "length", 0.0, 0.0, 10.0, about="of a grid, which has as many targets as fit"),
    Setting("payload", "mass", 0.0, 0.0, 1e3, about="carried while verifying"),
    Setting("temp", "temperature", 20.0, -100.0, 200.0, about="of the robot while verifying"),
)
METHOD = (
    Setting("name", "word", about="how tables call it"),
    Setting("level", "word", "", about="geometry level"),
    Setting("fit", "word", "map", words=identification.METHODS, about="how it is identified"),
    Setting("compensation", "word", "exact", words=compensation.METHODS, about="how commands are found"),
    Setting("loss", "word", "linear", words=identification.LOSSES, about="robust or not"),
    Setting("weighted", "flag", True, about="whether residuals are divided by σ"),
    Setting("reads", "word", "pose", words=ladder.READS, about="what it uses of the data"),
)
DEFAULT_METHODS = tuple(method.name for method in ladder.LADDER if method.identifies)
_PAYLOAD = Setting("payload", "mass", 0.0, 0.0, 1e3, about="carried while measuring")
OUTPUT = (
    Setting("part_robots", "whole", 10, 1, 10_000, about="robots per part: what a kill can cost at most"),
    Setting("map_robots", "whole", 200, 0, 10_000, about="robots per cell whose error at every target is kept"),
)
REGRESS = (
    Setting("accuracy", "number", 0.02, 0.0, 10.0, about="relative change of a figure that counts"),
    Setting("floor", "length", 1e-8, 0.0, 1.0, about="absolute change below which nothing counts"),
    Setting("speed", "number", 1.6, 1.0, 100.0, about="factor of the time per robot, in units of a reference task"),
)
SECTIONS = ("robot", "geometry", "instrument", "plan", "faults", "method", "verify")
"""Keys of a spec that make a cell, and may be swept."""


@dataclass(frozen=True)
class Poses:
    """Which poses are measured: the section [plan]."""

    kind: str
    poses: int
    candidates: int
    inside: float
    """Radius and height of the cylinder that random poses keep to, in those of the workspace."""
    tools: np.ndarray
    """(T, 3) [m] measured points in the plate frame, dealt out evenly."""
    payloads: tuple[float, ...]
    """[kg] dealt out likewise; those of the kind of plan where empty."""
    listed: Mapping[str, Any] | None = None
    """The plan itself where it came from a file, see :func:`bench.jobs.campaign.samples.listed`."""

    @property
    def source(self) -> str:
        """Where the poses come from, as the spec says it."""
        return "file" if self.listed is not None else f'kind = "{self.kind}"'

    def columns(self, robot: Robot) -> set[str]:
        """The columns that have a number in every row, beside commands, tools and payloads."""
        if self.listed is None:
            return set(plans.columns(self.kind, len(robot.mechanism.actuators)))
        return {name for name, values in self.listed["columns"].items() if np.isfinite(np.array(values, float)).all()}


@dataclass(frozen=True)
class Verify:
    """Where and how the calibrated robot is checked."""

    targets: int
    """Number of targets at random places; a grid and rings have numbers of their own."""
    places: str
    spacing: float
    """[m] between points of a grid; 0: a fifth of the workspace's radius."""
    payload: float
    """[kg]"""
    temp: float
    """[°C]"""
    tools: np.ndarray
    """(T, 3) [m] TCPs in the plate frame."""


@dataclass(frozen=True)
class Output:
    """How much is kept, and in which pieces."""

    part_robots: int
    map_robots: int


@dataclass(frozen=True)
class Regress:
    """What `pcbench regress` takes for a regression."""

    accuracy: float
    floor: float
    """[m]"""
    speed: float


@dataclass(frozen=True, eq=False)
class Cell:
    """What one combination of the sweeps' values asks for."""

    robot: Robot
    geometry: GeometryErrors
    poses: Poses
    instrument: Instrument
    faults: tuple[RandomFault, ...]
    methods: tuple[Method, ...]
    verify: Verify


def read(table: Mapping[str, Any]) -> Cell:
    """A cell from the SECTIONS of a spec; files that it names have been put in their places.

    Raises:
        InputError: a key or value that cannot be used.
    """
    tables = {key: section(table, key) for key in ("geometry", "instrument", "plan", "faults", "verify")}
    if "robot" not in table:
        raise InputError("'robot' is missing", remedy='write robot = "delta", or the path of a robot file')
    robot = _robot(tomli_w.dumps(table["robot"]))
    rest, tools = _tools(tables["verify"], "verify", default=[0.0, 0.1, 0.3])
    out = Cell(
        robot=robot,
        geometry=geometry.read(tables["geometry"], robot),
        poses=_poses(tables["plan"]),
        # A laser tracker with a 6-D target at arm's length where the section is absent.
        instrument=Instrument.from_table(tables["instrument"] or {"sigma_pos_mm": 0.02, "sigma_rot_deg": 0.005}),
        faults=_faults(tables["faults"], robot),
        methods=_methods(table.get("method", []), robot),
        verify=Verify(**settings.read(rest, VERIFY, "verify", {}), tools=tools),
    )
    _require_columns(out)
    return out


_robot = lru_cache(maxsize=8)(lambda text: robots.parse(text, "robot"))


def section(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """A section of a spec, empty where it is absent.

    Raises:
        InputError: the key is no section.
    """
    found = table.get(key, {})
    if not isinstance(found, Mapping):
        name = key if key != "faults" else "faults.NAME"
        raise InputError(f"'{key}' must be a section", column=key, remedy=f"write [{name}]")
    return found


def _poses(table: Mapping[str, Any]) -> Poses:
    """[plan]."""
    if "listed" in table:
        alone = [key for key in table if key not in ("listed", "file")]
        if alone:
            raise InputError(
                f"[plan] file brings its own poses, tools and payloads: leave out {', '.join(alone)}", column="file"
            )
        return Poses("file", len(table["listed"]["q"]), 0, 1.0, np.zeros((1, 3)), (), table["listed"])
    rest, tools = _tools(table, "plan", default=[0.0])
    payloads: list[float] = []
    for key in [key for key in rest if key.startswith("payloads")]:
        given = rest.pop(key)
        if not isinstance(given, list) or not given or payloads:
            raise InputError(f"[plan] '{key}' must be one list of masses, not {given!r}", column=key)
        single = key.replace("payloads", "payload", 1)
        payloads = [settings.read({single: value}, (_PAYLOAD,), "plan", {})["payload"] for value in given]
    return Poses(**settings.read(rest, POSES, "plan", {}), tools=tools, payloads=tuple(payloads))


def _methods(tables: Any, robot: Robot) -> tuple[Method, ...]:
    """[[method]] …, the four usual ones where there are none."""
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise InputError("'method' must be written as [[method]]", column="method")
    out: list[Method] = []
    levels = robot.mechanism.levels
    for number, table in enumerate(tables or [{"name": name} for name in DEFAULT_METHODS], 1):
        where = f"method[{number}]"
        name = table.get("name")
        usual = ladder.BY_NAME.get(name) if isinstance(name, str) else None
        known = {s.name: getattr(usual, s.name) for s in METHOD} if usual else {}
        plain = {key: value for key, value in table.items() if key != "effects"}  # a list, which settings do not know
        for key in plain:
            if key not in [s.name for s in METHOD]:
                names = [*(s.name for s in METHOD), "effects"]
                raise InputError(f"[{where}] {unknown('key', key, names)}", column=key)
        values = settings.read({**known, **plain}, METHOD, where, {})
        if not values["level"]:
            raise InputError(
                f"[{where}] 'level' is missing, and '{name}' is not one of the methods that need none: "
                f"{', '.join(ladder.BY_NAME)}", column="name", remedy=f"write level = one of {', '.join(levels)}",
            )  # fmt: skip
        if values["level"] not in levels:
            raise InputError(f"[{where}] level: {unknown('level', values['level'], levels)}", column="level")
        if values["name"] in [m.name for m in out]:
            raise InputError(f"[{where}] name: '{values['name']}' is taken by an earlier method", column="name")
        out.append(replace(Method(**values), effects=_effects(table.get("effects", []), where, robot)))
    return tuple(out)


def _effects(given: Any, where: str, robot: Robot) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
        raise InputError(f"[{where}] 'effects' must be a list of names, not {given!r}", column="effects")
    for spec in given:
        try:
            effects.parse(spec, robot)
        except (EffectError, InputError) as error:
            raise InputError(f"[{where}] effects: {error}", column="effects") from None
    return tuple(given)


def _faults(tables: Mapping[str, Any], robot: Robot) -> tuple[RandomFault, ...]:
    """[faults.NAME] …"""
    out = []
    for name, table in tables.items():
        if name not in faults.names():
            raise InputError(f"[faults] {unknown('fault', name, faults.names())}", column=name)
        if not isinstance(table, Mapping):
            raise InputError(f"[faults] '{name}' must be a section", column=name, remedy=f"write [faults.{name}]")
        out.append(RandomFault.of(robot, name, table))
    return tuple(out)


def _require_columns(read: Cell) -> None:
    """Refuse faults and effects that need columns which the plan does not bring: every robot would fail."""
    robot, poses = read.robot, read.poses
    asked = [(f"[faults.{fault.name}]", f"faults.{fault.name}", fault.needs) for fault in read.faults]
    for number, method in enumerate(read.methods, 1):
        for spec in method.effects:
            asked.append((f"[method[{number}]] effects: {spec}", "effects", effects.parse(spec, robot).needs))
    brought = poses.columns(robot)
    for where, column, needs in asked:
        lacking = [name for name in needs if name not in brought]
        if lacking:
            suited = [kind for kind in KINDS if {*lacking} <= {*plans.columns(kind, len(robot.mechanism.actuators))}]
            kinds = "".join(f'kind = "{kind}", or ' for kind in suited)
            raise InputError(
                f"{where} needs columns that [plan] {poses.source} does not bring: {', '.join(lacking)}", column=column,
                remedy=f"write {kinds}file = a CSV with numbers there in every row",
            )  # fmt: skip


def _tools(table: Mapping[str, Any], where: str, default: Sequence[float]) -> tuple[dict[str, Any], np.ndarray]:
    """The rest of a table, and its tools (T, 3) [m]: lengths below the plate, or vectors in the plate frame."""
    keys = [key for key in table if key == "tools" or units.split(key)[0] == "tools" or key.startswith("tools_")]
    try:
        found = units.resolve(keys, {"tools": "length"})
    except InputError as error:
        raise error.but(problem=f"[{where}] {error.problem}", section=where) from None
    rest = {key: value for key, value in table.items() if key not in keys}
    if not found:
        return rest, np.array([[0.0, 0.0, -h] for h in default])
    key, factor = found["tools"]
    wrong = InputError(
        f"[{where}] '{key}' must be a list of lengths below the plate or of vectors, not {table[key]!r}", column=key,
        remedy=f"for example {key} = [0, 100, 300] or {key} = [[0, 0, -100]]",
    )  # fmt: skip
    given = table[key]
    if not isinstance(given, list) or not given:
        raise wrong
    vectors = [item if isinstance(item, list) else [0.0, 0.0, item] for item in given]
    if any(len(v) != 3 or not all(map(settings.is_number, v)) for v in vectors):
        raise wrong
    sign = [1.0 if isinstance(item, list) else -1.0 for item in given]
    tools = factor * np.array(sign)[:, None] * np.array(vectors, float) + 0.0  # no −0
    if np.abs(tools).max() > 10.0:
        raise wrong
    if len(np.unique(tools, axis=0)) != len(tools):
        raise InputError(f"[{where}] '{key}' names a tool twice", column=key)
    return rest, tools
