"""What an effect is: a physical cause that moves the TCP and that the rigid geometry does not describe.

An effect states its parameters, the data columns it needs, and what it adds for given parameter values. All solvers
work with any combination of effects; derivatives come from the contribution itself (exact where it is linear).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pcalib import units
from pcalib.errors import EffectError
from pcalib.mechanics import kinematics, statics
from pcalib.mechanics.kinematics import RIGID, Deviation
from pcalib.mechanics.mechanism import BaseSide, Mechanism, Pose
from pcalib.robot import Robot
from pcalib.wording import figure


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect."""

    name: str
    unit: str
    """A spelling of `pcalib.units`; values in code are SI, files show this unit."""
    prior: float
    """[SI] usual size (1σ), which scales the parameter."""
    low: float = -np.inf
    """[SI] physical range; a fitted value outside it is reported."""
    high: float = np.inf
    plausible: tuple[float, float] = (-np.inf, np.inf)
    """[SI] What working robots have; the file of the effect names the source. Parts within their physical range and far
    outside this one are broken, or something else is behind the value."""
    alike: float = np.inf
    """How much the arms or rods of one robot differ from each other [1σ, as a share of what they have in common]: parts
    of one make and material do not differ by more. Infinite where each has a value of its own."""
    quantity: str = ""
    """The name without that of its arm or rod; empty where it has none."""


@dataclass(frozen=True)
class Situation:
    """What an effect is computed from: the state of the robot at N poses under the current model."""

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
    partners: tuple[tuple[Effect, np.ndarray], ...] = ()
    """All effects of the model with their parameter values (np,) [SI]."""

    @classmethod
    def at(
        cls,
        robot: Robot,
        k: np.ndarray,
        q: np.ndarray,
        pose: Pose,
        tool: np.ndarray | float = 0.0,
        payload: np.ndarray | float = 0.0,
        columns: Mapping[str, np.ndarray] | None = None,
        *,
        partners: Sequence[tuple[Effect, np.ndarray]] = (),
        position: np.ndarray | None = None,
        deviation: Deviation = RIGID,
    ) -> Situation:
        """The situation at N poses, with rod directions, levers and loads from the statics of the rigid robot.

        Args:
            k: (nk,) geometric parameters.
            q: (N, nq) commanded actuator values [rad or m].
            pose: plate poses that close the loops with q.
            tool: (3,) or (N, 3) [m], plate frame.
            payload: scalar or (N,) [kg] at the tool point.
            columns: (N,) arrays in SI by name without unit.
            partners: all effects of the model with their parameter values.
            position: (N, 3) [m] measured point in the measuring frame; the TCP in the base frame when absent.
            deviation: what effects add inside the loops at these poses.
        """
        q = np.atleast_2d(np.asarray(q, float))
        tool = np.broadcast_to(np.asarray(tool, float), pose.x.shape)
        payload = np.broadcast_to(np.asarray(payload, float), (len(q),))
        closed = kinematics.closure(robot.mechanism, k, q, pose, deviation=deviation)
        loads = statics.loads(robot.mechanism, k, q, pose, robot.mass, robot.gravity, tool, payload, closed)
        return cls(
            robot=robot, q=q, pose=pose, rods=closed.n, arms=closed.side.dA, tension=loads.tension,
            torque=loads.torque, tool=tool, payload=payload, columns=dict(columns or {}), k=k, position=position,
            partners=tuple(partners),
        )  # fmt: skip

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
        loads = statics.loads(
            self.robot.mechanism, self.k, self.q, self.pose, self.robot.mass, gravity, self.tool, self.payload
        )
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
    """Small deviations that an effect adds, by channel; None means zero."""

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

    def items(self) -> list[tuple[str, np.ndarray]]:
        """Name and array of each channel that is not None."""
        return [(name, value) for name, value in vars(self).items() if value is not None]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that are not None."""
        return tuple(name for name, _ in self.items())

    def __getitem__(self, channel: str) -> np.ndarray:
        """The array of a channel that is not None."""
        return vars(self)[channel]

    def __add__(self, other: Contribution) -> Contribution:
        out = dict(self.items())
        for name, value in other.items():
            out[name] = out[name] + value if name in out else value
        return Contribution(**out)

    def scaled(self, factor: float) -> Contribution:
        """All channels times a number."""
        return Contribution(**{name: factor * value for name, value in self.items()})

    def spread(self, rows: np.ndarray) -> Contribution:
        """The contribution of the rows (N,) bool that are true, spread over all N rows: zero on the others."""
        out = {}
        for name, part in self.items():
            out[name] = np.zeros((len(rows), *part.shape[1:]))
            out[name][rows] = part
        return Contribution(**out)

    @property
    def deviation(self) -> Deviation:
        """The part inside the closed loops."""
        return Deviation(self.actuator, self.rod, self.elbow, self.plate)


@dataclass(frozen=True)
class ClosedForm:
    """An effect without loads in numbers that a controller can hold: δq_i = g_i·q_i + Σ_n (A_ni·sin nq_i + B_ni·cos
    nq_i), and expansions of rods, arms and base in proportion to their temperatures above 20 °C."""

    ratio: np.ndarray | None = None
    """(nq,) g of each actuator."""
    waves: Mapping[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    """Cycles per turn n → A and B, (nq,) [rad] each."""
    rods: np.ndarray | None = None
    arms: np.ndarray | None = None
    base: np.ndarray | None = None
    """(m,) [1/K] each, counted by rod."""


class Effect:
    """A physical effect; a library effect or a user's class states what differs from these defaults.

    An effect has to state `name`, `parameters` and `contribution`. A user's class need not derive from this one,
    because loading adds it as a base.
    """

    name: str = ""
    """The name in files and options: lower-case letters, digits and _."""
    spec: str = ""
    """How a command line names this variant: `drive_compliance:arm`, `my_effect.py:WormGear`; the name by default."""
    title: str = ""
    """What happens, in a technician's words."""
    parameters: tuple[EffectParameter, ...] = ()
    """Its np numbers, common to all arms (or rods) or one for each."""
    per: str = "common"
    """Whether the numbers are 'common' to the robot or counted per 'arm' or 'rod'."""
    needs: tuple[str, ...] = ()
    """Data columns without which it cannot be computed, by name without unit."""
    wants: tuple[str, ...] = ()
    """What the data should vary so that the effect is seen, in words for the user."""
    channels: tuple[str, ...] = ()
    """Channels of :class:`Contribution` that it may fill, the main one first."""
    cycles: tuple[int, ...] = ()
    """Cycles per turn of the motor axis that its parameters belong to; empty where they belong to none."""
    linear: bool = False
    """Whether the contribution is linear in theta."""
    indirect: bool = False
    """Whether it acts only through the other effects of the model (`Situation.partners`)."""

    def __init_subclass__(cls) -> None:
        if "name" in vars(cls) and "spec" not in vars(cls):
            cls.spec = cls.name

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        """What it adds at parameter values theta (np,) [SI]; nothing at theta = 0."""
        raise NotImplementedError

    def basis(self, at: Situation, theta: np.ndarray | None = None) -> list[Contribution]:
        """∂(contribution)/∂θ_j, one Contribution per parameter, at theta (zero when absent).

        It is exact where the effect is linear; otherwise by central differences with steps of 1e-3 prior.
        """
        eye = np.eye(len(self.parameters))
        if self.linear:
            return [self.contribution(at, row) for row in eye]
        zero = np.zeros(len(eye)) if theta is None else np.asarray(theta, float)
        out = []
        for row, parameter in zip(eye, self.parameters, strict=True):
            h = 1e-3 * parameter.prior
            plus, minus = self.contribution(at, zero + h * row), self.contribution(at, zero - h * row)
            out.append((plus + minus.scaled(-1.0)).scaled(0.5 / h))
        return out

    def through(self, at: Situation, theta: np.ndarray, other: Effect, other_theta: np.ndarray) -> list[Contribution]:
        """∂(contribution of this effect)/∂(parameters of another), asked of effects that are `indirect` only."""
        return [Contribution() for _ in other.parameters]

    def closed_form(self, theta: np.ndarray) -> ClosedForm | None:
        """The effect in numbers that `pcalib export` can write; None where it needs loads, directions or the time."""
        return None

    def unsuited(self, mechanism: Mechanism) -> str:
        """Why it makes no sense on a robot, in words; empty where it makes sense."""
        return ""

    def describe(self, theta: np.ndarray) -> str:
        """The numbers theta (np,) [SI] in plain words with their units."""
        return "; ".join(
            f"{p.name.replace('_', ' ')} {self.say(p, value)}" for p, value in zip(self.parameters, theta, strict=True)
        )

    def say(self, quantity: EffectParameter, value: float) -> str:
        """One number [SI] with its unit; below a millionth of its usual size it is written as 0."""
        shown = value / units.factor(quantity.unit)
        return f"{figure(shown if abs(value) > 1e-6 * quantity.prior else 0.0)} {units.spoken(quantity.unit)}".rstrip()
