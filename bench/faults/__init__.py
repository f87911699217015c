"""Faults: what a real robot has and the drawings do not. One file each.

A file of this folder that defines ``FAULT``, a subclass of :class:`Fault`, is a fault; its name is the file's. A fault
acts through MuJoCo: it adds joints, springs and bodies to the MjSpec, moves things before a row is solved, or looks at
MuJoCo's forces afterwards. It never touches the pose itself, and knows nothing of the formulas of :mod:`pcalib`.

The hooks, in the order in which the machine calls them (see :mod:`bench.machine`); a fault overrides what it needs:

    build(spec)           once, before the model is compiled
    geometry(k, row)      the robot's dimensions in this row
    shaft(theta, row)     where the actuators really go for what the controller reads
    prepare(rig, row)     springs, forces, base, gravity
    settle(rig, row)      after the row was solved; True asks to solve it again
    mount(t, row)         where the tool centre point really is in the tool's frame

Faults compose because each has joints of its own: drive spring, backlash and wind-up are hinges on one axis in series.
At zero a fault adds nothing at all (`absent`), so that the rigid robot comes out to the bit.
"""

# pyright: reportAttributeAccessIssue=false
# The names of mujoco come from a compiled module.
from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np

from bench import settings
from bench.commands import Row
from bench.rig import Rig
from bench.settings import Setting
from pcalib.errors import InputError, unknown
from pcalib.robot import Robot


class Fault:
    """Base of all faults: settings as attributes, and hooks that do nothing."""

    SETTINGS: ClassVar[tuple[Setting, ...]]
    """Its numbers; the first ones decide whether the fault is there at all."""
    NEEDS: ClassVar[tuple[str, ...]] = ()
    """Columns of the commands that it cannot do without."""
    loaded: ClassVar[bool] = False
    """Whether it asks for loads."""
    SIZES: ClassVar[tuple[str, ...]] = ()
    """Settings that all vanish where the fault is absent; the first of SETTINGS where empty."""

    def __init__(self, robot: Robot, **values: Any):
        self.robot = robot
        self.values = values
        self.springs: list[str] = []
        """Joints with a stiffness that `build` has added."""
        self.held: list[str] = []
        """Joints that `build` has added and `prepare` or `settle` puts somewhere."""
        for name, value in values.items():
            setattr(self, name, value)

    @property
    def name(self) -> str:
        """The name in files: that of its own."""
        return type(self).__module__.rpartition(".")[2]

    def to_table(self) -> dict[str, Any]:
        """The TOML table that gives this fault again."""
        return settings.write(self.values, self.SETTINGS)

    @property
    def absent(self) -> bool:
        """Whether its sizes are zero."""
        return not any(np.any(self.values[size]) for size in self.SIZES or (self.SETTINGS[0].name,))

    def build(self, spec: mujoco.MjSpec) -> None:
        """Add joints, springs or bodies to the model."""

    def geometry(self, k: np.ndarray, row: Row) -> np.ndarray:
        """The true parameters (nk,) of this row; `k` is not to be changed in place."""
        return k

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        """Where the actuators stand (nq,) [rad or m] when the encoders read `theta`."""
        return theta

    def prepare(self, rig: Rig, row: Row) -> None:
        """Set what the row needs before it is solved."""

    def settle(self, rig: Rig, row: Row) -> bool:
        """Look at the solved row; whether something was changed, so that it must be solved again."""
        return False

    def mount(self, tcp: np.ndarray, row: Row) -> np.ndarray:
        """The TCP (3,) [m] in the frame of the tool's mount."""
        return tcp

    # -- for subclasses ------------------------------------------------------------------------------------------

    def beside(self, spec: mujoco.MjSpec, actuator: str, suffix: str, stiffness: float = 0.0) -> mujoco.MjsJoint:
        """A further joint on the axis of an actuator, in series with it: a spring, or held where it is zero."""
        geared = [e.name1 for e in spec.equalities if e.type == mujoco.mjtEq.mjEQ_JOINT and e.name2 == actuator]
        motor = spec.joint(geared[0] if geared else actuator)  # the joint that bears the load
        joint = motor.parent.add_joint(name=f"{actuator}.{suffix}", type=motor.type, pos=motor.pos, axis=motor.axis)
        self._enlist(joint, stiffness)
        return joint

    def joint(
        self, body: mujoco.MjsBody, name: str, kind: str, axis: tuple[float, float, float], stiffness: float = 0.0
    ) -> mujoco.MjsJoint:
        """A 'hinge' or 'slide' that lets a body move against its parent: a spring, or held where it is zero."""
        types = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
        joint = body.add_joint(name=name, type=types[kind], axis=axis)
        self._enlist(joint, stiffness)
        return joint

    def body(self, spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
        """A body that the fault works on.

        Raises:
            InputError: this kind of robot has no such part.
        """
        body = spec.body(name)
        if body is None:
            raise InputError(
                f"fault '{self.name}' works on '{name}', and a robot of kind '{self.robot.kind}' has none",
                remedy="leave this fault out for this robot",
            )
        return body

    def _enlist(self, joint: mujoco.MjsJoint, stiffness: float) -> None:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        if stiffness:
            joint.stiffness[0] = stiffness
            self.springs.append(joint.name)
        else:
            self.held.append(joint.name)


def names() -> list[str]:
    """The faults that exist, by file name."""
    return sorted(m.name for m in pkgutil.iter_modules(__path__))


def get(name: str) -> type[Fault]:
    """The fault of that name.

    Raises:
        InputError: no such fault.
    """
    if name not in names():
        raise InputError(unknown("fault", name, names()))
    return importlib.import_module(f"{__name__}.{name}").FAULT


def counts(robot: Robot) -> dict[str, int]:
    """How many numbers a setting 'per' something has on a robot."""
    return {"actuator": len(robot.mechanism.actuators), "rod": len(robot.mechanism.rods), "axis": 3}


def make(robot: Robot, name: str, table: Mapping[str, Any]) -> Fault:
    """A fault from its TOML table.

    Raises:
        InputError: no such fault, or settings that it does not take.
    """
    fault = get(name)
    return fault(robot, **settings.read(table, fault.SETTINGS, f"faults.{name}", counts(robot)))
