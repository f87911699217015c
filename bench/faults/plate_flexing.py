"""The ears of the plate bend out of its plane under the pull of the rods."""

from __future__ import annotations

from typing import Any

import mujoco

from bench.faults import Fault, rods
from pcalib.errors import InputError
from pcalib.robot import Robot
from pcalib.settings import Setting


class PlateFlexing(Fault):
    """Each plate-side anchor sits on a spring slide along the normal of the plate. Typical: 0.02–0.2 µm/N."""

    MJCF = "bodies `ear11` … on spring slides along the plate's normal, which carry the sites of the joints"
    SETTINGS = (
        Setting("compliance", "compliance", low=0.0, high=1e-4, typical=1e-7, per="rod", about="1/k of each ear"),
    )

    def __init__(self, robot: Robot, **values: Any):
        if robot.kind == "planar":
            raise InputError(
                "fault 'plate_flexing': the rods of a planar robot do not pull out of its plate's plane",
                remedy="leave this fault out for this robot",
            )
        super().__init__(robot, **values)

    def build(self, spec: mujoco.MjSpec) -> None:
        for rod, compliance in zip(rods(self.robot), self.values["compliance"], strict=True):
            if not compliance:
                continue
            site = self.site(spec, f"b{rod}")
            # The ear hangs in the plate's origin, so that the site keeps its coordinates.
            ear = site.parent.add_body(name=f"ear{rod}")
            ear.explicitinertial, ear.mass, ear.inertia = True, 1e-9, [1e-9] * 3
            spec.delete(site)
            ear.add_site(name=f"b{rod}")
            self.joint(ear, f"ear{rod}.z", "slide", (0, 0, 1), 1.0 / compliance)


FAULT = PlateFlexing
