"""Friction in the drives grows with the load, so that each arm stops short of its command."""

from __future__ import annotations

import mujoco

from bench.commands import Row
from bench.faults import Fault
from bench.rig import Rig
from pcalib.settings import Setting

STILL = 1e-14
"""[rad or m] A smaller change of the wind-up counts as none."""


class FrictionHysteresis(Fault):
    """A slider and a spring k stand on each motor axis; the slider yields at μ·|τ|, where τ is the load on the joint.

    A motion that is longer than the wind-up c·|τ|, c = μ/k, ends with the slider at its yield point, so that the arm
    stands at −c·|τ|·dir behind its motor. MuJoCo finds τ, which changes with the wind-up. Typical c: 10 µrad/(N·m).
    """

    MJCF = "a held hinge (slide) `q1.windup` on the motor axis, put where the yielded slider leaves it"
    SETTINGS = (
        Setting(
            "per_load", "drive_compliance", low=0.0, high=1e-3,
            typical=1e-5, per="actuator", about="c of each drive",
        ),
    )
    loaded = True

    @property
    def NEEDS(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(f"dir{i + 1}" for i in range(len(self.robot.mechanism.actuators)))

    def build(self, spec: mujoco.MjSpec) -> None:
        for name in self.robot.mechanism.actuators:
            self.beside(spec, name, "windup")

    def settle(self, rig: Rig, row: Row) -> bool:
        winds = [
            -row.direction(i) * self.values["per_load"][i] * abs(rig.load(joint)) for i, joint in enumerate(self.held)
        ]
        return any([rig.hold(joint, wind, STILL) for joint, wind in zip(self.held, winds, strict=True)])


FAULT = FrictionHysteresis
