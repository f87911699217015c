"""The linear Delta in MuJoCo: carriages on leaning towers, each geared to a motor of its own."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from bench import assembly
from bench.geometry import Place
from bench.kinds import Home, Kind, Variant
from pcalib import rotation
from pcalib.robot import Robot

TOWERS = ("1", "2", "3")
PAIRS = tuple(i + j for i in TOWERS for j in "12")


def _spec(robot: Robot) -> mujoco.MjSpec:
    size = robot.dimensions
    spec = assembly.skeleton(robot)
    height = robot.joint_max
    for i, azimuth in zip(TOWERS, size["tower_azimuth"], strict=True):
        turn = rotation.about(assembly.Z, azimuth)
        across = {j: turn @ [0, sign * 0.5 * size["rod_spacing"], 0] for j, sign in (("1", 1), ("2", -1))}
        tower = assembly.body(spec.body("base"), f"tower{i}", turn @ [size["tower_radius"], 0, 0])
        back = turn @ [0.05 * size["rod_length"], 0, 0]
        assembly.bar(tower, back, back + [0, 0, height], 0.02 * size["rod_length"], assembly.FRAME)
        carriage = assembly.body(tower, f"carriage{i}", mass=robot.mass.get("carriage", 0.0))
        assembly.joint(carriage, f"carriage{i}", assembly.Z, slides=True)
        assembly.bar(carriage, across["1"], across["2"], 0.02 * size["rod_length"], assembly.ARM)
        assembly.motor(spec, robot, f"q{i}", f"carriage{i}")
        for j in "12":
            assembly.anchor(spec.body("plate"), i + j, turn @ [size["plate_radius"], 0, 0] + across[j])
            assembly.rod(spec, robot, carriage, i + j, across[j], size["rod_length"])
    return spec


def _places(robot: Robot) -> tuple[Place, ...]:
    return (
        *(Place("body", f"tower{i}", f"p{i}") for i in TOWERS),
        *(Place("turn", f"tower{i}", f"beta{i}") for i in TOWERS),
        *(Place("gear", f"gear.q{i}", f"s{i}") for i in TOWERS),
        *(Place("body", f"rod{r}", f"a{r}") for r in PAIRS),
        *(Place("site", f"b{r}", f"b{r}") for r in PAIRS),
        *(Place("rod", f"tip{r}", f"l{r}") for r in PAIRS),
    )


def _home(robot: Robot) -> Home:
    """Return the home pose: the plate in the middle of the workspace."""
    size = robot.dimensions
    z = 0.5 * (robot.workspace.z_min + robot.workspace.z_max)
    q = z + math.sqrt(size["rod_length"] ** 2 - (size["tower_radius"] - size["plate_radius"]) ** 2)
    return Home(np.full(3, q), np.array([0.0, 0.0, z]), np.eye(3))


KIND = Kind(name="linear_delta", variants={"rods": Variant(_spec, _places)}, home=_home)
