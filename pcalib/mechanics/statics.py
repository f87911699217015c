"""Static loads of any :class:`Mechanism` at given poses: what its rods and drives carry against gravity.

The rods are two-force members; half of each one's mass stands at either end. With J_X = ∂f/∂X in unit-rod form

    J_Xᵀ·T = w                      w: weight of plate, payload and half rods on the plate's coordinates
    τ = −J_qᵀ·T + Σ ½·m_rod·g·∂A/∂q + moment of the arms' own weight

T > 0 is tension; τ > 0 turns the arm (moves the carriage, lengthens the leg) towards +q: it is the load that the
drive has to hold against.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcalib import rotation
from pcalib.mechanics import kinematics
from pcalib.mechanics.kinematics import Closure
from pcalib.mechanics.mechanism import Mechanism, Pose


@dataclass(frozen=True)
class Loads:
    """Forces at N poses."""

    tension: np.ndarray
    """(N, m) [N] rod forces, tension positive; zero on guided rows, which are no rods."""
    torque: np.ndarray
    """(N, nq) [N·m or N] generalised load on each actuator, positive towards +q."""


def loads(
    mechanism: Mechanism,
    k: np.ndarray,
    q: np.ndarray,
    pose: Pose,
    mass: Mapping[str, float],
    gravity: np.ndarray,
    tool: np.ndarray | float = 0.0,
    payload: np.ndarray | float = 0.0,
    at: Closure | None = None,
) -> Loads:
    """Rod tensions and actuator loads at N poses.

    Args:
        k: (nk,) geometric parameters.
        q: (N, nq) actuator values [rad or m].
        pose: plate poses that close the loops with q.
        mass: [kg] of arm, rod, plate …, [m] of arm_com; what is absent weighs nothing.
        gravity: (3,) [m/s²], base frame.
        tool: (3,) or (N, 3) [m], plate frame: where the payload hangs.
        payload: scalar or (N,) [kg].
        at: the closure at these poses about C, where it is known already (with the deviations of effects).

    Returns:
        Loads; NaN at a singular pose, where no rod forces hold the plate.
    """
    g = np.asarray(gravity, float)
    q = np.atleast_2d(np.asarray(q, float))
    if at is None:
        at = kinematics.closure(mechanism, k, q, pose)
    bodies = mechanism.is_rod.astype(float)
    half = 0.5 * mass.get("rod", 0.0) * bodies[:, None] * g  # (m, 3)
    tool = np.broadcast_to(np.asarray(tool, float), pose.x.shape)
    payload = np.broadcast_to(np.asarray(payload, float), (len(q),))

    w = _weight(mechanism, at, pose, half, mass.get("plate", 0.0) * g, tool, payload[:, None] * g)
    J = kinematics.jacobian_state(mechanism, at, pose)
    tension = kinematics.solve(np.swapaxes(J, -1, -2), w)

    per_rod = -tension * kinematics.rod_rate(at) + rotation.dot(at.side.dA, half)
    spread = np.zeros((per_rod.shape[1], len(mechanism.actuators)))
    spread[np.arange(per_rod.shape[1]), mechanism.actuator] = 1.0
    torque = per_rod @ spread + mechanism.actuation.weight_moment(k, q, mass, g)
    return Loads(tension * bodies, torque)


def _weight(
    mechanism: Mechanism,
    at: Closure,
    pose: Pose,
    half: np.ndarray,
    plate: np.ndarray,
    tool: np.ndarray,
    payload: np.ndarray,
) -> np.ndarray:
    """w (N, n_state): generalised weights on the plate's twist about C [N, N·m] and on its hinges [N·m]."""
    w = np.empty((len(at.f), 6))
    w[:, :3] = plate + payload + half.sum(axis=0)
    lever = (pose.R @ tool[..., None])[..., 0]
    w[:, 3:] = rotation.cross(lever, payload) + rotation.cross(at.r, half).sum(axis=1)
    w = w[:, list(mechanism.plate_dofs)]
    if mechanism.hinges:
        # A hinged body carries the half rods at its anchors; plate mass and payload are the central body's.
        down = half @ pose.R  # (N, m, 3), plate frame
        columns = []
        for h, hinge in enumerate(at.hinges):
            rods = mechanism.rods_on(h)
            arm = at.b[:, rods] - hinge.point
            swing = rotation.cross(np.broadcast_to(hinge.axis, arm.shape), arm)
            columns.append(np.sum(swing * down[:, rods], axis=(1, 2)))
        w = np.hstack([w, np.stack(columns, axis=-1)])
    return w
