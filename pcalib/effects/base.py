"""What an effect is: a physical cause that moves the TCP and that geometry alone does not know.

An effect states its parameters, the data columns it needs, and what it adds for given parameter values. All solvers
work with any combination of effects; derivatives come from the contribution itself (exact where it is linear).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from pcalib.errors import EffectError
from pcalib.mechanics.kinematics import Deviation
from pcalib.mechanics.mechanism import BaseSide, Pose
from pcalib.robot import Robot


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect."""

    name: str
    unit: str
    """A spelling of `pcalib.units`; values in code are SI, files show this unit."""
    prior: float
    """[SI] 1σ of what is usual, the scale of the parameter."""
    low: float = -np.inf
    """[SI] physical range; a fitted value outside it is reported."""
    high: float = np.inf


@dataclass(frozen=True)
class Situation:
    """What an effect may look at, for N poses at the current model."""

    robot: Robot
    q: np.ndarray
    """(N, nq) commanded actuator values [rad or m]."""
    pose: Pose
    """Plate pose."""
    rods: np.ndarray
    """(N, m, 3) unit directions from base to plate anchor, base frame."""
    arms: np.ndarray
    """(N, m, 3) [m], derivative of each base anchor by its actuator (the lever of a rod on its drive)."""
    tension: np.ndarray
    """(N, m) [N] rod forces, tension positive."""
    torque: np.ndarray
    """(N, nq) [N·m or N] generalised load on each actuator, positive where it turns the arm towards +q."""
    tool: np.ndarray
    """(N, 3) [m] TCP in the plate frame."""
    payload: np.ndarray
    """(N,) [kg] at the tool point."""
    columns: Mapping[str, np.ndarray]
    """Every further numeric column of the data, (N,), SI where a unit is known, by its name without unit: temp or
    temp_arms, temp_rods, temp_base [°C], time [s] from the first row, dir1 … and the user's own columns."""
    k: np.ndarray
    """(nk,) geometric parameters [m, rad or 1]."""
    position: np.ndarray | None = None
    """(N, 3) [m] measured point in the measuring frame; the TCP in the base frame when absent."""
    gravity: np.ndarray | None = None
    """(3,) [m/s²], base frame; the robot's when absent. `under` changes it together with the loads."""
    partners: tuple[tuple[Any, np.ndarray], ...] = ()
    """The effects that act together with this one, with their parameter values."""

    def __len__(self) -> int:
        return len(self.q)

    @cached_property
    def side(self) -> BaseSide:
        """Base-side anchors without the deviations of effects."""
        return self.robot.mechanism.actuation.base(self.k, self.q)

    @property
    def g(self) -> np.ndarray:
        """(3,) [m/s²] the gravity that acts, base frame."""
        return self.robot.gravity if self.gravity is None else self.gravity

    @property
    def elbow_force(self) -> np.ndarray:
        """(N, m, 3) [N], base frame: force on each base-side anchor, the rod's pull and half its weight."""
        return self.tension[..., None] * self.rods + 0.5 * self.robot.mass.get("rod", 0.0) * self.g

    @property
    def measured_point(self) -> np.ndarray:
        """(N, 3) [m] measured point in the measuring frame."""
        return self.pose.tcp(self.tool) if self.position is None else self.position

    def column(self, name: str) -> np.ndarray:
        """A column that the effect needs, (N,).

        Raises:
            EffectError: the data have no such column.
        """
        if name.startswith("temp_") and name not in self.columns and "temp" in self.columns:
            name = "temp"
        if name not in self.columns:
            have = ", ".join(sorted(self.columns)) or "none"
            raise EffectError(f"column '{name}' is needed and not in the data; columns beside q and pose: {have}")
        return self.columns[name]

    def directions(self) -> np.ndarray:
        """(N, nq) in −1, 0, +1: sign of each joint's last motion; 0 where it was not recorded."""
        out = np.zeros(self.q.shape)
        for i in range(self.q.shape[1]):
            if f"dir{i + 1}" in self.columns:
                out[:, i] = np.sign(np.nan_to_num(self.columns[f"dir{i + 1}"]))
        return out

    def under(self, gravity: np.ndarray) -> Situation:
        """The same poses with another gravity vector (3,) [m/s²] and the loads that it makes."""
        from pcalib.mechanics import statics

        loads = statics.loads(self.robot, self.k, self.q, self.pose, self.tool, self.payload, gravity=gravity)
        return replace(self, tension=loads.tension, torque=loads.torque, gravity=np.asarray(gravity, float))

    def take(self, rows: np.ndarray | slice) -> Situation:
        """The situation of some rows."""
        names = ("q", "rods", "arms", "tension", "torque", "tool", "payload")
        changed: dict[str, Any] = {name: getattr(self, name)[rows] for name in names}
        changed["pose"] = self.pose.take(rows)
        changed["columns"] = {name: column[rows] for name, column in self.columns.items()}
        if self.position is not None:
            changed["position"] = self.position[rows]
        return replace(self, **changed)


@dataclass(frozen=True)
class Contribution:
    """What an effect adds; None is nothing. All small."""

    actuator: np.ndarray | None = None
    """(N, nq) [rad or m], true minus commanded actuator value."""
    rod: np.ndarray | None = None
    """(N, m) [m], lengthening of the rods."""
    elbow: np.ndarray | None = None
    """(N, m, 3) [m], base frame: displacement of the base-side anchors."""
    plate: np.ndarray | None = None
    """(N, m, 3) [m], plate frame: displacement of the plate-side anchors."""
    tool: np.ndarray | None = None
    """(N, 3) [m], plate frame: displacement of the TCP in the plate; the measured rotation stays the plate's."""
    base: np.ndarray | None = None
    """(N, 6) twist (v, ω) of the whole robot about the base origin: x → exp(ω)·x + v, R → exp(ω)·R."""
    sensor: np.ndarray | None = None
    """(N, 3) [m], measuring frame: added to the measured position."""

    def __add__(self, other: Contribution) -> Contribution:
        out = {}
        for f in fields(self):
            a, b = getattr(self, f.name), getattr(other, f.name)
            out[f.name] = b if a is None else a if b is None else a + b
        return Contribution(**out)

    def scaled(self, factor: float) -> Contribution:
        """All channels times a number."""
        return Contribution(
            **{f.name: None if (a := getattr(self, f.name)) is None else factor * a for f in fields(self)}
        )

    def spread(self, rows: np.ndarray) -> Contribution:
        """This contribution on some rows, (N,) bool, of more: nothing on the others."""
        out = {}
        for name in self.channels:
            part = getattr(self, name)
            out[name] = np.zeros((len(rows), *part.shape[1:]))
            out[name][rows] = part
        return Contribution(**out)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that are not None."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) is not None)

    @property
    def deviation(self) -> Deviation:
        """The part inside the closed loops."""
        return Deviation(self.actuator, self.rod, self.elbow, self.plate)


class Effect(Protocol):
    """An effect of the library or of the user's own; a frozen dataclass."""

    @property
    def name(self) -> str:
        """The name in files and options."""
        ...

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Its numbers; common to all arms or one per arm."""
        ...

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns without which it cannot be computed, by name without unit."""
        ...

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        """What it adds at parameter values theta (np,) [SI]; nothing at theta = 0."""
        ...
