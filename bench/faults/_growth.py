"""Parts that grow with their temperature: what the thermal faults share."""

from __future__ import annotations

import re
from typing import Any, ClassVar

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.errors import InputError
from pcalib.robot import Robot
from pcalib.settings import Setting


def expansion(typical: float) -> tuple[Setting, ...]:
    """The settings of a thermal fault with a usual α [1/K]."""
    return (Setting("expansion", "expansion", low=-1e-3, high=1e-3, typical=typical, about="α"),)


class Growth(Fault):
    """All parameters of one letter grow by α·(T − 20 °C), T the column temp_<part> (or temp) of the commands."""

    LETTER: ClassVar[str]
    """Of the parameters that grow: p, a or l."""
    LEGS: ClassVar[str] = ""
    """Of those that grow besides where rods are legs of commanded length."""
    PART: ClassVar[str]
    """Whose temperature counts: arms, rods or base."""

    def __init__(self, robot: Robot, **values: Any):
        super().__init__(robot, **values)
        names = robot.mechanism.parameters
        letters = self.LETTER + (self.LEGS if robot.kind == "hexapod" else "")
        self._grows = np.array([re.fullmatch(rf"[{letters}]\d+(\.[xyz])?", name) is not None for name in names])
        if not self._grows.any():
            raise InputError(
                f"fault '{self.name}': a robot of kind '{robot.kind}' has no {self.PART} of its own to grow",
                remedy="leave this fault out for this robot",
            )

    def geometry(self, k: np.ndarray, row: Row) -> np.ndarray:
        return np.where(self._grows, k * (1 + self.values["expansion"] * row.warming(self.PART)), k)
