"""Parts that robots are built of in an MjSpec: base, arms, rods, plate and joints, by the names of `bench.kinds`.

A kind puts them together from the dimensions of a robot file; shapes are for looking at, masses are those of the file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from pcalib import rotation
from pcalib.robot import Robot

Point = np.ndarray | Sequence[float]
Z = np.array([0.0, 0.0, 1.0])
GAUSS = ((1 - 1 / math.sqrt(3)) / 2, 1 / math.sqrt(3))
"""Where an arm is cut, as shares of its length: up to the first Gauss point, and on to the second. Two hinges there
bend like a uniform cantilever under forces and moments at its tip and its own weight."""
ARM, ROD, BALL, FRAME, PLATE = (
    [0.95, 0.46, 0.10, 1], [0.72, 0.75, 0.79, 1], [0.20, 0.22, 0.26, 1], [0.30, 0.33, 0.38, 1], [0.16, 0.50, 0.80, 1],
)  # fmt: skip
LEAST = 1e-9
"""[kg, kg·m²] Mass and inertia of a moving body whose mass the robot file does not give; MuJoCo needs some."""


def skeleton(robot: Robot) -> mujoco.MjSpec:
    """Return a model with a base, and a plate that carries tool and payload; z up, limits and contacts off."""
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.compiler.degree = False
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.gravity = robot.gravity
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
    w = robot.workspace
    spec.stat.center = [0.0, 0.0, 0.5 * (w.z_min + w.z_max)]
    spec.stat.extent = 2.5 * max(w.radius, w.z_max - w.z_min)
    spec.worldbody.add_light(pos=[0.9, -1.2, 1.6], dir=[-0.45, 0.6, -0.9])
    spec.worldbody.add_body(name="base")
    plate = body(spec.worldbody, "plate", mass=robot.mass.get("plate", 0.0), size=0.5 * w.radius)
    plate.add_freejoint(name="plate")
    tool = plate.add_body(name="tool")
    draw(tool, mujoco.mjtGeom.mjGEOM_CYLINDER, [0.006, 0.03, 0], ROD, pos=[0, 0, -0.03])
    payload = tool.add_body(name="payload")
    payload.explicitinertial = True
    return spec


def body(
    parent: mujoco.MjsBody,
    name: str,
    pos: Point = (0.0, 0.0, 0.0),
    *,
    mass: float = 0.0,
    com: Point = (0.0, 0.0, 0.0),
    size: float = 0.05,
    turn: np.ndarray | None = None,
) -> mujoco.MjsBody:
    """Add a body with the inertia of a ball of radius `size` [m] about its centre of mass."""
    out = parent.add_body(name=name, pos=list(pos))
    if turn is not None:
        out.quat = rotation.to_quaternion(turn)
    out.explicitinertial = True
    out.mass = max(mass, LEAST)
    out.ipos = list(com)
    out.inertia = [max(0.4 * mass * size**2, LEAST)] * 3
    return out


def draw(parent: mujoco.MjsBody, kind: Any, size: Sequence[float], rgba: Sequence[float], **more: Any) -> None:
    """Draw a shape that has no mass and makes no contact."""
    parent.add_geom(type=kind, size=list(size), rgba=list(rgba), mass=0.0, contype=0, conaffinity=0, group=1, **more)


def bar(parent: mujoco.MjsBody, start: Point, end: Point, radius: float, rgba: Sequence[float]) -> None:
    """Draw a capsule between two points."""
    draw(parent, mujoco.mjtGeom.mjGEOM_CAPSULE, [radius, 0, 0], rgba, fromto=[*start, *end])


def joint(parent: mujoco.MjsBody, name: str, axis: Point, *, slides: bool = False, **more: Any) -> None:
    """Add a hinge, or a slide, to a body."""
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    parent.add_joint(name=name, type=kind, axis=list(axis), **more)


def motor(spec: mujoco.MjSpec, robot: Robot, name: str, follower: str) -> None:
    """Add a driven joint that stands by itself, geared one to one to the joint `follower` by an equality."""
    slides = robot.mechanism.actuator_dimension == "length"
    shaft = body(spec.body("base"), f"motor.{name}")
    joint(shaft, name, Z, slides=slides, range=robot.joint_range)
    spec.add_equality(
        name=f"gear.{name}", type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=follower, name2=name, data=[0.0, 1.0, *[0.0] * 10],
    )  # fmt: skip


def arm(
    spec: mujoco.MjSpec, robot: Robot, tag: str, pos: np.ndarray, azimuth: float
) -> tuple[mujoco.MjsBody, np.ndarray]:
    """Add a motor with its arm in three pieces; return the outermost one, and where its origin stands in the arm's
    frame."""
    length = robot.dimensions["arm_length"]
    mass, com = robot.mass.get("arm", 0.0), robot.mass.get("arm_com", 0.0)
    inner, outer = GAUSS[0] * length, (1 - GAUSS[0]) * length
    pieces = {"arm": (0.0, inner), "beam": (inner, outer), "elbow": (outer, length)}
    part = spec.body("base")
    for name, (start, end) in pieces.items():
        middle, share = 0.5 * (end - start), (end - start) / length
        if name == "arm":
            # A uniform bar; its first piece is shifted so that the whole arm's centre of mass is that of the file.
            middle += (com - length / 2) / share
            turn = rotation.about(Z, np.array(azimuth))
            part = body(part, f"arm{tag}", pos, mass=mass * share, com=(0, middle, 0), turn=turn)
            joint(part, f"q{tag}", (1, 0, 0), range=robot.joint_range)
            draw(part, mujoco.mjtGeom.mjGEOM_CYLINDER, [0.07 * length, 0.08 * length, 0], FRAME, quat=[1, 0, 1, 0])
        else:
            step = inner if name == "beam" else outer - inner
            part = body(part, f"{name}{tag}", (0, step, 0), mass=mass * share, com=(0, middle, 0))
        bar(part, (0, 0, 0), (0, end - start, 0), 0.045 * length, ARM)
    return part, np.array([0.0, outer, 0.0])


def rod(
    spec: mujoco.MjSpec,
    robot: Robot,
    parent: mujoco.MjsBody,
    tag: str,
    pos: Point,
    length: float,
    *,
    turn: np.ndarray | None = None,
    slide: str = "",
) -> None:
    """Add a rod on two hinges that runs along its −z, with half its mass at either quarter; its far end may be on
    a slide.

    A connect joins it to the site b<tag>, which must exist.
    """
    mass = robot.mass.get("rod", 0.0)
    rod = body(parent, f"rod{tag}", pos, mass=mass / 2, com=(0, 0, -length / 4), size=length / 4, turn=turn)
    for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
        joint(rod, f"rod{tag}.{name}", axis)
    tip = body(rod, f"tip{tag}", (0, 0, -length), mass=mass / 2, com=(0, 0, length / 4), size=length / 4)
    if slide:
        joint(tip, slide, (0, 0, -1), slides=True)
        bar(rod, (0, 0, 0), (0, 0, -0.55 * length), 0.016 * length, ARM)
        bar(tip, (0, 0, 0), (0, 0, 0.55 * length), 0.01 * length, ROD)
    else:
        bar(rod, (0, 0, 0), (0, 0, -length), 0.01 * length, ROD)
    for end in (rod, tip):
        draw(end, mujoco.mjtGeom.mjGEOM_SPHERE, [0.018 * length, 0, 0], BALL)
    tip.add_site(name=f"end{tag}")
    spec.add_equality(
        name=f"joint{tag}", type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=f"end{tag}", name2=f"b{tag}",
    )  # fmt: skip


def anchor(parent: mujoco.MjsBody, tag: str, pos: Point, centre: Point = (0.0, 0.0, 0.0)) -> None:
    """Add the site of a plate-side anchor, drawn with a spoke to `centre`."""
    parent.add_site(name=f"b{tag}", pos=list(pos), group=4)
    if np.linalg.norm(np.subtract(pos, centre)) > 1e-6:
        bar(parent, centre, pos, 0.008, PLATE)


def arm_angle(target: np.ndarray, pos: np.ndarray, azimuth: float, reach: float, length: float) -> float:
    """Return q of an arm whose elbow, the upper one of two, stands `length` from a target in the base frame.

    The elbow is at (0, reach·cos q, reach·sin q) in the frame at `pos`, turned by `azimuth` about z.
    """
    _, y, z = rotation.about(Z, np.array(-azimuth)) @ (target - pos)
    far = np.sum((target - pos) ** 2)
    share = (far + reach**2 - length**2) / (2 * reach * math.hypot(y, z))
    return math.atan2(z, y) + math.acos(min(1.0, max(-1.0, share)))
