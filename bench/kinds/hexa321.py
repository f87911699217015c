"""The 321-Hexa in MuJoCo: the arms of a Hexa, whose rods meet the plate in three points."""

from __future__ import annotations

import numpy as np

from bench import assembly
from bench.kinds import Home, Kind, Variant, hexa
from pcalib import rotation
from pcalib.robot import Robot


def layout(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the azimuth of each motor axis (6,), base points (6, 3) and plate points (6, 3) [m]."""
    size = robot.dimensions
    base = rotation.about(assembly.Z, size["axis_azimuth"]) @ np.array([0.0, size["base_radius"], 0.0])
    corner = rotation.about(assembly.Z, size["point_azimuth"]) @ np.array([size["plate_radius"], 0.0, 0.0])
    return size["axis_azimuth"], base, np.repeat(corner, [3, 2, 1], axis=0)


def home(robot: Robot) -> Home:
    """Return the home pose: the plate level in the middle of the workspace."""
    return hexa.middle(robot, *layout(robot))


KIND = Kind(
    name="hexa321",
    variants={
        "rods": Variant(lambda robot: hexa.build(robot, *layout(robot)), lambda robot: hexa.places(layout(robot)[0]))
    },
    home=home,
)
