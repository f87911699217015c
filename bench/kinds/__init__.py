"""Robot kinds of the bench: one file each, which brings the kind's MJCF and says what stands where in it.

A file of this folder that defines ``KIND`` is a kind. The rest of the bench finds its way by these names:

    base            body, fixed to the world; everything but the plate hangs on it
    q1 …            driven joints, the names of the robot's actuators
    rod<r>          body at the base-side anchor of rod r, on hinges rod<r>.x and rod<r>.y; the rod runs along its −z
    tip<r>          body at the far end of the rod, with a site end<r>
    b<r>            site of the plate-side anchor; a connect joins it to end<r>
    plate           body on a free joint; tool and payload are bodies on it

Spatial tendons may stand in for rod bodies in a further variant, between sites a<r> and b<r>.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from bench.geometry import Place
from pcalib.registry import Registry
from pcalib.robot import MODELS as MODELS
from pcalib.robot import Robot


@dataclass(frozen=True)
class Home:
    """A pose in the middle of the working branch, good to a few centimetres; every solution grows from it."""

    q: np.ndarray
    """(nq,) actuator values [rad or m]."""
    x: np.ndarray
    """(3,) [m] plate position."""
    R: np.ndarray
    """(3, 3) plate orientation."""


@dataclass(frozen=True)
class Variant:
    """One way to model the kind."""

    spec: Callable[[Robot], mujoco.MjSpec]
    """Editable model with the masses and joint ranges of a robot file; its geometry is written afterwards."""
    places: Callable[[Robot], tuple[Place, ...]]


@dataclass(frozen=True)
class Kind:
    """What the bench needs to know of a robot kind."""

    name: str
    variants: Mapping[str, Variant]
    """'rods' (bodies; what faults build on) and further cross-checks."""
    home: Callable[[Robot], Home]
    max_tilt: float = 0.3
    """[rad] a plate turned further than this beyond what its robot commands is on a wrong branch."""
    rods_down: bool = True
    """Whether every rod runs downwards on the working branch."""

    def max_turn(self, robot: Robot) -> float:
        """Return the angle [rad] from the home orientation up to which a plate is taken to be on the working branch."""
        task, space = robot.mechanism.task, robot.workspace
        commanded = space.tilt * (3 in task or 4 in task) + space.yaw * (5 in task)
        return min(self.max_tilt + commanded, np.pi)


KINDS = Registry[Kind](__name__, "KIND", "robot kind", remedy="the virtual robot has no MuJoCo model of it")
names, get = KINDS.names, KINDS.get
