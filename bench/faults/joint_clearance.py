"""The spherical joints have play: a rod is longer when it pulls than when it pushes."""

from __future__ import annotations

import mujoco
import numpy as np

from bench.commands import Row
from bench.faults import Fault, rods
from bench.rig import Rig
from pcalib.settings import Setting


class JointClearance(Fault):
    """Every rod has a slide along itself with a dead band of width c, which stands for both of its joints.

    Under tension the balls lie against the far sides of their sockets (δl = +c/2), under compression against the near
    sides (δl = −c/2). The sign is that of the force that MuJoCo finds in the slide. Typical c: 4–12 µm.
    """

    MJCF = "a held slide `rod11.gap` on body `tip11`, put to an end of its play by the force MuJoCo finds in it"
    SETTINGS = (
        Setting("gap", "length", low=0.0, high=1e-3, typical=10e-6, per="rod", about="c, the whole gap of both joints"),
    )
    loaded = True

    def build(self, spec: mujoco.MjSpec) -> None:
        for rod in rods(self.robot):
            self.joint(self.body(spec, f"tip{rod}"), f"rod{rod}.gap", "slide", (0, 0, -1))

    def settle(self, rig: Rig, row: Row) -> bool:
        ends = [np.sign(rig.load(joint)) * gap / 2 for joint, gap in zip(self.held, self.values["gap"], strict=True)]
        return any([rig.hold(joint, end) for joint, end in zip(self.held, ends, strict=True)])


FAULT = JointClearance
