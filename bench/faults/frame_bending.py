"""The frame leans under the robot when a load stands off its middle."""

from __future__ import annotations

import mujoco

from bench.faults import Fault
from pcalib.settings import Setting


class FrameBending(Fault):
    """The whole base hangs on two spring hinges, about x and y, at a height above its origin.

    The moment of the payload about the hinges tilts it. Typical: 0.05–0.5 µrad/(N·m).
    """

    MJCF = "hinges `base.x`, `base.y` with `stiffness` between world and body `base`"
    SETTINGS = (
        Setting("compliance", "rotational_compliance", low=0.0, high=1e-4, typical=2e-7, about="1/k about either axis"),
        Setting("height", "length", 0.5, -5.0, 5.0, about="of the hinges above the base's origin"),
    )

    def build(self, spec: mujoco.MjSpec) -> None:
        base = self.body(spec, "base")
        base.explicitinertial, base.mass, base.inertia = True, 1e-9, [1e-9] * 3
        for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
            joint = self.joint(base, f"base.{name}", "hinge", axis, 1.0 / self.values["compliance"])
            joint.pos = (0.0, 0.0, self.values["height"])


FAULT = FrameBending
