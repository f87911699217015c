"""The 321-Hexa: a Hexa whose rods meet the plate three in one point, two in another and one in a third (Bruyninckx).

Three spheres give the first point, then two the second and one the third: a closed form for forward kinematics. The
coincident points are initial values only: every rod keeps its own plate point, and calibration may move them apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcalib import rotation
from pcalib.kinds import Kind, azimuths, radius, size
from pcalib.kinds.delta import trilaterate
from pcalib.kinds.hexa import ARMS, six_arms
from pcalib.mechanics.layout import Block, Layout
from pcalib.mechanics.mechanism import Mechanism, Pose

POINT = np.array([0, 0, 0, 1, 1, 2])
"""Which of the three plate points each rod meets."""


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """A 321-Hexa from its nominal dimensions, 78 raw parameters p(18) a(18) b(18) l(6) beta(18)."""
    azimuth = dimensions["axis_azimuth"]
    at = dimensions["point_azimuth"]
    u = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
    v = np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1)
    points = dimensions["plate_radius"] * np.stack([np.cos(at), np.sin(at), 0 * at], axis=-1)
    layout = Layout.of(
        Block("p", ARMS, dimensions["base_radius"] * v),
        Block("a", ARMS, np.tile([0.0, dimensions["arm_length"], 0.0], (6, 1))),
        Block("b", ARMS, points[POINT]),
        Block("l", ARMS, np.full(6, dimensions["rod_length"])),
        Block("beta", ARMS, np.zeros((6, 3)), "rad"),
    )
    actuation = layout.rotary_arms(azimuth, ARMS, ARMS)
    plate_columns = layout.vectors("b", ARMS)

    def start(k: np.ndarray, q: np.ndarray) -> Pose:
        return _three_two_one(actuation.base(k, q).A, k[actuation.length], k[plate_columns])

    return six_arms("hexa321", layout, actuation, u, start)


def _three_two_one(A: np.ndarray, length: np.ndarray, b: np.ndarray) -> Pose:
    """The plate pose that puts rods 1–3 in one point, 4–5 in another and 6 in a third, on the working branch.

    Args:
        A: (N, 6, 3) [m] base-side anchors.
        length: (6,) [m].
        b: (6, 3) [m] plate-side anchors, of which the means of those that should coincide are used.
    """
    corner = np.stack([b[:3].mean(axis=0), b[3:5].mean(axis=0), b[5]])
    side = np.linalg.norm(corner - corner[[1, 2, 0]], axis=-1)  # 12, 23, 31
    P1 = trilaterate(A[:, 0], A[:, 1], A[:, 2], length[0], length[1], length[2])
    P2 = trilaterate(P1, A[:, 3], A[:, 4], side[0], length[3], length[4])
    P3 = trilaterate(P1, P2, A[:, 5], side[2], side[1], length[5])
    found = _triad(P1, P2, P3)
    R = found @ np.swapaxes(_triad(*(c[None] for c in corner)), -1, -2)
    x = P1 - (R @ corner[0])
    return Pose(x, R, np.zeros((len(x), 0)))


def _triad(P1: np.ndarray, P2: np.ndarray, P3: np.ndarray) -> np.ndarray:
    """Axes along P1P2 and normal to the three points, as columns, (N, 3, 3)."""
    e = (P2 - P1) / np.linalg.norm(P2 - P1, axis=-1, keepdims=True)
    n = rotation.cross(e, P3 - P1)
    n = n / np.linalg.norm(n, axis=-1, keepdims=True)
    return np.stack([e, rotation.cross(n, e), n], axis=-1)


KIND = Kind(
    name="hexa321",
    dimensions=(
        radius("base_radius"),
        size("arm_length"),
        size("rod_length"),
        radius("plate_radius"),
        azimuths("axis_azimuth", 6),
        azimuths("point_azimuth", 3),
    ),
    build=build,
)
