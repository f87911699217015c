"""The H4 in MuJoCo: four arms, eight rods, a plate with two side bodies on hinges."""

from __future__ import annotations

import mujoco
import numpy as np

from bench import assembly
from bench.geometry import Place
from bench.kinds import Home, Kind, Variant
from pcalib import rotation
from pcalib.robot import Robot

ARMS = ("1", "2", "3", "4")
SIDE = {"1": "1", "2": "1", "3": "2", "4": "2"}
"""The side body that each arm's rods hold."""


def _outward(arm: str) -> np.ndarray:
    """Return where its side body stands, seen from the middle."""
    return np.array([1.0 if SIDE[arm] == "1" else -1.0, 0.0, 0.0])


def _turn(robot: Robot, arm: str) -> np.ndarray:
    return rotation.about(assembly.Z, robot.dimensions["axis_azimuth"][int(arm) - 1])


def _base(robot: Robot, arm: str) -> np.ndarray:
    size = robot.dimensions
    return 0.5 * size["base_spacing"] * _outward(arm) + _turn(robot, arm) @ [0, size["base_radius"], 0]


def _middle_of_pair(robot: Robot, arm: str) -> np.ndarray:
    size = robot.dimensions
    return 0.5 * size["hinge_distance"] * _outward(arm) + _turn(robot, arm) @ [0, size["side_radius"], 0]


def _spec(robot: Robot) -> mujoco.MjSpec:
    size = robot.dimensions
    spec = assembly.skeleton(robot)
    plate, half = spec.body("plate"), 0.5 * size["rod_spacing"]
    for side, arm in (("1", "1"), ("2", "3")):
        point = 0.5 * size["hinge_distance"] * _outward(arm)
        # Both bodies have the plate's origin: only the joint's own point and axis say where the hinge is.
        part = assembly.body(plate, f"side{side}")
        assembly.joint(part, f"hinge{side}", assembly.Z, pos=list(point))
        assembly.bar(plate, (0, 0, 0), point, 0.012, assembly.PLATE)
    for arm in ARMS:
        azimuth = size["axis_azimuth"][int(arm) - 1]
        elbow, origin = assembly.arm(spec, robot, arm, _base(robot, arm), azimuth)
        ends = [np.array([x, size["arm_length"], 0.0]) - origin for x in (-half, half)]
        assembly.bar(elbow, ends[0], ends[1], 0.02 * size["arm_length"], assembly.BALL)
        for j, x, end in (("1", -half, ends[0]), ("2", half, ends[1])):
            hinge = 0.5 * size["hinge_distance"] * _outward(arm)
            b = _middle_of_pair(robot, arm) + _turn(robot, arm) @ [x, 0, 0]
            assembly.anchor(spec.body(f"side{SIDE[arm]}"), arm + j, b, hinge)
            assembly.rod(spec, robot, elbow, arm + j, end, size["rod_length"])
    return spec


def _places(robot: Robot) -> tuple[Place, ...]:
    pairs = [arm + j for arm in ARMS for j in "12"]
    return (
        *(Place("body", f"arm{i}", f"p{i}") for i in ARMS),
        *(Place("turn", f"arm{i}", f"beta{i}", nominal=_turn(robot, i)) for i in ARMS),
        *(Place("body", f"rod{r}", f"a{r}", within=f"arm{r[0]}") for r in pairs),
        *(Place("site", f"b{r}", f"b{r}") for r in pairs),
        *(Place("rod", f"tip{r}", f"l{r}") for r in pairs),
        *(Place("pivot", f"hinge{h}", f"hinge{h}") for h in "12"),
        *(Place("axis", f"hinge{h}", f"tilt{h}", nominal=assembly.Z) for h in "12"),
    )


def _home(robot: Robot) -> Home:
    """Return the home pose: the plate level and unturned in the middle of the workspace."""
    size = robot.dimensions
    x = np.array([0.0, 0.0, 0.5 * (robot.workspace.z_min + robot.workspace.z_max)])
    q = [
        assembly.arm_angle(
            x + _middle_of_pair(robot, arm), _base(robot, arm), size["axis_azimuth"][int(arm) - 1],
            size["arm_length"], size["rod_length"],
        )
        for arm in ARMS
    ]  # fmt: skip
    return Home(np.array(q), x, np.eye(3))


KIND = Kind(name="h4", variants={"rods": Variant(_spec, _places)}, home=_home)
