"""The parameter vector of a robot kind, laid out in named blocks, and its levels.

Names follow one pattern over all kinds: `p1.x` a point or rotation vector of arm 1, `a11.x` of rod 11, `l11` a number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.mechanics.actuation import RotaryArms
from pcalib.mechanics.mechanism import Level

AXES = "xyz"
AS_DRAWN = "Every dimension is as drawn."
EVERYTHING = "Every dimension for itself."
"""Texts of the two levels that every kind has."""


@dataclass(frozen=True)
class Block:
    """Parameters of one sort, one row per arm or rod."""

    symbol: str
    tags: tuple[str, ...]
    values: np.ndarray
    """(n, 3) vectors or (n,) numbers [SI]."""
    unit: str = "m"

    def names(self) -> list[str]:
        """Names in the order of `values`."""
        if self.values.ndim == 1:
            return [f"{self.symbol}{tag}" for tag in self.tags]
        return [f"{self.symbol}{tag}.{axis}" for tag in self.tags for axis in AXES]


@dataclass(frozen=True)
class Layout:
    """Where every named parameter stands in k."""

    names: tuple[str, ...]
    nominal: np.ndarray
    """(nk,) [SI]."""
    units: tuple[str, ...]

    @classmethod
    def of(cls, *blocks: Block) -> Layout:
        """The blocks, one after the other."""
        names = [name for block in blocks for name in block.names()]
        units = [block.unit for block in blocks for _ in block.names()]
        return cls(tuple(names), np.concatenate([block.values.ravel() for block in blocks]), tuple(units))

    def vectors(self, symbol: str, tags: Sequence[str]) -> np.ndarray:
        """(n, 3) where the vectors of these tags stand."""
        return np.array([[self.names.index(f"{symbol}{tag}.{axis}") for axis in AXES] for tag in tags])

    def numbers(self, symbol: str, tags: Sequence[str]) -> np.ndarray:
        """(n,) where the numbers of these tags stand."""
        return np.array([self.names.index(f"{symbol}{tag}") for tag in tags])

    def rotary_arms(self, azimuth: np.ndarray, arms: Sequence[str], rods: Sequence[str]) -> RotaryArms:
        """Arms on motor axes, from the blocks p and beta of the arms and a and l of their rods.

        Args:
            azimuth: (nq,) [rad] direction of each motor axis.
            arms, rods: their tags; the rods of an arm stand together, as many on each.
        """
        return RotaryArms(
            azimuth=azimuth, actuator=np.repeat(np.arange(len(arms)), len(rods) // len(arms)),
            p=self.vectors("p", arms), beta=self.vectors("beta", arms),
            a=self.vectors("a", rods), length=self.numbers("l", rods),
        )  # fmt: skip

    def level(
        self,
        name: str,
        columns: Mapping[str, tuple[str, Mapping[str, float]]],
        *,
        perfect: bool = False,
        strict: bool = False,
        text: str = "",
    ) -> Level:
        """A level whose coordinates are the `columns`: name → (unit, parameter → change per unit of the coordinate)."""
        basis = np.zeros((len(self.names), len(columns)))
        for j, (_, entries) in enumerate(columns.values()):
            for parameter, change in entries.items():
                basis[self.names.index(parameter), j] += change
        return Level(name, tuple(columns), basis, tuple(unit for unit, _ in columns.values()), perfect, strict, text)

    def nominal_level(self) -> Level:
        """Nothing varies."""
        return self.level("nominal", {}, text=AS_DRAWN)

    def complete_level(self) -> Level:
        """Every raw parameter varies; identifiability says which combinations the data fix."""
        return Level("complete", self.names, np.eye(len(self.names)), self.units, text=EVERYTHING)


def along(symbol: str, direction: np.ndarray, change: float = 1.0) -> dict[str, float]:
    """Entries of a level column that moves a vector parameter along a direction (3,)."""
    return {f"{symbol}.{axis}": change * float(direction[n]) for n, axis in enumerate(AXES)}


def arm_columns(u: np.ndarray, rods: Sequence[Sequence[str]]) -> dict[str, tuple[str, Mapping[str, float]]]:
    """Motor offset, arm length and rod length of every rotary arm: what the classical methods vary.

    Args:
        u: (nq, 3) nominal motor axes.
        rods: the tags of each arm's rods.
    """
    columns: dict[str, tuple[str, Mapping[str, float]]] = {}
    for i in range(1, len(rods) + 1):
        columns[f"q{i}.offset"] = ("rad", along(f"beta{i}", u[i - 1]))
    for i, tags in enumerate(rods, 1):
        columns[f"arm{i}.length"] = ("m", {f"a{tag}.y": 1.0 for tag in tags})
        columns[f"rod{i}.length"] = ("m", {f"l{tag}": 1.0 for tag in tags})
    return columns
