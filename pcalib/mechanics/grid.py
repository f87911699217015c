"""A regular grid through all of the workspace that the robot can reach: where the TCP is sent to be judged."""

from __future__ import annotations

import numpy as np

from pcalib.errors import InputError, ReachError
from pcalib.mechanics import kinematics
from pcalib.mechanics.workspace import allowed
from pcalib.robot import Robot

MARGIN = 0.01
"""Share of the joint range kept free at either end, so that a corrected command stays inside as well."""
LARGEST = 200_000
"""Points of a grid; more is a mistake in the spacing."""


def workspace_grid(robot: Robot, spacing: float | None = None) -> np.ndarray:
    """Plate positions (P, 3) [m] of a level plate, both ends of the working cylinder included.

    Args:
        spacing: [m] between points, about; a fifth of the workspace's radius when absent, finer where the robot
            commands one direction only.

    Raises:
        InputError: a spacing that makes no sense.
        ReachError: the robot reaches no point of it.
    """
    w, mechanism = robot.workspace, robot.mechanism
    if spacing is None:
        spacing = w.radius / (25 if len(uncommanded(robot)) == 2 else 5)
    if not 0 < spacing < np.inf:
        raise InputError(f"a grid of {spacing:g} m makes no sense", remedy="give a positive distance")
    across = np.linspace(-w.radius, w.radius, 2 * max(1, round(w.radius / spacing)) + 1)
    levels = np.linspace(w.z_min, w.z_max, max(2, round((w.z_max - w.z_min) / spacing) + 1))
    if len(across) ** 2 * len(levels) > LARGEST:
        raise InputError(f"a grid of {spacing * 1e3:g} mm has too many points", remedy="give a larger distance")
    z, y, x = np.meshgrid(levels, across, across, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    points[:, uncommanded(robot)] = 0.0  # the closure decides there
    points = np.unique(points[w.contains(points)], axis=0)
    found = kinematics.inverse(mechanism, mechanism.nominal, points)
    margin = MARGIN * (robot.joint_max - robot.joint_min)
    inside = ((found.q >= robot.joint_min + margin) & (found.q <= robot.joint_max - margin)).all(axis=1)
    good = allowed(robot, found.q, found.pose, found.status) & inside
    if not good.any():
        raise ReachError(
            f"robot '{robot.name}' reaches no point of a {spacing * 1e3:g} mm grid through its workspace; "
            "check [workspace] and [joints], or take a finer grid"
        )
    return found.pose.x[good]


def uncommanded(robot: Robot) -> list[int]:
    """Directions of 0 1 2 (x y z) that a command of this robot does not prescribe."""
    return [c for c in range(3) if c not in robot.mechanism.task]
