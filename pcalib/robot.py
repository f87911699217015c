"""Robot files: a robot's kind, nominal dimensions, joint range, masses and workspace.

This is a description only; the kinematics live in the mechanism that the kind builds from it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pcalib import kinds, units
from pcalib.errors import InputError, unknown
from pcalib.mechanics.mechanism import Mechanism

_FORM = "see models/delta.toml for the form"
STANDARD_GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Workspace:
    """Working cylinder about the base's z axis [m], and how far the plate may turn in it."""

    radius: float
    z_min: float
    z_max: float
    tilt: float = 0.0
    """[rad] largest angle of the plate's z axis from that of the base, where a robot commands it."""
    yaw: float = 0.0
    """[rad] largest turn about the base's z axis either way, where a robot commands it."""

    def contains(self, position: np.ndarray, slack: float = 1e-9) -> np.ndarray:
        """Which positions (N, 3) lie inside."""
        r = np.hypot(position[..., 0], position[..., 1])
        z = position[..., 2]
        return (r <= self.radius + slack) & (z >= self.z_min - slack) & (z <= self.z_max + slack)


@dataclass(frozen=True, eq=False)
class Robot:
    """The content of a robot file, in SI units."""

    name: str
    kind: str
    dimensions: Mapping[str, Any]
    """[geometry], lists as arrays."""
    joint_min: float
    joint_max: float
    mass: Mapping[str, float]
    """[mass]: arm, arm_com, rod, plate, … [kg, m]; empty where the file has none."""
    workspace: Workspace
    gravity: np.ndarray = field(default_factory=lambda: STANDARD_GRAVITY.copy())
    """(3,) [m/s²], base frame."""
    drive: Mapping[str, Any] = field(default_factory=dict)
    """[drive], e.g. ripple_per_turn."""
    text: str = ""
    """The file itself: a model file carries it, and so needs no second file."""
    revolutions: bool = False
    """Whether commands are counted in motor revolutions: so where [joints] is in them."""

    @cached_property
    def mechanism(self) -> Mechanism:
        """Topology, parameter names and nominal values."""
        return kinds.get(self.kind).build(self.dimensions)

    @property
    def joint_range(self) -> tuple[float, float]:
        """Smallest and largest actuator value [rad or m]."""
        return self.joint_min, self.joint_max

    @property
    def command_unit(self) -> str:
        """Unit of the commands in files: 'deg', 'rev' or 'mm'."""
        if self.mechanism.actuator_dimension == "length":
            return "mm"
        return "rev" if self.revolutions else "deg"


def load(path: str | Path) -> Robot:
    """Read a robot file (TOML).

    Raises:
        InputError: not readable, not TOML, or a key that is missing, unknown, without unit or out of range.
    """
    from pcalib.files import read_text

    return parse(read_text(path), path)


def parse(text: str, source: str | Path = "robot") -> Robot:
    """A robot from the text of its file; `source` names it in messages."""
    from pcalib.files import parse_toml

    table = parse_toml(text, source, _FORM)
    try:
        return from_table(table, text)
    except InputError as error:
        if error.file is not None:
            raise
        line, remedy = _line_of(text, error), error.remedy or _FORM
        raise InputError(error.problem, file=source, line=line, remedy=remedy) from None


def from_table(table: Mapping[str, Any], text: str = "") -> Robot:
    """A robot from its parsed TOML table."""
    sections = ["name", "kind", "geometry", "joints", "mass", "workspace", "gravity", "drive"]
    for key in table:
        if key not in sections:
            raise InputError(unknown("key", key, sections), column=key)
    for key in ("name", "kind"):
        if not isinstance(table.get(key), str):
            raise InputError(f"'{key}' is missing or not text", column=key, remedy=f'write {key} = "delta"')
    kind = kinds.get(table["kind"])
    dimensions = _section(table, "geometry", dict(kind.dimensions), kind.optional)
    joint = kind.build(dimensions).actuator_dimension
    joints = _section(table, "joints", {"min": joint, "max": joint})
    if not joints["min"] < joints["max"]:
        raise InputError("[joints] min must be below max", column="min")
    cylinder = {"radius": "length", "z_min": "length", "z_max": "length", "tilt": "angle", "yaw": "angle"}
    workspace = _section(table, "workspace", cylinder, frozenset({"tilt", "yaw"}))
    if not (workspace["z_min"] < workspace["z_max"] and workspace["radius"] > 0):
        raise InputError("[workspace] needs z_min below z_max and a positive radius", column="radius")
    mass = _section(table, "mass", dict(kind.masses)) if "mass" in table else {}
    for key, value in mass.items():
        if value < 0:
            raise InputError(f"[mass] {key} is negative", column=key)
    gravity = STANDARD_GRAVITY.copy()
    if "gravity" in table:
        gravity = _section(table, "gravity", {"vector[]": "acceleration"})["vector"]
        if gravity.shape != (3,):
            raise InputError("[gravity] vector_m_s2 needs three numbers", column="vector")
    drive = _drive(table["drive"]) if "drive" in table else {}
    robot = Robot(
        table["name"], table["kind"], dimensions, joints["min"], joints["max"], mass, Workspace(**workspace),
        gravity, drive, text, all(key.endswith("_rev") for key in table["joints"]),
    )
    _ = robot.mechanism  # a robot that cannot be built is a bad file, and is said so here
    return robot


def _section(
    table: Mapping[str, Any], name: str, schema: dict[str, str], optional: frozenset[str] = frozenset()
) -> dict[str, Any]:
    """One [section] in SI: every key of the schema once, nothing else; 'quantity[]' is a list of numbers."""
    if not isinstance(table.get(name), dict):
        raise InputError(f"section [{name}] is missing", remedy=f"keys: {', '.join(q.strip('[]') for q in schema)}")
    section = table[name]
    lists = {q[:-2] for q in schema if q.endswith("[]")}
    wanted = {q.removesuffix("[]"): dimension for q, dimension in schema.items()}
    found = units.resolve(list(section), wanted, where=f"[{name}] key")
    used = {key for key, _ in found.values()}
    accepted = [units.spellings(q, d) if d != "none" else q for q, d in wanted.items()]
    for key in section:
        if key not in used:
            raise InputError(f"[{name}] unknown key '{key}'", column=key, remedy=f"accepted: {'; '.join(accepted)}")
    out: dict[str, Any] = {}
    for quantity, dimension in wanted.items():
        if quantity not in found:
            if quantity in optional:
                continue
            spelling = units.spellings(quantity, dimension) if dimension != "none" else quantity
            raise InputError(f"[{name}] '{quantity}' is missing", remedy=f"write one of {spelling}")
        key, factor = found[quantity]
        raw = section[key]
        values = raw if quantity in lists else [raw]
        if not isinstance(values, list) or not all(map(_is_number, values)):
            what = "a list of numbers" if quantity in lists else "a number"
            raise InputError(f"[{name}] '{key}' must be {what}, not {raw!r}", column=key)
        si = np.array(values, float) * factor
        if quantity.endswith(("length", "radius")) and not (si >= 0).all():
            raise InputError(f"[{name}] '{key}' is negative", column=key)
        if quantity.endswith("length") and not si.all():
            raise InputError(f"[{name}] '{key}' is zero", column=key)
        if key.endswith("_rad") and (np.abs(si) > 2 * np.pi).any():
            degrees = f"if these are degrees, name it {quantity}_deg"
            raise InputError(f"[{name}] '{key}' is more than a turn", column=key, remedy=degrees)
        out[quantity] = si if quantity in lists else float(si[0])
    return out


def _drive(section: Any) -> dict[str, Any]:
    """[drive]: cycles of gear ripple per turn of a motor axis."""
    if not isinstance(section, dict):
        raise InputError("'drive' is no section", column="drive", remedy="write [drive] and ripple_per_turn = [24]")
    for key, value in section.items():
        if key != "ripple_per_turn":
            raise InputError("[drive] " + unknown("key", key, ["ripple_per_turn"]), column=key)
        if not isinstance(value, list) or not all(_is_number(n) and n > 0 and n == int(n) for n in value):
            raise InputError(f"[drive] '{key}' must be a list of whole numbers above 0, not {value!r}", column=key)
    return dict(section)


def _is_number(value: Any) -> bool:
    """A finite number, and none so large that its square overflows."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e30


def _line_of(text: str, error: InputError) -> int | None:
    """Line on which the key that an error is about is written, in the [section] that its message begins with."""
    column = error.column or next(iter(re.findall(r"'([^']+)'", error.problem)), None)
    if column is None:
        return None
    wanted = re.match(r"\[(\w+)\]", error.problem)
    section = ""
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip()
        if bare.startswith("["):
            section = bare.strip("[]").split("]")[0].strip()
        key = bare.split("=")[0].strip()
        meant = column in (key, bare.strip("[] ")) or key.startswith(f"{column}_")
        if meant and (wanted is None or section == wanted.group(1)):
            return number
    return None
