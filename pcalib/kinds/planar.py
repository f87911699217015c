"""The planar parallelogram with one degree of freedom: the paper's example (section III, figure 3).

Base frame: O_b between the base joints, x along the commanded motion, y up; the plate hangs at y < 0 and z = 0
throughout. Rod 1 is driven: q + q0 is its angle from −y towards +x.

    A1 = (−a1x, 0)   A2 = (a2x, a2y)     base frame
    B1 = (−b1x, 0)   B2 = (b2x, b2y)     plate frame, origin O_p; a tool of length h is t = (0, −h, 0)

Three rows fix the plate's x, y and rotation: the rods, |A1B1| = l1 and |A2B2| = l2, and the drive, v(q + q0)·A1B1 = 0
(paper eqs 55–56).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib.kinds import Kind, masses, offset, size
from pcalib.mechanics.layout import AS_DRAWN, EVERYTHING
from pcalib.mechanics.mechanism import Actuation, BaseSide, Level, Mechanism, Pose

PARAMETERS = ("q0", "a1x", "a2x", "a2y", "b1x", "b2x", "b2y", "l1", "l2")
"""k_C in the paper's order (eqs 39–40)."""
Q0, A1X, A2X, A2Y, B1X, B2X, B2Y, L1, L2 = range(9)
ROD_1, ROD_2, DRIVE = range(3)


@dataclass(frozen=True, kw_only=True)
class DrivenRod(Actuation):
    """Two rods from fixed joints, the first one turned by the actuator; no mass moves with the actuator beside them."""

    @property
    def columns(self) -> np.ndarray:
        return np.array([[A1X, L1, Q0], [A2X, A2Y, L2], [A1X, Q0, L1]])

    def zeros(self, nk: int) -> np.ndarray:
        return np.eye(nk)[:, [Q0]]

    def base(self, k: np.ndarray, q: np.ndarray) -> BaseSide:
        A = np.zeros((len(q), 3, 3))
        A[:, (ROD_1, DRIVE), 0] = -k[A1X]
        A[:, ROD_2, :2] = k[[A2X, A2Y]]
        angle = q[:, 0] + k[Q0]
        c, s = np.cos(angle), np.sin(angle)
        guide = np.full(A.shape, np.nan)
        guide[:, DRIVE] = np.stack([c, s, 0 * c], axis=-1)  # v, normal to the rod direction u = (s, −c)
        dguide = np.zeros(A.shape)
        dguide[:, DRIVE] = np.stack([-s, c, 0 * c], axis=-1)
        return BaseSide(A=A, dA=np.zeros(A.shape), length=np.array([k[L1], k[L2], 0.0]), guide=guide, dguide=dguide)

    def rows(self, k: np.ndarray, q: np.ndarray, side: BaseSide, n: np.ndarray, d: np.ndarray) -> np.ndarray:
        out = np.zeros((len(n), 3, 3))
        out[:, ROD_1, 0] = n[:, ROD_1, 0]
        out[:, ROD_1, 1] = -1.0
        out[:, ROD_2, :2] = -n[:, ROD_2, :2]
        out[:, ROD_2, 2] = -1.0
        out[:, DRIVE, 0] = n[:, DRIVE, 0]
        assert side.dguide is not None
        out[:, DRIVE, 1] = np.sum(side.dguide[:, DRIVE] * d[:, DRIVE], axis=-1)
        return out

    def reach(self, k: np.ndarray, B: np.ndarray) -> np.ndarray:
        """From x alone, as in the paper's (35): y is not commanded."""
        out = np.full(B.shape[:2], np.nan)
        with np.errstate(invalid="ignore"):
            out[:, DRIVE] = np.arcsin((B[:, DRIVE, 0] + k[A1X]) / k[L1]) - k[Q0]
        return out


_CLASSICAL = "One motor offset, and one length for both rods. The plate cannot tilt in this model."


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """The planar parallelogram from its nominal dimensions, 9 parameters of which 6 can be identified."""
    nominal = np.array([0.0 if name == "q0" else dimensions[name] for name in PARAMETERS])
    units = ("rad", *["m"] * 8)
    classical = np.zeros((9, 2))
    classical[Q0, 0] = 1.0
    classical[[L1, L2], 1] = 1.0
    return Mechanism(
        kind="planar",
        parameters=PARAMETERS,
        nominal=nominal,
        units=units,
        rods=("1", "2", "drive"),
        actuators=("q1",),
        actuator_dimension="angle",
        actuator=np.zeros(3, int),
        actuation=DrivenRod(length=np.array([L1, L2, -1])),
        # The columns of a coordinate that is zero by construction are those of the other rod's joint.
        plate_columns=np.array([[B1X, B2Y, B2X], [B2X, B2Y, B1X], [B1X, B2Y, B2X]]),
        plate_signs=np.array([[-1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
        levels={
            "nominal": Level("nominal", (), np.zeros((9, 0)), (), text=AS_DRAWN),
            "classical": Level("classical", ("q0", "l"), classical, ("rad", "m"), perfect=True, text=_CLASSICAL),
            "complete": Level("complete", PARAMETERS, np.eye(9), units, text=EVERYTHING),
        },
        start=_start,
        task=(0,),
        plate_dofs=(0, 1, 5),
        rod_side=0,
    )


def _start(k: np.ndarray, q: np.ndarray) -> Pose:
    """Rod 1 where the drive puts it and the plate level: exact for a perfect parallelogram."""
    angle = q[:, 0] + k[Q0]
    x = np.zeros((len(q), 3))
    x[:, 0] = k[L1] * np.sin(angle) - k[A1X] + k[B1X]
    x[:, 1] = -k[L1] * np.cos(angle)
    return Pose(x, np.broadcast_to(np.eye(3), (len(q), 3, 3)).copy(), np.zeros((len(q), 0)))


KIND = Kind(
    name="planar",
    dimensions=tuple((size if name in ("l1", "l2") else offset)(name) for name in PARAMETERS if name != "q0"),
    build=build,
    masses=masses("rod", "plate"),
)
