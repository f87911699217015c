"""The planar five-bar in MuJoCo: two arms on motors, two rods, and a plate that slides in x and y and does not turn."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from bench import assembly
from bench.geometry import Place
from bench.kinds import Home, Kind, Variant
from pcalib.robot import Robot

TURN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Arms and rods run along their −z, which is −y of the base, and turn about their x, which is z of the base."""
ARMS = (("1", -1), ("2", 1))


def _spec(robot: Robot) -> mujoco.MjSpec:
    size, mass = robot.dimensions, robot.mass
    spec = assembly.skeleton(robot)
    base, plate = spec.body("base"), spec.body("plate")
    reach = size["arm_length"]
    for i, side in ARMS:
        foot = [side * size["base_width"] / 2, size["base_height"], 0.0]
        com = (0, 0, -mass.get("arm_com", 0.0))
        arm = assembly.body(base, f"arm{i}", foot, mass=mass.get("arm", 0.0), com=com, size=reach / 4, turn=TURN)
        assembly.joint(arm, f"q{i}", (side, 0, 0), range=robot.joint_range)
        assembly.bar(arm, (0, 0, 0), (0, 0, -reach), 0.015, assembly.ARM)
        elbow = assembly.body(arm, f"elbow{i}", (0, 0, -reach))
        assembly.anchor(plate, i, (0, 0, 0))
        assembly.rod(spec, robot, elbow, i, (0, 0, 0), size["rod_length"])
    slide_x = assembly.body(base, "slide.x")
    assembly.joint(slide_x, "plate.x", (1, 0, 0), slides=True)
    slide_y = assembly.body(slide_x, "slide.y")
    assembly.joint(slide_y, "plate.y", (0, 1, 0), slides=True)
    slide_y.add_site(name="carrier")
    plate.add_site(name="carried")
    spec.add_equality(
        name="plane", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_SITE, name1="carrier", name2="carried"
    )
    return spec


def _places(robot: Robot) -> tuple[Place, ...]:
    return tuple(
        place
        for i, side in ARMS
        for place in (
            Place("turn", f"arm{i}", f"0 0 {'-' * (side < 0)}z{i}", nominal=TURN),
            Place("body", f"arm{i}", f"px{i} py{i} 0"),
            Place("rod", f"elbow{i}", f"a{i}"),
            Place("rod", f"tip{i}", f"l{i}"),
        )
    )


def _home(robot: Robot) -> Home:
    """Return the home pose: the arms straight down and the point in the middle below them."""
    size = robot.dimensions
    down = math.sqrt(size["rod_length"] ** 2 - (size["base_width"] / 2) ** 2)
    return Home(np.zeros(2), np.array([0.0, size["base_height"] - size["arm_length"] - down, 0.0]), np.eye(3))


KIND = Kind(name="five_bar", variants={"rods": Variant(_spec, _places)}, home=_home, rods_down=False)
