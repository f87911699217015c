"""The hexapod in MuJoCo: six legs on slides, each geared to a motor of its own."""

from __future__ import annotations

import mujoco
import numpy as np

from bench import assembly
from bench.geometry import Place
from bench.kinds import Home, Kind, Variant
from pcalib import rotation
from pcalib.robot import Robot

LEGS = ("1", "2", "3", "4", "5", "6")


def _points(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the base and plate points, (6, 3) [m], each in its own frame."""
    size = robot.dimensions
    base = rotation.about(assembly.Z, size["base_azimuth"]) @ np.array([size["base_radius"], 0, 0])
    plate = rotation.about(assembly.Z, size["plate_azimuth"]) @ np.array([size["plate_radius"], 0, 0])
    return base, plate


def _spec(robot: Robot) -> mujoco.MjSpec:
    height = robot.dimensions["home_height"]
    # Rods run along their −z: on a platform that stands above its base they start upside down.
    turn = np.diag([1.0, -1.0, -1.0]) if height > 0 else np.eye(3)
    spec = assembly.skeleton(robot)
    for tag, base, plate in zip(LEGS, *_points(robot), strict=True):
        assembly.anchor(spec.body("plate"), tag, plate)
        length = float(np.linalg.norm(plate + [0, 0, height] - base))
        assembly.rod(spec, robot, spec.body("base"), tag, base, length, turn=turn, slide=f"leg{tag}")
        assembly.motor(spec, robot, f"q{tag}", f"leg{tag}")
    return spec


def _places(robot: Robot) -> tuple[Place, ...]:
    travel = robot.dimensions.get("leg_travel", np.ones(6))
    return (
        *(Place("body", f"rod{i}", f"p{i}") for i in LEGS),
        *(Place("site", f"b{i}", f"b{i}") for i in LEGS),
        *(Place("rod", f"tip{i}", f"l{i}") for i in LEGS),
        *(Place("gear", f"gear.q{i}", f"s{i}", factor=float(t)) for i, t in zip(LEGS, travel, strict=True)),
    )


def _home(robot: Robot) -> Home:
    """Return the home pose: all legs at zero."""
    return Home(np.zeros(6), np.array([0.0, 0.0, robot.dimensions["home_height"]]), np.eye(3))


KIND = Kind(name="hexapod", variants={"rods": Variant(_spec, _places)}, home=_home, rods_down=False)
