"""Faults of the robots of a campaign: the settings of truth files, each of which may be drawn anew for every robot.

    [faults.drive_compliance]
    stiffness_kNm_rad = { normal = [30, 5] }       # mean, 1σ
    [faults.backlash]
    gap_urad = { uniform = [0, 400] }              # low, high
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import faults
from bench.faults import Fault
from pcalib import settings
from pcalib.errors import InputError, unknown
from pcalib.robot import Robot

DISTRIBUTIONS = {"normal": "mean, 1σ", "uniform": "low, high", "lognormal": "median, 1σ of its logarithm"}


@dataclass(frozen=True)
class Drawn:
    """A number that is drawn per robot."""

    distribution: str
    a: float
    b: float

    @property
    def usual(self) -> float:
        """A typical value of the draw; zero only where it gives no other."""
        if self.distribution == "uniform":
            return self.b or self.a
        return self.a or (self.b if self.distribution == "normal" else 0.0)

    def draw(self, rng: np.random.Generator) -> float:
        """One value, in the unit of its key."""
        if self.distribution == "uniform":
            return float(rng.uniform(self.a, self.b))
        z = float(rng.standard_normal())
        return self.a * float(np.exp(self.b * z)) if self.distribution == "lognormal" else self.a + self.b * z


@dataclass(frozen=True, eq=False)
class RandomFault:
    """A fault and its settings, fixed or drawn."""

    name: str
    fixed: Mapping[str, Any]
    drawn: Mapping[str, Drawn]
    needs: tuple[str, ...] = ()
    """Columns of the commands that it cannot do without."""

    @classmethod
    def of(cls, robot: Robot, name: str, table: Mapping[str, Any]) -> RandomFault:
        """The fault that a table [faults.NAME] states.

        Raises:
            InputError: a setting that the fault does not take, a distribution that is none, or a fault of another kind
                of robot.
        """
        drawn = {key: _distribution(name, key, value) for key, value in table.items() if isinstance(value, Mapping)}
        fixed = {key: value for key, value in table.items() if key not in drawn}
        usual = {**fixed, **{key: number.usual for key, number in drawn.items()}}
        kind = faults.get(name)
        values = settings.read(usual, kind.settings(robot), f"faults.{name}", faults.counts(robot))
        try:
            made = kind(robot, **values)
            faults.suit(robot, [made])
        except InputError as error:
            raise InputError(
                f"[faults.{name}] {error.problem}", column=f"faults.{name}",
                remedy=f"faults of a {robot.kind}: {', '.join(faults.suited(robot))}",
            ) from None  # fmt: skip
        return cls(name, fixed, drawn, () if made.absent else tuple(made.NEEDS))

    def make(self, robot: Robot, rng: np.random.Generator) -> Fault:
        """The fault of one robot.

        Raises:
            InputError: what was drawn lies outside the range that makes sense.
        """
        return faults.make(robot, self.name, {**self.fixed, **{key: d.draw(rng) for key, d in self.drawn.items()}})


def _distribution(fault: str, key: str, value: Mapping[str, Any]) -> Drawn:
    where = f"[faults.{fault}] '{key}'"
    if len(value) != 1:
        raise InputError(f"{where}: a distribution has one key, {', '.join(DISTRIBUTIONS)}", column=key)
    name, numbers = next(iter(value.items()))
    if name not in DISTRIBUTIONS:
        raise InputError(f"{where}: {unknown('distribution', name, DISTRIBUTIONS)}", column=key)
    fine = isinstance(numbers, list) and len(numbers) == 2
    if not fine or any(isinstance(v, bool) or not isinstance(v, (int, float)) or not np.isfinite(v) for v in numbers):
        raise InputError(f"{where}: {name} takes two numbers, [{DISTRIBUTIONS[name]}], not {numbers!r}", column=key)
    a, b = float(numbers[0]), float(numbers[1])
    if (name == "uniform" and b < a) or (name != "uniform" and b < 0):
        why = "low is above high" if name == "uniform" else "σ is negative"
        raise InputError(f"{where}: {name} = [{a:g}, {b:g}] is impossible: {why}", column=key)
    return Drawn(name, a, b)
