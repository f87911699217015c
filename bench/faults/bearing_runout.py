"""The motor bearings run out: each motor axis moves as its arm turns."""

from __future__ import annotations

import mujoco
import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.rig import Rig
from pcalib.settings import Setting


class BearingRunout(Fault):
    """The motor axis moves on a circle of radius e about its mean place, n times per turn of the arm.

    Two slides on the arm carry the axis; seen from the arm, the axis runs round the circle n − 1 times per turn. With
    n = 1 the arm would be mounted off centre, which is geometry; an oval race has n = 2, a ball cage n = 0.4. Typical
    e: 2–20 µm.
    """

    MJCF = "held slides `q1.out_y`, `q1.out_z` on the arm body"
    SETTINGS = (
        Setting("radius", "length", low=0.0, high=1e-3, typical=10e-6, per="actuator", about="e"),
        Setting("cycles", "count", 2.0, 0.0, 100.0, about="n"),
        Setting("phase", "angle", 0.0, per="actuator", about="where the axis is at q = 0"),
    )
    ROTARY = True

    def build(self, spec: mujoco.MjSpec) -> None:
        for name in self.robot.mechanism.actuators:
            body = spec.joint(name).parent
            self.joint(body, f"{name}.out_y", "slide", (0, 1, 0))
            self.joint(body, f"{name}.out_z", "slide", (0, 0, 1))

    def prepare(self, rig: Rig, row: Row) -> None:
        angle = (self.values["cycles"] - 1) * rig.driven[: rig.actuators] + self.values["phase"]
        for i in range(rig.actuators):
            rig.hold(self.held[2 * i], self.values["radius"][i] * np.cos(angle[i]))
            rig.hold(self.held[2 * i + 1], self.values["radius"][i] * np.sin(angle[i]))


FAULT = BearingRunout
