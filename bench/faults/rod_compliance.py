"""The rods stretch and shorten under their forces."""

from __future__ import annotations

import mujoco

from bench.faults import Fault, rods
from pcalib.settings import Setting


class RodCompliance(Fault):
    """Every rod has a spring slide at its end, along the rod: δl = T/k at the tension T.

    The spring lies between two halves of the rod's mass, so that it bears the mean tension of a rod that hangs by its
    own weight. Carbon rods have 10–50 N/µm (0.02–0.1 µm/N).
    """

    MJCF = "a slide `rod11.stretch` with `stiffness` on body `tip11`, along the rod"
    SETTINGS = (
        Setting("compliance", "compliance", low=0.0, high=1e-4, typical=5e-8, per="rod", about="1/k of each rod"),
    )

    def build(self, spec: mujoco.MjSpec) -> None:
        for rod, compliance in zip(rods(self.robot), self.values["compliance"], strict=True):
            if compliance:
                self.joint(self.body(spec, f"tip{rod}"), f"rod{rod}.stretch", "slide", (0, 0, -1), 1.0 / compliance)


FAULT = RodCompliance
