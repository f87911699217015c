"""The tool bends under its payload."""

from __future__ import annotations

import mujoco
import numpy as np

from bench.commands import Row
from bench.faults import Fault
from bench.rig import Rig
from pcalib.settings import Setting

REFERENCE = 0.1
"""[m] length of the tool that the compliance is stated for."""


class ToolBending(Fault):
    """Spring hinges at the foot of the tool give its tip the compliance c·(h/100 mm)³ of a cantilever, h = |t|.

    c is the compliance h³/3EI at the tip of a tool of 100 mm. The instrument sees the rotation of the plate, not that
    of the tool. A tool that hangs plumb does not bend. Typical c: 0.5–5 µm/N.
    """

    MJCF = "hinges `tool.x`, `tool.y`, `tool.z` on body `tool`, their `stiffness` set for the length of each row's tool"
    SETTINGS = (Setting("compliance", "compliance", low=0.0, high=1e-3, typical=2e-6, about="c, of a tool of 100 mm"),)

    def build(self, spec: mujoco.MjSpec) -> None:
        tool = self.body(spec, "tool")
        tool.explicitinertial, tool.mass, tool.inertia = True, 1e-9, [1e-9] * 3
        for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))):
            self.joint(tool, f"tool.{name}", "hinge", axis, 1.0)

    def prepare(self, rig: Rig, row: Row) -> None:
        length = max(float(np.linalg.norm(row.tool)), 1e-3)
        # A force F on the tip turns the foot by F·h/κ, and so moves the tip by F·h²/κ.
        stiffness = length**2 / (self.values["compliance"] * (length / REFERENCE) ** 3)
        for name in self.springs:
            rig.model.jnt_stiffness[rig.model.joint(name).id] = stiffness


FAULT = ToolBending
