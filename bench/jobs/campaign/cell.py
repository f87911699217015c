"""One cell of a campaign, every number of it fixed: geometry, plan, instrument, faults, methods, verification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w

from bench import faults
from bench import plan as plans
from bench.instrument import Instrument
from bench.jobs.campaign import geometry
from bench.jobs.campaign.geometry import Geometry
from bench.jobs.campaign.random_faults import RandomFault
from pcalib import compensation, settings, units
from pcalib import robot as robots
from pcalib.errors import Code, EffectError, InputError, unknown
from pcalib.fitting import identification
from pcalib.robot import Robot
from pcalib.settings import Setting

PLANS = (*plans.NAMES, "d-optimal")
PLAN = (
    Setting("kind", "word", "random", words=PLANS, about="where poses come from"),
    Setting("poses", "whole", 40, 1, 100_000, about="how many are measured"),
    Setting("candidates", "whole", 600, 10, 100_000, about="poses that 'd-optimal' chooses from"),
)
VERIFY = (
    Setting("targets", "whole", 200, 1, 100_000, about="TCP positions per tool"),
    Setting("places", "word", "random", words=("random", "border", "grid"), about="where in the workspace"),
    Setting("spacing", "length", 0.0, 0.0, 10.0, about="of a grid, which has as many targets as fit"),
    Setting("payload", "mass", 0.0, 0.0, 1e3, about="carried while verifying"),
    Setting("temp", "temperature", 20.0, -100.0, 200.0, about="of the robot while verifying"),
)
READS = ("pose", "position")
METHOD = (
    Setting("name", "word", about="how tables call it"),
    Setting("level", "word", "", about="geometry level"),
    Setting("fit", "word", "map", words=identification.METHODS, about="how it is identified"),
    Setting("compensation", "word", "exact", words=compensation.METHODS, about="how commands are found"),
    Setting("loss", "word", "linear", words=identification.LOSSES, about="robust or not"),
    Setting("weighted", "flag", True, about="whether residuals are divided by σ"),
    Setting("reads", "word", "pose", words=READS, about="what it uses of the data"),
)
PRESETS: dict[str, dict[str, Any]] = {
    "nominal": {"level": "nominal"},
    "classical": {"level": "classical", "fit": "base"},
    "model24": {"level": "model24", "fit": "base"},
    "paper": {"level": "complete", "fit": "linear", "compensation": "first-order"},
    "complete": {"level": "complete", "fit": "map"},
}
"""Methods that a spec may name without saying more; 'paper' is Savoure et al.'s linear step."""
DEFAULT_METHODS = ("classical", "model24", "paper", "complete")
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


@dataclass(frozen=True)
class Plan:
    """Which poses are measured."""

    kind: str
    poses: int
    candidates: int
    tools: np.ndarray
    """(T, 3) [m] measured points in the plate frame, dealt out evenly."""
    payloads: tuple[float, ...]
    """[kg] dealt out likewise; those of the kind of plan where empty."""
    listed: Mapping[str, Any] | None = None
    """The plan itself where it came from a file, see :func:`bench.jobs.campaign.samples.listed`."""

    @property
    def source(self) -> str:
        """Where its poses come from, as the spec says it."""
        return "file" if self.listed is not None else f'kind = "{self.kind}"'

    def columns(self, robot: Robot) -> set[str]:
        """What it brings, with a number in every row, beside commands, tools and payloads."""
        if self.listed is None:
            return set(plans.columns(self.kind, len(robot.mechanism.actuators)))
        return {name for name, values in self.listed["columns"].items() if np.isfinite(np.array(values, float)).all()}


@dataclass(frozen=True)
class Method:
    """One way to calibrate and to command."""

    name: str
    level: str
    fit: str
    compensation: str
    loss: str
    weighted: bool
    reads: str
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verify:
    """Where and how the calibrated robot is checked."""

    targets: int
    """Of random places; a grid has its own number."""
    places: str
    spacing: float
    """[m] of a grid; 0: a fifth of the workspace's radius."""
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
    geometry: Geometry
    plan: Plan
    instrument: Instrument
    faults: tuple[RandomFault, ...]
    methods: tuple[Method, ...]
    verify: Verify

    @property
    def rigid(self) -> bool:
        """Whether the true robot has geometric errors only."""
        return not self.faults


SECTIONS = ("robot", "geometry", "instrument", "plan", "faults", "method", "verify")
"""Keys of a spec that make a cell, and may be swept."""


def read(table: Mapping[str, Any]) -> Cell:
    """A cell from the SECTIONS of a spec; files that it names have been put in their places.

    Raises:
        InputError: a key or value that cannot be used.
    """
    for key in ("geometry", "instrument", "plan", "faults", "verify"):
        if not isinstance(table.get(key, {}), Mapping):
            raise InputError(f"'{key}' must be a section", column=key, remedy=f"write [{key}]")
    if "robot" not in table:
        raise InputError("'robot' is missing", remedy='write robot = "delta", or the path of a robot file')
    robot = robots.parse(tomli_w.dumps(table["robot"]), "robot")
    out = Cell(
        robot=robot,
        geometry=geometry.read(table.get("geometry", {}), robot),
        plan=plan(table.get("plan", {})),
        instrument=instrument(table.get("instrument", {})),
        faults=random_faults(table.get("faults", {}), robot),
        methods=methods(table.get("method", []), robot),
        verify=verify(table.get("verify", {})),
    )
    _require_columns(out)
    return out


def plan(table: Mapping[str, Any]) -> Plan:
    """[plan]."""
    if "listed" in table:
        alone = [key for key in table if key not in ("listed", "file")]
        if alone:
            raise InputError(
                f"[plan] file brings its own poses, tools and payloads: leave out {', '.join(alone)}", column="file"
            )
        return Plan("file", len(table["listed"]["q"]), 0, np.zeros((1, 3)), (), table["listed"])
    table, tools = _tools(table, "plan", default=[0.0])
    table, payloads = _payloads(table)
    return Plan(**settings.read(table, PLAN, "plan", {}), tools=tools, payloads=payloads)


def verify(table: Mapping[str, Any]) -> Verify:
    """[verify]."""
    table, tools = _tools(table, "verify", default=[0.0, 0.1, 0.3])
    return Verify(**settings.read(table, VERIFY, "verify", {}), tools=tools)


def methods(tables: Sequence[Mapping[str, Any]], robot: Robot) -> tuple[Method, ...]:
    """[[method]] …, the four usual ones where there are none."""
    out: list[Method] = []
    for number, table in enumerate(tables or [{"name": name} for name in DEFAULT_METHODS], 1):
        where = f"method[{number}]"
        name = table.get("name")
        preset = PRESETS.get(name, {}) if isinstance(name, str) else {}
        given = {**preset, **{key: value for key, value in table.items() if key != "effects"}}
        try:
            values = settings.read(given, METHOD, where, {})
        except InputError as error:
            if error.code is Code.UNKNOWN_KEY:  # 'effects' is a list, which settings do not know
                raise error.but(problem=f"{error.problem}, effects") from None
            raise
        levels = robot.mechanism.levels
        if not values["level"]:
            raise InputError(
                f"[{where}] 'level' is missing, and '{name}' is not one of the methods that need none: "
                f"{', '.join(PRESETS)}", column="name", remedy=f"write level = one of {', '.join(levels)}",
            )  # fmt: skip
        if values["level"] not in levels:
            raise InputError(f"[{where}] level: {unknown('level', values['level'], levels)}", column="level")
        if values["name"] in [m.name for m in out]:
            raise InputError(f"[{where}] name: '{values['name']}' is taken by an earlier method", column="name")
        out.append(Method(**values, effects=_effects(table.get("effects", []), where, robot)))
    return tuple(out)


def instrument(table: Mapping[str, Any]) -> Instrument:
    """[instrument], as in truth files; a laser tracker with a 6-D target at arm's length where it is absent."""
    return Instrument.from_table(table if table else {"sigma_pos_mm": 0.02, "sigma_rot_deg": 0.005})


def random_faults(tables: Any, robot: Robot) -> tuple[RandomFault, ...]:
    """[faults.NAME] …"""
    if not isinstance(tables, Mapping):
        raise InputError("'faults' must be a section", column="faults", remedy="write [faults.NAME]")
    out = []
    for name, table in tables.items():
        if name not in faults.names():
            raise InputError(f"[faults] {unknown('fault', name, faults.names())}", column=name)
        if not isinstance(table, Mapping):
            raise InputError(f"[faults] '{name}' must be a section", column=name, remedy=f"write [faults.{name}]")
        out.append(RandomFault.of(robot, name, table))
    return tuple(out)


def output(table: Mapping[str, Any]) -> Output:
    """[output]."""
    return Output(**settings.read(table, OUTPUT, "output", {}))


def regress(table: Mapping[str, Any]) -> Regress:
    """[regress]."""
    return Regress(**settings.read(table, REGRESS, "regress", {}))


def _effects(given: Any, where: str, robot: Robot) -> tuple[str, ...]:
    from pcalib import effects

    if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
        raise InputError(f"[{where}] 'effects' must be a list of names, not {given!r}", column="effects")
    for spec in given:
        try:
            effects.parse(spec, robot)
        except (EffectError, InputError) as error:
            raise InputError(f"[{where}] effects: {error}", column="effects") from None
    return tuple(given)


def _require_columns(read: Cell) -> None:
    """Refuse faults and effects that need columns which the plan does not bring: every robot would fail."""
    from pcalib import effects

    robot, plan = read.robot, read.plan
    asked = [(f"[faults.{fault.name}]", f"faults.{fault.name}", fault.needs) for fault in read.faults]
    for number, method in enumerate(read.methods, 1):
        for spec in method.effects:
            asked.append((f"[method[{number}]] effects: {spec}", "effects", effects.parse(spec, robot).needs))
    brought = plan.columns(robot)
    for where, column, needs in asked:
        lacking = [name for name in needs if name not in brought]
        if not lacking:
            continue
        fitting = [kind for kind in PLANS if {*lacking} <= {*plans.columns(kind, len(robot.mechanism.actuators))}]
        told = ", ".join(lacking)
        kinds = "".join(f'kind = "{kind}", or ' for kind in fitting)
        raise InputError(
            f"{where} needs columns that [plan] {plan.source} does not bring: {told}", column=column,
            remedy=f"write {kinds}file = a CSV with numbers there in every row",
        )  # fmt: skip


def _payloads(table: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[float, ...]]:
    """The rest of [plan], and its payloads [kg]."""
    rest, out = dict(table), []
    for key in [key for key in table if key.startswith("payloads")]:
        given = rest.pop(key)
        if not isinstance(given, list) or not given or out:
            raise InputError(f"[plan] '{key}' must be one list of masses, not {given!r}", column=key)
        for value in given:
            one = settings.read({key.replace("payloads", "payload", 1): value}, (_PAYLOAD,), "plan", {})
            out.append(one["payload"])
    return rest, tuple(out)


def _tools(
    table: Mapping[str, Any], where: str, default: Sequence[float]
) -> tuple[dict[str, Any], np.ndarray]:
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
    out = []
    for item in given:
        vector = item if isinstance(item, list) else [0.0, 0.0, item]
        if len(vector) != 3 or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in vector):
            raise wrong
        out.append([v * factor for v in vector] if isinstance(item, list) else [0.0, 0.0, -vector[2] * factor])
    tools = np.array(out, float) + 0.0  # no −0
    if not np.isfinite(tools).all() or np.abs(tools).max() > 10.0:
        raise wrong
    if len(np.unique(tools, axis=0)) != len(tools):
        raise InputError(f"[{where}] '{key}' names a tool twice", column=key)
    return rest, tools
