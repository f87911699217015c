"""The arms bend under the pull of their rods and under their own weight."""

from __future__ import annotations

import mujoco

from bench.assembly import GAUSS
from bench.faults import Fault
from pcalib.settings import Setting


class ArmBending(Fault):
    """Every arm has two spring hinges at its Gauss points, in the arm's plane (vertical) and across it (lateral).

    Hinges of stiffness 2EI/L at (1 ∓ 1/√3)/2 of the length L integrate the bending line exactly for forces and moments
    at the tip and for the arm's own uniform weight, so this is an Euler–Bernoulli cantilever: a force on the elbow
    moves it by c = L³/3EI and turns it by 1.5·c/L. Typical c: 0.05–0.5 µm/N (elbow stiffness 2–20 N/µm).
    """

    MJCF = (
        "hinges `beam1.vertical`, `elbow1.vertical` (and `.lateral`) with `stiffness` at the two "
        "Gauss points of the arm"
    )
    SETTINGS = (
        Setting("vertical", "compliance", 0.0, 0.0, 1e-4, typical=2e-7, per="actuator", about="c in the arm's plane"),
        Setting("lateral", "compliance", 0.0, 0.0, 1e-4, typical=2e-7, per="actuator", about="c along the motor axis"),
    )
    SIZES = ("vertical", "lateral")

    def build(self, spec: mujoco.MjSpec) -> None:
        for i, actuator in enumerate(self.robot.mechanism.actuators):
            tag = actuator.removeprefix("q")
            length = self.body(spec, f"beam{tag}").pos[1] / GAUSS[0]
            for way, axis in (("vertical", (1, 0, 0)), ("lateral", (0, 0, 1))):
                compliance = self.values[way][i]
                if compliance:
                    for part in ("beam", "elbow"):
                        body = self.body(spec, f"{part}{tag}")
                        self.joint(body, f"{part}{tag}.{way}", "hinge", axis, 2 * length**2 / (3 * compliance))


FAULT = ArmBending
