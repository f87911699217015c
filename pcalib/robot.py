"""Robot files: a robot's kind, nominal dimensions, joint range, masses and workspace.

This is a description only; the kinematics live in the mechanism that the kind builds from it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pcalib import files, kinds
from pcalib.errors import InputError, unknown
from pcalib.mechanics.mechanism import Mechanism
from pcalib.settings import ANY, Setting, section

MODELS = next(
    (folder for folder in (Path(__file__).parent / "models", Path(__file__).parents[1] / "models") if folder.is_dir()),
    Path("models"),
).resolve()
"""Robot files that are found by name: in the package where a wheel brought it, else beside it in the project."""
_FORM = "see models/delta.toml for the form"
SECTIONS = ("name", "kind", "geometry", "joints", "mass", "workspace", "gravity", "drive")
MOST_TURNS = 1e4
"""Largest number of motor turns over the travel of a leg: the travel over the pitch of a fine screw."""
WORKSPACE = (
    kinds.size("radius"),
    kinds.offset("z_min"),
    kinds.offset("z_max"),
    Setting("tilt", "angle", 0.0, 0.0, np.pi),
    Setting("yaw", "angle", 0.0, 0.0, 2 * np.pi),
)
GRAVITY = Setting("vector", "acceleration", low=-1e3, high=1e3, count=3)
RIPPLE = Setting("ripple_per_turn", "whole", low=1, high=1e5, count=ANY)
_TRIED = 2000
"""Commands that are tried where a robot file has no workspace."""
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
    stated: bool = True
    """Whether the robot file states it; one that was found from the joint range plans poses, and refuses no target."""

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
    """Read a robot file (TOML), or one of the project's own by its name, as in ``load("delta")``.

    Raises:
        InputError: not readable, not TOML, or a key that is missing, unknown, without unit or out of range.
    """
    path = find(path)
    return parse(files.read_text(path), path)


def find(path: str | Path) -> Path:
    """The file of a robot. A bare word that names no file here is the name of a robot of :data:`MODELS`.

    Raises:
        InputError: there is no such robot; the message lists those that there are.
    """
    path = Path(path)
    if path.suffix or path.name != str(path) or os.path.exists(path):
        return path
    known = {file.stem: file for file in sorted(MODELS.glob("*.toml"))}
    if path.name not in known:
        remedy = "name one of these, or a robot file (TOML) by its path"
        raise InputError(unknown("robot", path.name, known), remedy=remedy)
    return known[path.name]


def parse(text: str, source: str | Path = "robot") -> Robot:
    """A robot from the text of its file; `source` names it in messages."""
    table = files.parse_toml(text, source, _FORM)
    with files.locating(text, source, _FORM):
        return from_table(table, text)


def _found_workspace(mechanism: Mechanism, low: float, high: float) -> Workspace:
    """The working cylinder of a robot file that states none: where the middle four fifths of the joint range lead.

    Raises:
        InputError: hardly any command of the joint range closes the loops.
    """
    from pcalib.mechanics import kinematics

    q = np.random.default_rng(0).uniform(low, high, (_TRIED, len(mechanism.actuators)))
    found = kinematics.forward(mechanism, mechanism.nominal, q)
    x, R = found.pose.x[found.ok], found.pose.R[found.ok]
    if len(x) < _TRIED // 20:
        remedy = "check [geometry] and [joints], or write [workspace]: radius_mm, z_min_mm, z_max_mm"
        raise InputError("no workspace is found: hardly any command in the joint range is one that the robot can take",
                         section="joints", key="min", remedy=remedy)  # fmt: skip
    z_min, z_max = np.quantile(x[:, 2], (0.1, 0.9))
    if z_max - z_min < 1e-6:  # a robot that moves in a plane
        z_min, z_max = z_min - 1e-3, z_max + 1e-3
    tilt = yaw = 0.0
    if {3, 4, 5} & set(mechanism.task):
        tilt = float(np.quantile(np.arccos(np.clip(R[:, 2, 2], -1, 1)), 0.8))
        yaw = float(np.quantile(np.abs(np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])), 0.8))
    return Workspace(float(np.quantile(np.hypot(x[:, 0], x[:, 1]), 0.8)), float(z_min), float(z_max), tilt, yaw, False)


def _require_side(stated: Workspace, mechanism: Mechanism, low: float, high: float) -> None:
    """Refuse a workspace above the base for a robot that hangs from it.

    Raises:
        InputError: the robot does not reach it, and reaches its mirror image below the base.
    """
    bottom, top = sorted((stated.z_min, stated.z_max))
    if bottom <= 0:
        return
    try:
        found = _found_workspace(mechanism, low, high)
    except InputError:  # then nothing is known of where it is
        return
    if (found.z_min > top or found.z_max < bottom) and found.z_min < -bottom and found.z_max > -top:
        raise InputError(
            "[workspace] lies above the base, and this robot moves below it", section="workspace", key="z_min",
            remedy=f"z points upwards from the base: write z_min_mm = {-top * 1e3:g} and z_max_mm = {-bottom * 1e3:g}",
        )


def from_table(table: Mapping[str, Any], text: str = "") -> Robot:
    """A robot from its parsed TOML table."""
    for key in table:
        if key not in SECTIONS:
            raise InputError(unknown("key", key, SECTIONS), key=key)
    for key in ("name", "kind"):
        if not isinstance(table.get(key), str):
            raise InputError(f"'{key}' is missing or not text", key=key, remedy=f'write {key} = "delta"')
    kind = kinds.get(table["kind"])
    dimensions = section(table, "geometry", kind.dimensions)
    dimension = kind.build(dimensions).actuator_dimension
    joints_given = table.get("joints")
    revolutions = isinstance(joints_given, Mapping) and all(key.endswith("_rev") for key in joints_given)
    largest = kinds.LARGEST_LENGTH if dimension == "length" else 2 * np.pi * (MOST_TURNS if revolutions else 1)
    joints = section(table, "joints", [Setting(end, dimension, low=-largest, high=largest) for end in ("min", "max")])
    if not joints["min"] < joints["max"]:
        raise InputError("[joints] min must be below max", section="joints", key="min")
    if "workspace" in table:
        workspace = Workspace(**section(table, "workspace", WORKSPACE))
        _require_side(workspace, kind.build(dimensions), joints["min"], joints["max"])
    else:
        workspace = _found_workspace(kind.build(dimensions), joints["min"], joints["max"])
    if not workspace.z_min < workspace.z_max:
        raise InputError("[workspace] z_min must be below z_max", section="workspace", key="z_min")
    mass = section(table, "mass", kind.masses) if "mass" in table else {}
    gravity = section(table, "gravity", (GRAVITY,))["vector"] if "gravity" in table else STANDARD_GRAVITY.copy()
    drive = section(table, "drive", (RIPPLE,)) if "drive" in table else {}
    robot = Robot(
        table["name"], table["kind"], dimensions, joints["min"], joints["max"], mass, workspace, gravity, drive, text,
        revolutions,
    )  # fmt: skip
    _ = robot.mechanism  # a robot that cannot be built is a bad file, and is said so here
    return robot
