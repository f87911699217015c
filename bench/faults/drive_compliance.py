"""The drives give way under load; their stiffness may grow with the deflection."""

from __future__ import annotations

import mujoco

from bench.faults import Fault
from pcalib.settings import Setting


class DriveCompliance(Fault):
    """A spring hinge (or slide) stands on each motor axis, in series with the motor.

    Its torque is k·φ·(1 + h·(φ/1 mrad)²): with h = 0.5 the secant stiffness at 1 mrad is one and a half times k.
    Gearboxes have 41–120 kN·m/rad (8–24 µrad/(N·m)), belts about 15 kN·m/rad.
    """

    MJCF = "a hinge (slide) `q1.spring` with `stiffness` on the body of motor joint `q1`, coaxial with it"
    SETTINGS = (
        Setting(
            "compliance", "drive_compliance", low=0.0, high=2e-3,
            typical=16e-6, per="actuator", about="1/k of each drive",
        ),
        Setting("hardening", "number", 0.0, 0.0, 100.0, about="h: relative growth of the stiffness at 1 mrad"),
    )

    def build(self, spec: mujoco.MjSpec) -> None:
        for name, compliance in zip(self.robot.mechanism.actuators, self.values["compliance"], strict=True):
            if compliance:
                spring = self.beside(spec, name, "spring", 1.0 / compliance)
                spring.stiffness[2] = spring.stiffness[0] * self.values["hardening"] * 1e6


FAULT = DriveCompliance
