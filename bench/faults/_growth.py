"""What the thermal faults share: a part that grows with its temperature."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from bench.commands import Row
from bench.faults import Fault
from pcalib.errors import InputError
from pcalib.robot import Robot
from pcalib.settings import Setting


def expansion(typical: float) -> tuple[Setting, ...]:
    """Return the settings of a thermal fault with a usual α [1/K]."""
    return (Setting("expansion", "expansion", low=-1e-3, high=1e-3, typical=typical, about="α"),)


class Growth(Fault):
    """The dimensions of one part grow by α·(T − 20 °C), where T is the column temp_<part> of the commands."""

    PART: ClassVar[str]
    """Whose temperature counts: arms, rods or base."""

    def __init__(self, robot: Robot, **values: Any):
        super().__init__(robot, **values)
        self._grows = np.zeros(len(robot.mechanism.parameters), bool)
        self._grows[self.dimensions(robot).ravel()] = True
        if not self._grows.any():
            raise InputError(
                f"fault '{self.name}': a robot of kind '{robot.kind}' has no {self.PART} of its own to grow",
                remedy="leave this fault out for this robot",
            )

    def dimensions(self, robot: Robot) -> np.ndarray:
        """Return where the parameters that grow stand in k."""
        raise NotImplementedError

    def geometry(self, k: np.ndarray, row: Row) -> np.ndarray:
        return np.where(self._grows, k * (1 + self.values["expansion"] * row.warming(self.PART)), k)
