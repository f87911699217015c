"""The Delta in MuJoCo: models/delta.xml (rod bodies) and models/delta_tendon.xml (rods as tendons).

The files are the robot of models/delta.toml. For another Delta the masses, joint ranges and shapes are edited in the
MjSpec; lengths and angles are written in place like any perturbation.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from bench.assembly import GAUSS, LEAST
from bench.geometry import Place
from bench.kinds import MODELS, Home, Kind, Variant
from pcalib import rotation
from pcalib.errors import InputError
from pcalib.robot import Robot

Z = np.array([0.0, 0.0, 1.0])
PAIRS = [(i, j) for i in (1, 2, 3) for j in (1, 2)]


def _rods(robot: Robot) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(MODELS / "delta.xml"))
    arm, com, rod, plate = (robot.mass.get(key, 0.0) for key in ("arm", "arm_com", "rod", "plate"))
    length = robot.dimensions["arm_length"]
    cuts = (GAUSS[0], GAUSS[1], GAUSS[0])
    for i in (1, 2, 3):
        for body, share in zip(("arm", "beam", "elbow"), cuts, strict=True):
            part = spec.body(f"{body}{i}")
            part.mass = max(arm * share, LEAST)
            part.ipos = (0.0, share * length / 2, 0.0)
        # A uniform bar; its first piece is shifted so that the whole arm's centre of mass is that of the file.
        spec.body(f"arm{i}").ipos = (0.0, cuts[0] * length / 2 + (com - length / 2) / cuts[0], 0.0)
        spec.body(f"beam{i}").pos = (0.0, cuts[0] * length, 0.0)
        spec.body(f"elbow{i}").pos = (0.0, cuts[1] * length, 0.0)
    quarter = robot.dimensions["rod_length"] / 4
    for i, j in PAIRS:
        for body, where in (("rod", -quarter), ("tip", quarter)):
            spec.body(f"{body}{i}{j}").mass = max(rod / 2, LEAST)
            spec.body(f"{body}{i}{j}").ipos = (0.0, 0.0, where)
    _common(spec, robot, plate)
    return spec


def _tendons(robot: Robot) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(MODELS / "delta_tendon.xml"))
    for i in (1, 2, 3):
        spec.body(f"arm{i}").mass = max(robot.mass.get("arm", 0.0), LEAST)
        spec.body(f"arm{i}").ipos = (0.0, robot.mass.get("arm_com", 0.0), 0.0)
    _common(spec, robot, robot.mass.get("plate", 0.0))
    return spec


def _common(spec: mujoco.MjSpec, robot: Robot, plate_mass: float) -> None:
    spec.body("plate").mass = max(plate_mass, LEAST)
    spec.option.gravity = robot.gravity
    for i in (1, 2, 3):
        spec.joint(f"q{i}").range = np.degrees(robot.joint_range)  # the file is in degrees
        turn = rotation.to_quaternion(rotation.about(Z, robot.dimensions["axis_azimuth"][i - 1]))
        for frame in (f"axis{i}", f"side{i}"):
            spec.frame(frame).alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            spec.frame(frame).quat = turn
    _reshape(spec, robot)


def _reshape(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Stretch the drawn shapes, laid out for models/delta.toml, to another Delta's dimensions."""
    size = robot.dimensions
    across = size["rod_spacing"] / 0.100
    along = {
        "arm": (across, size["arm_length"] / 0.350, 1.0),
        "rod": (1.0, 1.0, size["rod_length"] / 0.800),
        "pla": (across, size["plate_radius"] / 0.050, 1.0),
        "bas": (1.0, size["base_radius"] / 0.200, 1.0),
    }
    along |= {"bea": along["arm"], "elb": along["arm"], "tip": along["rod"]}
    for geom in spec.geoms:
        scale = np.array(along.get(geom.parent.name[:3], (1.0, 1.0, 1.0)))
        if np.isnan(geom.fromto[0]):
            geom.pos = np.asarray(geom.pos) * scale
        else:
            geom.fromto = np.asarray(geom.fromto) * np.tile(scale, 2)


def _arms_and_plate(robot: Robot) -> list[Place]:
    azimuth = robot.dimensions["axis_azimuth"]
    return [
        *(Place("body", f"arm{i}", f"p{i}") for i in (1, 2, 3)),
        *(Place("turn", f"arm{i}", f"beta{i}", nominal=rotation.about(Z, azimuth[i - 1])) for i in (1, 2, 3)),
        *(Place("site", f"b{i}{j}", f"b{i}{j}") for i, j in PAIRS),
    ]


def _rod_places(robot: Robot) -> tuple[Place, ...]:
    return (
        *_arms_and_plate(robot),
        *(Place("body", f"rod{i}{j}", f"a{i}{j}", within=f"arm{i}") for i, j in PAIRS),
        *(Place("rod", f"tip{i}{j}", f"l{i}{j}") for i, j in PAIRS),
    )


def _tendon_places(robot: Robot) -> tuple[Place, ...]:
    return (
        *_arms_and_plate(robot),
        *(Place("site", f"a{i}{j}", f"a{i}{j}") for i, j in PAIRS),
        *(Place("tendon", f"rod{i}{j}", f"l{i}{j}") for i, j in PAIRS),
    )


def home(robot: Robot) -> Home:
    """Return the home pose: all arms a little below the middle of their range, so that the plate hangs level."""
    size, (low, high) = robot.dimensions, robot.joint_range
    for share in (0.35, 0.3, 0.4, 0.2, 0.5, 0.1, 0.6):
        q = low + share * (high - low)
        out = size["base_radius"] + size["arm_length"] * math.cos(q) - size["plate_radius"]
        if abs(out) < 0.95 * size["rod_length"]:
            z = size["arm_length"] * math.sin(q) - math.sqrt(size["rod_length"] ** 2 - out**2)
            return Home(np.full(3, q), np.array([0.0, 0.0, z]), np.eye(3))
    raise InputError(
        "this Delta cannot be assembled: its rods are too short to join arms and plate anywhere in the joint range",
        remedy="check [geometry] and [joints] of the robot file",
    )


KIND = Kind(
    name="delta",
    variants={"rods": Variant(_rods, _rod_places), "tendons": Variant(_tendons, _tendon_places)},
    home=home,
)
