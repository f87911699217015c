"""What the effects of the library share: names of a robot's arms and rods, common or separate parameters, plain words.

Most effects are a sum of shapes, one set of shapes for every arm or rod and one set of numbers either common to
all, or per arm, or per rod:

    contribution[channel][n, place] = Σ_j θ[j, member(place)] · shape_j[n, place]
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pcalib import rotation, units
from pcalib.effects.base import Contribution, EffectParameter, Situation
from pcalib.errors import EffectError
from pcalib.mechanics.mechanism import Mechanism
from pcalib.wording import figure


@dataclass(frozen=True)
class Places:
    """Arms and rods of a robot by name: what separate parameters are counted over."""

    arms: tuple[str, ...] = ("q1", "q2", "q3")
    rods: tuple[str, ...] = ("11", "12", "21", "22", "31", "32")
    arm_of_rod: tuple[int, ...] = (0, 0, 1, 1, 2, 2)
    dimension: str = "angle"
    """'angle' or 'length': what an actuator value is."""

    @classmethod
    def of(cls, mechanism: Mechanism) -> Places:
        """Those of a mechanism."""
        return cls(
            tuple(mechanism.actuators),
            tuple(mechanism.rods),
            tuple(int(i) for i in mechanism.actuator),
            mechanism.actuator_dimension,
        )

    def members(self, per: str) -> tuple[str, ...]:
        """Names of those that have parameters of their own."""
        return {"common": ("",), "arm": self.arms, "rod": self.rods}[per]


@dataclass(frozen=True)
class LibraryEffect:
    """An effect of the library: name, plain words, and whether its numbers are common or separate."""

    per: str = "common"
    """'common', 'arm' or 'rod'."""
    places: Places = Places()

    title: ClassVar[str]
    """What happens, in a technician's words."""
    variants: ClassVar[tuple[str, ...]] = ("common", "arm")
    """What `per` may be, the one to try first in front."""
    channels: ClassVar[tuple[str, ...]]
    """Where it enters: actuator, rod, elbow, plate, tool, base or sensor."""
    linear: ClassVar[bool] = True
    """The contribution is linear in theta."""
    wants: ClassVar[tuple[str, ...]] = ()
    """What the data must vary for it to be seen: payload, dir, temperature, time, q; words for the user."""

    def __post_init__(self) -> None:
        if self.per not in self.variants:
            raise EffectError(f"effect {self.name} has no variant '{self.per}'; accepted: {', '.join(self.variants)}")

    @property
    def name(self) -> str:
        """The name in files and options: that of its file."""
        return type(self).__module__.rpartition(".")[2]

    @property
    def spec(self) -> str:
        """How a command line names it: `drive_compliance` or `drive_compliance:arm`."""
        return self.name if self.per == self.variants[0] else f"{self.name}:{self.per}"

    @property
    def quantities(self) -> tuple[EffectParameter, ...]:
        """The numbers of one member."""
        raise NotImplementedError

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """All numbers, quantity by quantity, member by member: `compliance.q1 compliance.q2 …`."""
        members = self.places.members(self.per)
        return tuple(
            replace(quantity, name=f"{quantity.name}.{member}" if member else quantity.name)
            for quantity in self.quantities
            for member in members
        )

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns without which it cannot be computed."""
        return ()

    def unsuited(self, mechanism: Mechanism) -> str:
        """Why it makes no sense on a robot; empty where it does."""
        return ""

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        """What it adds at theta (np,) [SI]."""
        raise NotImplementedError

    def describe(self, theta: np.ndarray) -> str:
        """The numbers in plain words, one clause per quantity."""
        theta = np.asarray(theta, float).reshape(len(self.quantities), -1)
        members = self.places.members(self.per)
        clauses = []
        for quantity, values in zip(self.quantities, theta, strict=True):
            said = [self.say(quantity, value) for value in values]
            if len(said) == 1:
                clauses.append(f"{quantity.name.replace('_', ' ')} {said[0]}")
            else:
                each = ", ".join(f"{member} {text}" for member, text in zip(members, said, strict=True))
                clauses.append(f"{quantity.name.replace('_', ' ')} {each}")
        return "; ".join(clauses)

    def say(self, quantity: EffectParameter, value: float) -> str:
        """One number with its unit."""
        shown = value / units.factor(quantity.unit)
        return f"{figure(shown if abs(value) > 1e-6 * quantity.prior else 0.0)} {units.spoken(quantity.unit)}"


class PlacedEffect(LibraryEffect):
    """An effect that is a sum of shapes at every arm or rod, in one channel."""

    def shapes(self, at: Situation) -> np.ndarray:
        """(quantities, N, arms or rods[, 3]): the contribution per unit of each quantity."""
        raise NotImplementedError

    @property
    def _member(self) -> np.ndarray:
        """Which parameter of a quantity serves each place of the channel."""
        places = self.places
        n = len(places.arms) if self.channels[0] == "actuator" else len(places.rods)
        if self.per == "common":
            return np.zeros(n, int)
        if self.per == "arm" and self.channels[0] != "actuator":
            return np.array(places.arm_of_rod)
        return np.arange(n)

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        shapes = self.shapes(at)
        values = np.asarray(theta, float).reshape(len(shapes), -1)[:, self._member]
        values = values[:, None, :, None] if shapes.ndim == 4 else values[:, None]
        return Contribution(**{self.channels[0]: np.sum(values * shapes, axis=0)})

    def basis(self, at: Situation) -> list[Contribution]:
        """The contribution of each parameter at unit value."""
        shapes, member = self.shapes(at), self._member
        out = []
        for shape in shapes:
            for j in range(len(self.places.members(self.per))):
                mine = (member == j).astype(float)
                out.append(Contribution(**{self.channels[0]: shape * (mine[:, None] if shape.ndim == 3 else mine)}))
        return out


def motor_axes(mechanism: Mechanism, k: np.ndarray) -> np.ndarray | None:
    """(nq, 3) unit directions of the motor axes where every actuator turns an arm; None on other robots."""
    if mechanism.actuator_dimension != "angle":
        return None
    quarter = np.full((1, len(mechanism.actuators)), 0.5 * np.pi)
    # The anchors run on circles: dA is tangent, and a quarter turn later it points back along the arm.
    start, later = (mechanism.actuation.base(k, q).dA[0] for q in (0 * quarter, quarter))
    axis = rotation.cross(start, later)
    size = np.linalg.norm(axis, axis=-1)
    if not np.all(size > 1e-9):
        return None
    rod_of_arm = [int(np.flatnonzero(mechanism.actuator == i)[0]) for i in range(len(mechanism.actuators))]
    return (axis / size[:, None])[rod_of_arm]


def pivots(at: Situation) -> np.ndarray:
    """(m, 3) [m] base point p of each rod's actuator, base frame."""
    mechanism = at.robot.mechanism
    p = np.asarray(getattr(mechanism.actuation, "p"))  # noqa: B009 - every actuation of the family has one
    return at.k[p][mechanism.actuator]


def unsuited_without_arms(mechanism: Mechanism) -> str:
    """For effects of rotary arms."""
    return "" if motor_axes(mechanism, mechanism.nominal) is not None else "its actuators turn no arms"


def unsuited_without_angles(mechanism: Mechanism) -> str:
    """For effects of encoders and gears that repeat with a turn."""
    return "" if mechanism.actuator_dimension == "angle" else "its actuators do not turn"


def drive_unit(places: Places, angle: str, length: str) -> str:
    """A unit that depends on what the actuators are."""
    return angle if places.dimension == "angle" else length


def stiffness(compliance: float, unit: str, part: str = "") -> str:
    """A compliance as the stiffness of a part that people know, in parentheses and with its unit."""
    if abs(compliance) < 1e-6 * units.factor(unit):
        return "(rigid)"
    if compliance < 0:
        return "(not physical)"
    value, shown = (1e-3, "kN·m/rad") if unit.endswith("_Nm") else (1e-6, "N/µm")
    return f"({f'{part} stiffness'.lstrip()} {figure(value / compliance)} {shown})"


def harmonics(q: np.ndarray, cycles: tuple[int, ...]) -> np.ndarray:
    """(2·len(cycles), N, nq): sin nq, cos nq for each n."""
    return np.concatenate([np.stack([np.sin(n * q), np.cos(n * q)]) for n in cycles])


def amplitude(theta: np.ndarray, names: tuple[str, ...], unit: str) -> str:
    """Pairs (sine, cosine) as amplitude and phase; theta (2, members)."""
    out = []
    for name, sine, cosine in zip(names, theta[0], theta[1], strict=True):
        size, phase = np.hypot(sine, cosine), np.degrees(np.arctan2(cosine, sine))
        label = f"{name} " if name else ""
        out.append(f"{label}{figure(size / units.factor(unit))} {units.spoken(unit)} at {phase:.0f}°")
    return ", ".join(out)
