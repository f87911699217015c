"""What a robot looks like, from its own anchor points: works for any mechanism, and knows none by name.

The way an anchor moves tells what carries it: an arm moves it on a circle, a carriage on a line, and the anchor of a
leg does not move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.errors import ReachError
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Mechanism, Pose
from pcalib.model import Model
from pcalib.robot import Robot
from pcalib.workspace import reachable

_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A robot at one pose, as points in the base frame [m]."""

    rods: np.ndarray
    """(r, 2, 3) base-side and plate-side ends."""
    arms: np.ndarray
    """(a, 2, 3) from the motor axis to the middle of the arm's anchors."""
    elbows: np.ndarray
    """(e, 2, 3) bars that carry the anchors of one arm or carriage."""
    motors: np.ndarray
    """(a, 2, 3) ends of the motors, along their axes."""
    rails: np.ndarray
    """(c, 2, 3) over the joint range."""
    legs: np.ndarray
    """(l, 2, 3) rods whose length is driven."""
    base: np.ndarray
    """(b, 3) fixed points, in order around their middle."""
    plates: tuple[np.ndarray, ...]
    """Anchors of each plate body, (n, 3), in order around their middle."""
    pose: Pose

    @property
    def points(self) -> np.ndarray:
        """(n, 3) [m] all of them."""
        parts = (self.rods, self.arms, self.motors, self.rails, self.legs, self.base, self.pose.x)
        return np.concatenate([part.reshape(-1, 3) for part in parts])

    @property
    def size(self) -> float:
        """[m] mean rod length: what radii of drawn parts are taken from."""
        ends = self.rods if len(self.rods) else self.legs
        return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())


def upwards(mechanism: Mechanism) -> np.ndarray:
    """(3,) up, as a robot is drawn: z, or y for planar mechanisms, which are seen from above."""
    return np.array([0.0, 1.0, 0.0]) if 2 not in mechanism.plate_dofs else np.array([0.0, 0.0, 1.0])


def rest(robot: Robot) -> np.ndarray:
    """(nq,) a command that brings the plate near the middle of the workspace, a little to the side."""
    found = reachable(robot, 400, np.random.default_rng(0))
    w = robot.workspace
    wanted = np.array([0.3 * w.radius, -0.2 * w.radius, 0.5 * (w.z_min + w.z_max)])
    off = np.linalg.norm(found.pose.x - wanted, axis=1)
    tilt = 1 - found.pose.R[:, 2, 2]
    return found.q[np.argmin(off + w.radius * tilt)]


def skeleton(model: Model, q: np.ndarray) -> Skeleton:
    """The robot of a model at actuator values q (nq,).

    Raises:
        ReachError: the model's loops cannot be closed there.
    """
    robot, mechanism, k = model.robot, model.robot.mechanism, model.k
    q = np.asarray(q, float)[None]
    found = kinematics.forward(mechanism, k, q)
    if not found.ok.all():
        raise ReachError(
            "the robot of this model cannot stand at this command: its loops do not close\n"
            "  check the parameters in the model file, or write it anew with 'pcalib fit … -o'"
        )
    at = kinematics.closure(mechanism, k, q, found.pose)
    A, B = at.side.A[0], (at.side.A + at.d)[0]
    real = mechanism.is_rod
    driven = real & (np.broadcast_to(np.asarray(at.side.dlength, float), (1, len(A)))[0] != 0)

    parts: dict[str, list[np.ndarray]] = {"arms": [], "elbows": [], "motors": [], "rails": []}
    fixed: list[np.ndarray] = []
    for i in range(len(mechanism.actuators)):
        mine = np.flatnonzero(real & (mechanism.actuator == i))
        if len(mine) == 0:
            continue
        if not np.abs(at.side.dA[0, mine]).max() > 1e-12:  # legs start from fixed points
            fixed += list(A[mine])
            continue
        middle = A[mine].mean(axis=0)
        if len(mine) > 1:
            parts["elbows"].append(_span(A[mine]))
        circles = _circles(mechanism, k, q, mine)
        if circles is not None:
            centres, axis = circles
            hub = centres.mean(axis=0)
            arm = np.linalg.norm(middle - hub)
            along = (centres - hub) @ axis
            half = max(1.15 * float(np.abs(along).max(initial=0.0)), 0.12 * arm)
            parts["arms"].append(np.stack([hub, middle]))
            parts["motors"].append(np.stack([hub - half * axis, hub + half * axis]))
            fixed.append(hub)
        else:
            low, high = (_middle_at(mechanism, k, q, i, limit, mine) for limit in robot.joint_range)
            parts["rails"].append(np.stack([low, high]))
            fixed += [low]
    still = np.flatnonzero(real & ~np.isin(mechanism.actuator, np.arange(len(mechanism.actuators))))
    fixed += list(A[still])

    body = np.zeros(len(A), int) if mechanism.body is None else mechanism.body
    plates = tuple(_around(B[real & (body == b)]) for b in np.unique(body[real]))
    both = np.stack([A, B], axis=1)
    return Skeleton(
        rods=both[real & ~driven], legs=both[driven], base=_around(np.array(fixed)), plates=plates, pose=found.pose,
        **{name: np.array(found_parts).reshape(-1, 2, 3) for name, found_parts in parts.items()},
    )  # fmt: skip


def _circles(
    mechanism: Mechanism, k: np.ndarray, q: np.ndarray, rods: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Centres (n, 3) of the circles on which an actuator moves anchors, and their axis (3,); None for lines."""
    side = mechanism.actuation.base(k, q)
    velocity = side.dA[0, rods]
    ahead, behind = (mechanism.actuation.base(k, q + s * _STEP).dA[0, rods] for s in (1, -1))
    towards = (ahead - behind) / (2 * _STEP)  # from the anchor to the centre
    if np.linalg.norm(towards, axis=1).max() < 1e-6 * np.linalg.norm(velocity, axis=1).max():
        return None
    axis = np.cross(velocity, towards).mean(axis=0)
    return side.A[0, rods] + towards, axis / np.linalg.norm(axis)


def _middle_at(
    mechanism: Mechanism, k: np.ndarray, q: np.ndarray, actuator: int, value: float, rods: np.ndarray
) -> np.ndarray:
    moved = q.copy()
    moved[0, actuator] = value
    return mechanism.actuation.base(k, moved).A[0, rods].mean(axis=0)


def _span(points: np.ndarray) -> np.ndarray:
    """(2, 3) [m], the two points with the greatest distance."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    i, j = np.unravel_index(np.argmax(distance), distance.shape)
    return points[[i, j]]


def _around(points: np.ndarray) -> np.ndarray:
    """Points in order around their middle, in the plane that fits them best."""
    points = np.asarray(points, float).reshape(-1, 3)
    if len(points) < 3:
        return points
    off = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(off, full_matrices=False)
    return points[np.argsort(np.arctan2(off @ axes[1], off @ axes[0]))]
