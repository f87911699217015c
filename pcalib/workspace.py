"""Poses that a robot can take (joint range, working cylinder, commanded tilt and yaw), at random or on a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib import rotation
from pcalib.errors import InputError, ReachError
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.robot import Robot

MARGIN = 0.01
"""Share of the joint range left free at either end, so that a compensated command is within it, too."""
LARGEST = 200_000
"""Largest number of points; a spacing that gives more is taken for a mistake."""


@dataclass(frozen=True)
class Candidates:
    """Poses that the nominal robot can take within joint range and workspace."""

    q: np.ndarray
    """(C, nq) [rad or m]."""
    pose: Pose


def allowed(robot: Robot, q: np.ndarray, pose: Pose, status: np.ndarray) -> np.ndarray:
    """(N,) bool: the loops close, q is within the joint range and the plate's origin C within the workspace."""
    inside = (q >= robot.joint_min - 1e-12).all(axis=-1) & (q <= robot.joint_max + 1e-12).all(axis=-1)
    inside &= robot.workspace.contains(pose.x) & oriented(robot, pose.R)
    return (status == "ok") & inside


def oriented(robot: Robot, R: np.ndarray) -> np.ndarray:
    """(N,) bool: rotations (N, 3, 3) within the tilt and yaw of the workspace, where commands prescribe them."""
    commanded = {3, 4, 5} & set(robot.mechanism.task)
    inside = np.ones(len(R), bool)
    if 5 in commanded:
        turn = rotation.to_quaternion(R)
        yaw = 2 * np.arctan2(turn[:, 3], turn[:, 0])
        inside &= np.abs(np.mod(yaw + np.pi, 2 * np.pi) - np.pi) <= robot.workspace.yaw + 1e-9
    if {3, 4} <= commanded:
        inside &= np.arccos(np.clip(R[:, 2, 2], -1, 1)) <= robot.workspace.tilt + 1e-9
    return inside


def reachable(robot: Robot, n: int, rng: np.random.Generator) -> Candidates:
    """n random poses in joint range ∩ workspace.

    They are uniform in joint space, or in the workspace where orientation is commanded.
    """
    mechanism = robot.mechanism
    kept_q, kept, count = [], [], 0
    for _ in range(200):
        size = max(200, 4 * n)
        if {3, 4, 5} & set(mechanism.task):
            found = kinematics.inverse(mechanism, mechanism.nominal, *_targets(robot, size, rng))
            q = found.q
        else:
            q = rng.uniform(robot.joint_min, robot.joint_max, (size, len(mechanism.actuators)))
            found = kinematics.forward(mechanism, mechanism.nominal, q)
        good = allowed(robot, q, found.pose, found.status)
        kept_q.append(q[good])
        kept.append(found.pose.take(good))
        count += int(good.sum())
        if count >= n:
            break
    else:
        raise ReachError(
            f"only {count} of {n} poses found in the workspace of robot '{robot.name}'\n"
            "  check [workspace] and [joints] of the robot file"
        )
    pose = Pose(*(np.concatenate([getattr(p, a) for p in kept])[:n] for a in ("x", "R", "phi")))
    return Candidates(np.concatenate(kept_q)[:n], pose)


def _targets(robot: Robot, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Random plate positions (N, 3) and rotations (N, 3, 3), uniform in working cylinder, tilt and yaw."""
    w = robot.workspace
    radius, azimuth = w.radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    position = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), rng.uniform(w.z_min, w.z_max, n)], axis=-1)
    tilt, towards = w.tilt * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    if 3 not in robot.mechanism.task:
        tilt = 0 * tilt
    swing = rotation.exp(np.stack([tilt * np.cos(towards), tilt * np.sin(towards), 0 * tilt], axis=-1))
    return position, swing @ rotation.about(np.array([0.0, 0.0, 1.0]), rng.uniform(-w.yaw, w.yaw, n))


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
        raise InputError(f"a grid spacing of {spacing:g} m is not a positive length", remedy="give a positive length")
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
