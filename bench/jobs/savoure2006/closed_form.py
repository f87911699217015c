"""The planar parallelogram in closed form: equations (34)–(74) of the paper with its errors corrected.

The general solvers of :mod:`pcalib.mechanics.kinematics` do not use any of this; it is the truth they are tested
against, and the paper's method as it stands for its reproduction. Parameters k are those of
:mod:`pcalib.kinds.planar`, (9,) in SI; q (N,) [rad] is one actuator angle per pose, h [m] the tool length. Angles are
counted from −y_b towards +x_b.
"""

from __future__ import annotations

import numpy as np

from pcalib import rotation
from pcalib.kinds.planar import A1X, A2X, A2Y, B1X, B2X, B2Y, L1, L2, PARAMETERS, Q0
from pcalib.mechanics.mechanism import Pose

BASE = ("q0", "a2x", "a2y", "b1x", "l1", "l2")
"""The base of identifiable errors (eq. 73)."""
MERGED = {"b2x": ("a2x", -1.0), "b2y": ("a2y", -1.0), "a1x": ("b1x", -1.0)}
"""What the rest of the errors adds to those of the base (eqs 70–72): δa2x_I = δa2x − δb2x, and so on."""


def forward_simplified(q: np.ndarray, q0: float, length: float) -> np.ndarray:
    """FPR_S: x of the TCP for a perfect parallelogram, (N,) [m] (eq. 34)."""
    return length * np.sin(q + q0)


def inverse_simplified(x: np.ndarray, q0: float, length: float) -> np.ndarray:
    """IPR_S: actuator angles, (N,) [rad]; NaN where |x| > l (eq. 35)."""
    with np.errstate(invalid="ignore"):
        return np.arcsin(x / length) - q0


def rate_simplified(q: np.ndarray, q0: float, length: float) -> np.ndarray:
    """J_S = dx/dq, (N,) [m/rad] (eq. 36); its reciprocal is J_S^m (eq. 37)."""
    return length * np.cos(q + q0)


def sensitivity_simplified(q: np.ndarray, q0: float, length: float) -> np.ndarray:
    """S_S = ∂x/∂(q0, l), (N, 2) (eq. 38)."""
    return np.stack([rate_simplified(q, q0, length), np.sin(q + q0)], axis=-1)


def plate_angle(k: np.ndarray, q: np.ndarray) -> np.ndarray:
    """α: rotation of the plate, (N,) [rad]; NaN where the loop cannot close (eqs 44–52)."""
    Q = q + k[Q0]
    width, rise = k[A1X] + k[A2X], k[A2Y]
    E = (k[L1] * np.sin(Q) - width) / k[L2]
    E1 = (k[L1] * np.cos(Q) + rise) / k[L2]
    l_b, gamma_b = np.hypot(width, rise), np.arctan2(rise, width)
    l_p, gamma_p = np.hypot(k[B1X] + k[B2X], k[B2Y]), np.arctan2(k[B2Y], k[B1X] + k[B2X])
    # (51), where F cos γp − G sin γp = l_p/l2 for F and G of (48)
    numerator = l_b**2 - l_p**2 + k[L1] ** 2 - k[L2] ** 2 + 2 * l_b * k[L1] * np.sin(gamma_b - Q)
    I = numerator / (2 * l_p * k[L2]) + l_p / k[L2]
    with np.errstate(invalid="ignore"):
        root = np.sqrt(E**2 + E1**2 - I**2)
    return np.arctan2(E1 * I + E * root, E1 * root - E * I) - gamma_p


def forward(k: np.ndarray, q: np.ndarray) -> Pose:
    """FPR_C: plate poses in closed form (eqs 41–42); the TCP is ``forward(k, q).tcp((0, −h, 0))``."""
    alpha, Q = plate_angle(k, q), q + k[Q0]
    x = np.zeros((len(q), 3))
    x[:, 0] = -k[A1X] + k[L1] * np.sin(Q) + k[B1X] * np.cos(alpha)
    x[:, 1] = -k[L1] * np.cos(Q) + k[B1X] * np.sin(alpha)
    return Pose(x, rotation.about(np.array([0.0, 0.0, 1.0]), alpha), np.zeros((len(q), 0)))


def state_jacobian(k: np.ndarray, q: np.ndarray, h: float) -> np.ndarray:
    """J_X of the perfect parallelogram at the TCP, unit rods, (N, 3, 3) (eqs 61–64)."""
    u, v = np.sin(q + k[Q0]), -np.cos(q + k[Q0])
    rows = [
        [u, v, -u * h - v * k[B1X]],
        [u, v, -u * (h + k[B2Y]) + v * k[B2X]],
        [-v, u, v * h - u * k[B1X]],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def parameter_jacobian(k: np.ndarray, q: np.ndarray) -> np.ndarray:
    """J_kC of the perfect parallelogram, unit rods, (N, 3, 9) (eqs 55–58, 65)."""
    u, v = np.sin(q + k[Q0]), -np.cos(q + k[Q0])
    J = np.zeros((len(q), 3, 9))
    J[:, 0, A1X], J[:, 0, B1X], J[:, 0, L1] = -u, u, 1.0
    J[:, 1, A2X], J[:, 1, A2Y], J[:, 1, B2X], J[:, 1, B2Y], J[:, 1, L2] = u, v, -u, -v, 1.0
    J[:, 2, Q0], J[:, 2, A1X], J[:, 2, B1X] = k[L1], v, -v
    return J


def sensitivity(k: np.ndarray, q: np.ndarray, h: float) -> np.ndarray:
    """S_C = ∂(x, y, α)/∂k at the TCP, (N, 3, 9), for k of a perfect parallelogram (eqs 66–69).

    Perfect means l1 = l2 (eq. 59) and equal base and plate sides, so that the plate stays parallel to the base.
    """
    return np.linalg.solve(state_jacobian(k, q, h), parameter_jacobian(k, q))


def to_base() -> np.ndarray:
    """Matrix (6, 9) that merges the nine errors into the base of (73), by (70)–(72)."""
    matrix = np.zeros((len(BASE), len(PARAMETERS)))
    for row, name in enumerate(BASE):
        matrix[row, PARAMETERS.index(name)] = 1.0
    for name, (into, factor) in MERGED.items():
        matrix[BASE.index(into), PARAMETERS.index(name)] = factor
    return matrix
