"""The compiled robot with its faults built in: what a machine moves, and what faults change row by row."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from bench.closing import Loops
from bench.commands import Row
from bench.equilibrium import Equilibrium
from pcalib import rotation
from pcalib.robot import Robot


class Rig:
    """Model and data, with the joints whose values are prescribed.

    Args:
        robot: nominal robot.
        spec: its editable model, with whatever joints faults have added.
        springs: joints with a stiffness, added by faults: they rest where forces balance.
        held: joints added by faults that stand where the fault puts them (:meth:`hold`).
        loaded: whether forces are needed although there may be no springs.
    """

    def __init__(self, robot: Robot, spec: mujoco.MjSpec, springs: Sequence[str], held: Sequence[str], loaded: bool):
        self.robot = robot
        for key in spec.keys:  # their joint vectors fit the file only
            spec.delete(key)
        self.model = spec.compile()
        self.loops = Loops(self.model, [*robot.mechanism.actuators, *springs, *held])
        self.data = self.loops.data
        self.actuators = len(robot.mechanism.actuators)
        self.equilibrium = Equilibrium(self.loops, springs) if springs or loaded else None
        self._held = {name: self.actuators + len(springs) + i for i, name in enumerate(held)}
        self.driven = np.zeros(len(self.loops.driven_qpos))
        """Values of the driven joints: actuators, springs (zero), held ones."""
        self._payload = self.model.body("payload").id
        self._base = self.model.body("base").id
        self._base_pose = self.model.body_pos[self._base].copy(), self.model.body_quat[self._base].copy()

    def prepare(self, row: Row, theta: np.ndarray) -> None:
        """Undo what faults did to the row before, hang on the payload, and set the actuators to theta (nq,)."""
        model = self.model
        self.driven[:] = 0.0
        self.driven[: self.actuators] = theta
        if self.equilibrium is not None:
            self.data.qfrc_applied[:] = 0.0
            model.opt.gravity[:] = self.robot.gravity
            model.body_mass[self._payload] = row.payload
            model.body_pos[self._payload] = row.tool
        model.body_pos[self._base], model.body_quat[self._base] = self._base_pose

    def hold(self, joint: str, value: float, still: float = 0.0) -> bool:
        """Put a held joint somewhere [rad or m]; whether that is elsewhere, by more than `still`, than before."""
        at = self._held[joint]
        moved = abs(value - self.driven[at]) > still
        self.driven[at] = value
        return bool(moved)

    def load(self, joint: str) -> float:
        """Return what a held or actuated joint has to carry [N·m or N] in the row that was solved last.

        It is positive where the joint pushes towards positive values.
        """
        assert self.equilibrium is not None, "a fault that asks for loads must say so: loaded = True"
        return float(self.equilibrium.reaction[self.model.joint(joint).dofadr[0]])

    def move_base(self, translation: np.ndarray, turn: np.ndarray) -> None:
        """Move the robot's base, on top of what has moved it already: x → exp(turn)·x + translation."""
        model = self.model
        R = rotation.exp(turn)
        model.body_pos[self._base] = R @ model.body_pos[self._base] + translation
        old = rotation.from_quaternion(model.body_quat[self._base])
        model.body_quat[self._base] = rotation.to_quaternion(R @ old)
