"""The Hexa in MuJoCo, built from the dimensions of its robot file."""

from __future__ import annotations

import mujoco
import numpy as np

from bench import assembly
from bench.geometry import Place
from bench.kinds import Home, Kind, Variant
from pcalib import rotation
from pcalib.robot import Robot

TAGS = ("1", "2", "3", "4", "5", "6")


def layout(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the azimuth of each motor axis (6,), base points (6, 3) and plate points (6, 3) [m]."""
    size = robot.dimensions
    azimuth = np.repeat(size["axis_azimuth"], 2)
    side = np.array([-0.5, 0.5] * 3)
    turn = rotation.about(assembly.Z, azimuth)

    def points(radius: float, spacing: float) -> np.ndarray:
        return (turn @ np.stack([side * spacing, np.full(6, radius), 0 * side], axis=-1)[..., None])[..., 0]

    base = points(size["base_radius"], size["base_spacing"])
    return azimuth, base, points(size["plate_radius"], size["plate_spacing"])


def build(robot: Robot, azimuth: np.ndarray, base: np.ndarray, plate: np.ndarray) -> mujoco.MjSpec:
    """Build six arms with a rod each."""
    spec = assembly.skeleton(robot)
    for i, tag in enumerate(TAGS):
        elbow, origin = assembly.arm(spec, robot, tag, base[i], azimuth[i])
        assembly.anchor(spec.body("plate"), tag, plate[i])
        end = np.array([0.0, robot.dimensions["arm_length"], 0.0]) - origin
        assembly.rod(spec, robot, elbow, tag, end, robot.dimensions["rod_length"])
    return spec


def places(azimuth: np.ndarray) -> tuple[Place, ...]:
    """Return where the parameters of six arms with a rod each stand."""
    turns = rotation.about(assembly.Z, azimuth)
    return tuple(
        place
        for tag, turn in zip(TAGS, turns, strict=True)
        for place in (
            Place("body", f"arm{tag}", f"p{tag}"),
            Place("turn", f"arm{tag}", f"beta{tag}", nominal=turn),
            Place("body", f"rod{tag}", f"a{tag}", within=f"arm{tag}"),
            Place("site", f"b{tag}", f"b{tag}"),
            Place("rod", f"tip{tag}", f"l{tag}"),
        )
    )


def middle(robot: Robot, azimuth: np.ndarray, base: np.ndarray, plate: np.ndarray) -> Home:
    """Return the home pose: the plate level in the middle of the workspace."""
    x = np.array([0.0, 0.0, 0.5 * (robot.workspace.z_min + robot.workspace.z_max)])
    size = robot.dimensions
    q = [
        assembly.arm_angle(x + b, p, turn, size["arm_length"], size["rod_length"])
        for b, p, turn in zip(plate, base, azimuth, strict=True)
    ]
    return Home(np.array(q), x, np.eye(3))


KIND = Kind(
    name="hexa",
    variants={"rods": Variant(lambda robot: build(robot, *layout(robot)), lambda robot: places(layout(robot)[0]))},
    home=lambda robot: middle(robot, *layout(robot)),
)
