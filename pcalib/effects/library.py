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
from pcalib.effects.base import ClosedForm, Contribution, Effect, EffectParameter, Situation
from pcalib.errors import EffectError
from pcalib.mechanics.mechanism import Mechanism
from pcalib.registry import Registry
from pcalib.wording import figure


@dataclass(frozen=True)
class Places:
    """Names of the arms and rods of a robot, which separate parameters are named after."""

    arms: tuple[str, ...] = ("q1", "q2", "q3")
    rods: tuple[str, ...] = ("11", "12", "21", "22", "31", "32")
    arm_of_rod: tuple[int, ...] = (0, 0, 1, 1, 2, 2)
    dimension: str = "angle"
    """'angle' or 'length': what an actuator value is."""

    @classmethod
    def of(cls, mechanism: Mechanism) -> Places:
        """The arms and rods of a mechanism."""
        return cls(
            tuple(mechanism.actuators),
            tuple(mechanism.rods),
            tuple(int(i) for i in mechanism.actuator),
            mechanism.actuator_dimension,
        )

    def members(self, per: str) -> tuple[str, ...]:
        """Names of the arms or rods that have parameters of their own; one empty name for 'common'."""
        return {"common": ("",), "arm": self.arms, "rod": self.rods}[per]


@dataclass(frozen=True)
class LibraryEffect(Effect):
    """An effect of the library, named after its file; its numbers are common or separate, as `per` says."""

    per: str = "common"
    places: Places = Places()

    variants: ClassVar[tuple[str, ...]] = ("common", "arm")
    """What `per` may be; a diagnosis tries the first one first."""
    quantities: ClassVar[tuple[EffectParameter, ...]]
    """The numbers of one arm or rod."""
    sliding: ClassVar[tuple[EffectParameter, ...]] = ()
    """The numbers of one carriage or leg, where other units than those of arms apply."""

    linear = True

    def __init_subclass__(cls) -> None:
        cls.name = cls.__module__.rpartition(".")[2]

    def __post_init__(self) -> None:
        if self.per not in self.variants:
            raise EffectError(f"effect {self.name} has no variant '{self.per}'; accepted: {', '.join(self.variants)}")
        members = self.places.members(self.per)
        parameters = tuple(
            replace(quantity, name=f"{quantity.name}.{member}" if member else quantity.name, quantity=quantity.name)
            for quantity in self.numbers()
            for member in members
        )
        object.__setattr__(self, "parameters", parameters)
        object.__setattr__(self, "spec", self.name if self.per == self.variants[0] else f"{self.name}:{self.per}")

    def numbers(self) -> tuple[EffectParameter, ...]:
        """The numbers of one arm or rod of this robot; `parameters` has them quantity by quantity, member by member."""
        return self.sliding if self.sliding and self.places.dimension == "length" else self.quantities

    def describe(self, theta: np.ndarray) -> str:
        quantities = self.numbers()
        members = self.places.members(self.per)
        clauses = []
        for quantity, values in zip(quantities, np.reshape(theta, (len(quantities), -1)), strict=True):
            said = [f"{m} {self.say(quantity, v)}".lstrip() for m, v in zip(members, values, strict=True)]
            clauses.append(f"{quantity.name.replace('_', ' ')} {', '.join(said)}")
        return "; ".join(clauses)


LIBRARY = Registry[type[LibraryEffect]](
    "pcalib.effects", "EFFECT", "effect", error=EffectError, helpers=("base", "library", "user"),
    remedy="an effect of your own is given as file.py:ClassName",
)  # fmt: skip


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

    def placed(self, theta: np.ndarray) -> np.ndarray:
        """(quantities, arms or rods) the number that serves each place of the channel."""
        return np.asarray(theta, float).reshape(len(self.numbers()), -1)[:, self._member]

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        shapes = self.shapes(at)
        values = self.placed(theta)
        values = values[:, None, :, None] if shapes.ndim == 4 else values[:, None]
        return Contribution(**{self.channels[0]: np.sum(values * shapes, axis=0)})

    def basis(self, at: Situation, theta: np.ndarray | None = None) -> list[Contribution]:
        shapes, member = self.shapes(at), self._member
        out = []
        for shape in shapes:
            for j in range(len(self.places.members(self.per))):
                mine = (member == j).astype(float)
                out.append(Contribution(**{self.channels[0]: shape * (mine[:, None] if shape.ndim == 3 else mine)}))
        return out


class Harmonic(PlacedEffect):
    """δq_i = Σ_n A_n·sin nq_i + B_n·cos nq_i [rad], for n of `cycles` per turn of the actuator."""

    channels = ("actuator",)

    def unsuited(self, mechanism: Mechanism) -> str:
        return "" if mechanism.actuator_dimension == "angle" else "its actuators do not turn"

    def shapes(self, at: Situation) -> np.ndarray:
        return np.concatenate([np.stack([np.sin(n * at.q), np.cos(n * at.q)]) for n in self.cycles])

    def closed_form(self, theta: np.ndarray) -> ClosedForm:
        values = self.placed(theta)
        return ClosedForm(waves={n: (values[2 * i], values[2 * i + 1]) for i, n in enumerate(self.cycles)})

    def describe(self, theta: np.ndarray) -> str:
        """Amplitude and phase of each (sine, cosine) pair, member by member."""
        quantities, members = self.numbers(), self.places.members(self.per)
        said = []
        for n, (sines, cosines) in zip(self.cycles, np.reshape(theta, (len(self.cycles), 2, -1)), strict=True):
            sizes, phases = np.hypot(sines, cosines), np.degrees(np.arctan2(cosines, sines))
            each = [
                f"{member} {self.say(quantities[0], size)} at {phase:.0f}°".lstrip()
                for member, size, phase in zip(members, sizes, phases, strict=True)
            ]
            said.append(f"{self.prefix(n)}amplitude {', '.join(each)}")
        return "; ".join(said)

    def prefix(self, n: int) -> str:
        """What stands before an amplitude of n cycles per turn."""
        return ""


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
    return at.k[mechanism.base_points][mechanism.actuator]


REFERENCE = 20.0
"""[°C] temperature that dimensions are stated for (ISO 1)."""
EXPANSION = EffectParameter("expansion", "ppm_K", 1.5e-5, -5e-6, 1e-4, plausible=(-2e-6, 3e-5), alike=0.2)
"""Linear expansion of a part. Carbon fibre along its tube has −1…2 ppm/K, steel 11–17, aluminium 23; parts of one robot
are of one material, and their temperatures differ by a fifth of the warming at most."""


def warmer(at: Situation, part: str) -> np.ndarray:
    """(N,) [K] temperature of 'arms', 'rods' or 'base' above the reference."""
    return at.column(f"temp_{part}") - REFERENCE


def unsuited_without_arms(mechanism: Mechanism) -> str:
    """For effects of rotary arms, which need the points that the arms turn about."""
    if motor_axes(mechanism, mechanism.nominal) is None:
        return "its actuators turn no arms"
    return "" if len(mechanism.base_points) else "the base points of its arms are no vectors of parameters"


def stiffness(compliance: float, unit: str, part: str = "") -> str:
    """A compliance as the stiffness of a part that people know, in parentheses and with its unit."""
    if abs(compliance) < 1e-6 * units.factor(unit):
        return "(rigid)"
    if compliance < 0:
        return "(not physical)"
    value, shown = (1e-3, "kN·m/rad") if unit.endswith("_Nm") else (1e-6, "N/µm")
    return f"({f'{part} stiffness'.lstrip()} {figure(value / compliance)} {shown})"
