"""The drives have play: each arm lies against one flank of its gear or against the other."""

from __future__ import annotations

import mujoco
import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.rig import Rig
from pcalib.settings import Setting


class Backlash(Fault):
    """Every motor axis has a dead band of width b, and the arm stands at one of its ends.

    With side = "direction" friction keeps the arm behind its last motion, at −b/2·dir. Where a row has no direction,
    and with side = "load", the load that MuJoCo finds on the joint pushes the arm to an end. Typical b: 1–3 arcmin.
    """

    MJCF = "a held hinge (slide) `q1.gap` on the motor axis, put to an end of its play"
    SETTINGS = (
        Setting("gap", "drive", low=0.0, high=0.05, typical=6e-4, per="actuator", about="b, the whole gap"),
        Setting("side", "word", "direction", words=("direction", "load"), about="what decides the side"),
    )
    loaded = True

    def build(self, spec: mujoco.MjSpec) -> None:
        for name in self.robot.mechanism.actuators:
            self.beside(spec, name, "gap")

    def _end(self, i: int, row: Row) -> float:
        """Return −1, +1, or 0 where the load decides."""
        return -row.direction(i) if self.values["side"] == "direction" else 0.0

    def prepare(self, rig: Rig, row: Row) -> None:
        for i, joint in enumerate(self.held):
            rig.hold(joint, self._end(i, row) * self.values["gap"][i] / 2)

    def settle(self, rig: Rig, row: Row) -> bool:
        moved = False
        for i, joint in enumerate(self.held):
            if not self._end(i, row):
                moved |= rig.hold(joint, np.sign(rig.load(joint)) * self.values["gap"][i] / 2)
        return moved


FAULT = Backlash
