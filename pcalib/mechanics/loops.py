"""The closure of a mechanism's loops and its Jacobians, analytic and batched on the leading axis.

One set of equations serves every robot kind: f(q, X, k) = 0 with one row per rod (paper eq. 2, in unit-rod form,
so that f is an apparent rod-length error in metres).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcalib import rotation
from pcalib.mechanics.mechanism import BaseSide, Hinge, Mechanism, Pose


@dataclass(frozen=True)
class Deviation:
    """Small deviations of each pose from the rigid mechanism, which effects cause; None means zero."""

    actuator: np.ndarray | None = None
    """(N, nq) [rad or m], true minus commanded."""
    rod: np.ndarray | None = None
    """(N, m) [m], lengthening."""
    elbow: np.ndarray | None = None
    """(N, m, 3) [m], base frame: displacement of the base-side anchors."""
    plate: np.ndarray | None = None
    """(N, m, 3) [m], plate frame: displacement of the plate-side anchors."""

    @property
    def none(self) -> bool:
        """Whether nothing deviates."""
        return all(v is None for v in vars(self).values())

    def take(self, rows: np.ndarray | slice) -> Deviation:
        """The deviations of some rows."""
        return Deviation(*(None if v is None else v[rows] for v in vars(self).values()))


RIGID = Deviation()


@dataclass(frozen=True)
class Closure:
    """The closure at N poses, with the quantities that its Jacobians are made of."""

    f: np.ndarray
    """(N, m) [m], apparent rod-length errors."""
    d: np.ndarray
    """(N, m, 3) [m], B − A."""
    n: np.ndarray
    """(N, m, 3), unit directions of the rods (or the guides)."""
    r: np.ndarray
    """(N, m, 3) [m], B minus the reference point of the plate, base frame."""
    side: BaseSide
    b: np.ndarray
    """(m, 3) or (N, m, 3) [m], plate-side anchors in the plate frame, hinges applied."""
    hinges: tuple[Hinge, ...] = ()

    def about(self, arm: np.ndarray) -> Closure:
        """The same closure about a reference point that lies further by `arm` (N, 3) [m], base frame."""
        return replace(self, r=self.r - arm[:, None])


def base_side(mechanism: Mechanism, k: np.ndarray, q: np.ndarray, deviation: Deviation = RIGID) -> BaseSide:
    """Base-side anchors with the deviations of effects applied."""
    if deviation.actuator is not None:
        q = q + deviation.actuator
    side = mechanism.actuation.base(k, q)
    if deviation.elbow is None and deviation.rod is None:
        return side
    return replace(
        side,
        A=side.A if deviation.elbow is None else side.A + deviation.elbow,
        length=side.length if deviation.rod is None else side.length + deviation.rod,
    )


def plate_side(
    mechanism: Mechanism, k: np.ndarray, phi: np.ndarray, deviation: Deviation
) -> tuple[np.ndarray, tuple[Hinge, ...]]:
    """b_r in the plate frame with the hinges turned, (m, 3) or (N, m, 3), and the hinges."""
    b = mechanism.plate_points(k)
    if deviation.plate is not None:
        b = b + deviation.plate
    hinges = tuple(hinge.at(k) for hinge in mechanism.hinges)
    if hinges:
        b = np.broadcast_to(b, (len(phi), *b.shape[-2:])).copy()
        for h, hinge in enumerate(hinges):
            rods = mechanism.rods_on(h)
            turn = rotation.about(hinge.axis, phi[:, h])
            b[:, rods] = hinge.point + (b[:, rods] - hinge.point) @ np.swapaxes(turn, -1, -2)
    return b, hinges


def close(
    side: BaseSide,
    plate: tuple[np.ndarray, tuple[Hinge, ...]],
    x: np.ndarray,
    R: np.ndarray,
    reference: np.ndarray,
) -> Closure:
    """The closure of both sides at plate positions x of the `reference` point (plate frame) and orientations R."""
    b, hinges = plate
    r = np.matmul(b - reference, rotation.transposed(R))
    d = r + (x[:, None] - side.A)
    length = np.sqrt(d[..., 0] ** 2 + d[..., 1] ** 2 + d[..., 2] ** 2)
    n = d / length[..., None]
    f = length - side.length
    if side.guide is not None:
        guided = ~np.isnan(side.guide[..., 0])
        n = np.where(guided[..., None], np.nan_to_num(side.guide), n)
        f = np.where(guided, rotation.dot(n, d) - side.length, f)
    return Closure(f, d, n, r, side, b, hinges)


def closure(
    mechanism: Mechanism,
    k: np.ndarray,
    q: np.ndarray,
    pose: Pose,
    tool: np.ndarray | float = 0.0,
    deviation: Deviation = RIGID,
) -> Closure:
    """The closure at given actuator values q (N, nq) and plate poses; r is taken about the TCP of `tool`.

    `pose` is always that of the plate's origin C; `tool` (3,) or (N, 3) [m, plate frame] only moves the point
    that J_X refers to.
    """
    side = base_side(mechanism, k, q, deviation)
    plate = plate_side(mechanism, k, pose.phi, deviation)
    tool = np.asarray(tool, float)
    reference = tool[:, None, :] if tool.ndim == 2 else tool
    x = pose.x if not tool.any() else pose.tcp(np.broadcast_to(tool, (len(pose), 3)))
    return close(side, plate, x, pose.R, reference)


def jacobian_state(mechanism: Mechanism, at: Closure, pose: Pose) -> np.ndarray:
    """J_X = ∂f/∂(twist at the reference point, hinge angles), (N, m, n_state) (paper eq. 18, unit rods)."""
    J = np.concatenate([at.n, rotation.cross(at.r, at.n)], axis=-1)
    if len(mechanism.plate_dofs) < 6:
        J = J[..., list(mechanism.plate_dofs)]
    if mechanism.hinges:
        columns = np.zeros((*at.f.shape, len(at.hinges)))
        for h, hinge in enumerate(at.hinges):
            rods = mechanism.rods_on(h)
            swing = rotation.cross(np.broadcast_to(hinge.axis, at.b[:, rods].shape), at.b[:, rods] - hinge.point)
            swing = swing @ np.swapaxes(pose.R, -1, -2)
            columns[:, rods, h] = rotation.dot(at.n[:, rods], swing)
        J = np.concatenate([J, columns], axis=-1)
    return J


def rod_rate(at: Closure) -> np.ndarray:
    """∂f/∂q of each rod by its own actuator, (N, m)."""
    rate = -rotation.dot(at.n, at.side.dA) - at.side.dlength
    if at.side.dguide is not None:
        rate = rate + rotation.dot(np.nan_to_num(at.side.dguide), at.d)
    return rate


def jacobian_actuators(mechanism: Mechanism, at: Closure) -> np.ndarray:
    """J_q = ∂f/∂q, (N, m, nq)."""
    rate = rod_rate(at)
    J = np.zeros((*rate.shape, len(mechanism.actuators)))
    J[:, np.arange(rate.shape[1]), mechanism.actuator] = rate
    return J


def local_parameters(
    mechanism: Mechanism, k: np.ndarray, q: np.ndarray, at: Closure, pose: Pose, deviation: Deviation = RIGID
) -> tuple[np.ndarray, np.ndarray]:
    """∂f/∂k by the few parameters each rod depends on: rows (N, m, c) and their columns (m, c) in k."""
    if deviation.actuator is not None:
        q = q + deviation.actuator
    base = mechanism.actuation.rows(k, q, at.side, at.n, at.d)
    plate = np.matmul(at.n, pose.R)  # Rᵀn
    columns = [mechanism.actuation.columns, mechanism.plate_columns]
    hinge_rows = []
    if mechanism.hinges:
        plate, rows, where = _hinge_parameters(mechanism, k, at, pose, plate)
        hinge_rows.append(rows)
        columns.append(where)
    if mechanism.plate_signs is not None:
        plate = plate * mechanism.plate_signs
    return np.concatenate([base, plate, *hinge_rows], axis=-1), np.hstack(columns)


def _hinge_parameters(
    mechanism: Mechanism, k: np.ndarray, at: Closure, pose: Pose, n: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rod directions in the hinged bodies' frames, and ∂f/∂(point, tilt) of each rod's hinge, for n = Rᵀn (N, m, 3).

    A hinged anchor stands at h + T·(b − h) with T = exp(τ)·Rot(axis, φ)·exp(−τ).
    """
    turned = n.copy()
    rows = np.zeros((*n.shape[:2], 6))
    first = mechanism.hinges[0]
    columns = np.tile(np.concatenate([first.point, first.tilt]), (n.shape[1], 1))
    for h, (hinge, parameters) in enumerate(zip(at.hinges, mechanism.hinges, strict=True)):
        rods = mechanism.rods_on(h)
        T = rotation.about(hinge.axis, pose.phi[:, h])
        turned[:, rods] = n[:, rods] @ T
        arm = at.b[:, rods] - hinge.point
        rows[:, rods, :3] = n[:, rods] - turned[:, rods]
        swing = rotation.cross(arm, n[:, rods]) - rotation.cross(arm @ T, turned[:, rods])
        rows[:, rods, 3:] = swing @ rotation.left_jacobian(k[parameters.tilt])
        columns[rods] = np.concatenate([parameters.point, parameters.tilt])
    return turned, rows, columns


def jacobian_parameters(
    mechanism: Mechanism, k: np.ndarray, q: np.ndarray, at: Closure, pose: Pose, deviation: Deviation = RIGID
) -> np.ndarray:
    """∂f/∂k, (N, m, nk); the paper's J_kC is its negative (eqs 12–19, errata applied)."""
    rows, columns = local_parameters(mechanism, k, q, at, pose, deviation)
    J = np.zeros((*at.f.shape, len(k)))
    J[:, np.arange(rows.shape[1])[:, None], columns] = rows
    return J
