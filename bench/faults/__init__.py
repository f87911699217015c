"""Faults: deviations of a real robot from its drawings and from what its controller assumes, one file each.

A file of this folder that defines ``FAULT``, a subclass of :class:`Fault`, is a fault; its name is the file's. Files
that start with `_` hold what several share. A fault acts through MuJoCo: it adds joints, springs and bodies to the
MjSpec, moves things before a row is solved, or looks at MuJoCo's forces afterwards. It never touches the pose itself,
and knows nothing of the formulas of :mod:`pcalib`.

The hooks, in the order in which the machine calls them (see :mod:`bench.machine`); a fault overrides what it needs:

    history(commands)     once, all rows: what a row remembers of those before it
    build(spec)           once, before the model is compiled
    geometry(k, row)      the robot's dimensions in this row
    shaft(theta, row)     where the actuators really go for what the controller reads
    prepare(rig, row)     springs, forces, base, gravity
    settle(rig, row)      after the row was solved; True asks to solve it again
    mount(t, row)         where the tool centre point really is in the tool's frame
    seen(x, R, commands)  all rows at once, in the frame of the instrument: what is wrong with that

Faults compose because each has joints of its own: drive spring, backlash and wind-up are hinges on one axis in series.
At zero a fault adds nothing at all (`absent`), so that the rigid robot comes out to the bit.

Settings may be of a dimension that the robot decides: 'drive' is an angle on rotary drives and a length on carriages,
'drive_compliance' and 'drive_per_kelvin' likewise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import mujoco
import numpy as np

from bench import kinds
from bench.commands import Commands, Row
from bench.rig import Rig
from pcalib import settings
from pcalib.errors import InputError
from pcalib.registry import Registry
from pcalib.robot import Robot
from pcalib.settings import Setting

_OF_DRIVES = {
    "drive": {"angle": ("angle", 1.0), "length": ("length", 0.05)},
    "drive_compliance": {"angle": ("rotational_compliance", 1.0), "length": ("compliance", 0.002)},
    "drive_per_kelvin": {"angle": ("angle_per_kelvin", 1.0), "length": ("length_per_kelvin", 0.1)},
}
"""Dimension by what the drives do, and the usual size on carriages per usual size on arms."""


STIFFEST = 1e13
"""[N/m, N·m/rad] A spring that is stiffer counts as rigid: it gives way by picometres."""


class Fault:
    """Base of all faults: settings as attributes, and hooks that do nothing."""

    SETTINGS: ClassVar[tuple[Setting, ...]]
    """The numbers of the fault."""
    MJCF: ClassVar[str]
    """What it is in the model, for the documentation."""
    NEEDS: ClassVar[tuple[str, ...]] = ()
    """Columns of the commands that it cannot do without."""
    loaded: ClassVar[bool] = False
    """Whether it asks for loads."""
    SIZES: ClassVar[tuple[str, ...]] = ()
    """Settings that all vanish where the fault is absent; the first of SETTINGS where empty."""
    STAGE: ClassVar[int] = 0
    """Where several act on one thing, the order in which they stand in the machine: encoder before gear."""
    ROTARY: ClassVar[bool] = False
    """Whether it makes sense on rotary drives only."""

    def __init__(self, robot: Robot, **values: Any):
        if self.ROTARY and robot.mechanism.actuator_dimension != "angle":
            raise InputError(
                f"fault '{self.name}' is one of rotary drives, and those of a {robot.kind} move along a length",
                remedy="leave this fault out for this robot",
            )
        self.robot = robot
        self.values = values
        self.springs: list[str] = []
        """Joints with a stiffness that `build` has added."""
        self.held: list[str] = []
        """Joints that `build` has added and `prepare` or `settle` puts somewhere."""

    @classmethod
    def settings(cls, robot: Robot) -> tuple[Setting, ...]:
        """Return SETTINGS with the dimensions that this robot's drives give them."""
        out = []
        for setting in cls.SETTINGS:
            if setting.dimension in _OF_DRIVES:
                dimension, share = _OF_DRIVES[setting.dimension][robot.mechanism.actuator_dimension]
                usual = None if setting.typical is None else setting.typical * share
                setting = replace(setting, dimension=dimension, typical=usual)
            out.append(setting)
        return tuple(out)

    @property
    def name(self) -> str:
        """The name in files: that of its own."""
        return type(self).__module__.rpartition(".")[2]

    def to_table(self) -> dict[str, Any]:
        """Return the TOML table that gives this fault again."""
        return settings.write(self.values, self.settings(self.robot))

    @property
    def absent(self) -> bool:
        """Whether its sizes are zero."""
        return not any(np.any(self.values[size]) for size in self.SIZES or (self.SETTINGS[0].name,))

    def history(self, commands: Commands) -> Mapping[str, np.ndarray]:
        """Return further columns (N,) of the commands, which hold what each row remembers of the rows before it."""
        return {}

    def build(self, spec: mujoco.MjSpec) -> None:
        """Add joints, springs or bodies to the model."""

    def geometry(self, k: np.ndarray, row: Row) -> np.ndarray:
        """Return the true parameters (nk,) of this row; `k` is not to be changed in place."""
        return k

    def shaft(self, theta: np.ndarray, row: Row) -> np.ndarray:
        """Return where the actuators stand (nq,) [rad or m] when the encoders read `theta`."""
        return theta

    def prepare(self, rig: Rig, row: Row) -> None:
        """Set what the row needs before it is solved."""

    def settle(self, rig: Rig, row: Row) -> bool:
        """Look at the solved row; whether something was changed, so that it must be solved again."""
        return False

    def mount(self, tcp: np.ndarray, row: Row) -> np.ndarray:
        """Return the TCP (3,) [m] in the frame of the tool's mount."""
        return tcp

    def seen(self, position: np.ndarray, R: np.ndarray, commands: Commands) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (N, 3) [m] and rotations (N, 3, 3) as the instrument sees them, in its own frame."""
        return position, R

    # -- for subclasses ------------------------------------------------------------------------------------------

    def beside(self, spec: mujoco.MjSpec, actuator: str, suffix: str, stiffness: float = 0.0) -> mujoco.MjsJoint:
        """Add a further joint on the axis of an actuator, in series with it: a spring, or held, see
        :meth:`joint`."""
        geared = [e.name1 for e in spec.equalities if e.type == mujoco.mjtEq.mjEQ_JOINT and e.name2 == actuator]
        motor = spec.joint(geared[0] if geared else actuator)  # the joint that bears the load
        joint = motor.parent.add_joint(name=f"{actuator}.{suffix}", type=motor.type, pos=motor.pos, axis=motor.axis)
        self._enlist(joint, stiffness)
        return joint

    def joint(
        self, body: mujoco.MjsBody, name: str, kind: str, axis: tuple[float, float, float], stiffness: float = 0.0
    ) -> mujoco.MjsJoint:
        """Add a 'hinge' or 'slide' that lets a body move against its parent: a spring, or held if of no
        stiffness, or of more than STIFFEST."""
        types = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
        joint = body.add_joint(name=name, type=types[kind], axis=axis)
        self._enlist(joint, stiffness)
        return joint

    def body(self, spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
        """Return a body that the fault works on.

        Raises:
            InputError: this kind of robot has no such part.
        """
        return self._part(spec.body(name), name)

    def site(self, spec: mujoco.MjSpec, name: str) -> mujoco.MjsSite:
        """Return a site that the fault works on; errors as for :meth:`body`."""
        return self._part(spec.site(name), name)

    def _part(self, found: Any, name: str) -> Any:
        if found is None:
            raise InputError(
                f"fault '{self.name}' works on '{name}', and a robot of kind '{self.robot.kind}' has none",
                remedy="leave this fault out for this robot",
            )
        return found

    def _enlist(self, joint: mujoco.MjsJoint, stiffness: float) -> None:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.armature = 1e-4  # joints in series would have no inertia of their own; at rest it makes no difference
        if 0 < stiffness <= STIFFEST:
            joint.stiffness[0] = stiffness
            self.springs.append(joint.name)
        else:
            self.held.append(joint.name)


FAULTS = Registry[type[Fault]](__name__, "FAULT", "fault")
names, get = FAULTS.names, FAULTS.get


def present(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Return the faults that are not of size zero, in the order in which they act, whatever the order in which they are
    listed."""
    return tuple(sorted((fault for fault in faults if not fault.absent), key=lambda fault: (fault.STAGE, fault.name)))


def suit(robot: Robot, faults: Iterable[Fault]) -> None:
    """Refuse faults of parts that this kind of robot does not have.

    Raises:
        InputError: its key names the section of the fault.
    """
    made = present(faults)
    spec = kinds.get(robot.kind).variants["rods"].spec(robot) if made else None
    for fault in made:
        try:
            fault.build(spec)
        except InputError as error:
            raise error.but(section="faults", key=fault.name) from None


def suited(robot: Robot) -> list[str]:
    """Return the faults that this kind of robot can have, by name."""
    out = []
    for name in names():
        try:
            suit(robot, [typical(robot, name)])
        except InputError:
            continue
        out.append(name)
    return out


def rods(robot: Robot) -> tuple[str, ...]:
    """Return names of the rods that are bodies: the drive of a driven rod has a row among them, and is none."""
    return tuple(rod for rod in robot.mechanism.rods if rod != "drive")


def counts(robot: Robot) -> dict[str, int]:
    """Return how many numbers a setting 'per' something has on a robot."""
    return {"actuator": len(robot.mechanism.actuators), "rod": len(rods(robot))}


def typical(robot: Robot, name: str, scale: float = 1.0) -> Fault:
    """Return a fault of usual size, or of a multiple of it; what is no size keeps its usual value.

    Raises:
        InputError: no such fault, or none that this kind of robot can have.
    """
    fault, values = get(name), {}
    sizes = fault.SIZES or (fault.SETTINGS[0].name,)
    for setting in fault.settings(robot):
        value = setting.default if setting.typical is None else setting.typical
        if setting.name in sizes:
            value = np.multiply(value, scale)
        values[setting.name] = settings.spread(setting, value, counts(robot))
    return fault(robot, **values)


def make(robot: Robot, name: str, table: Mapping[str, Any]) -> Fault:
    """Return a fault from its TOML table.

    Raises:
        InputError: no such fault, or settings that it does not take.
    """
    try:
        fault = get(name)
        return fault(robot, **settings.read(table, fault.settings(robot), f"faults.{name}", counts(robot)))
    except InputError as error:
        raise error if error.key else error.but(section="faults", key=name) from None
