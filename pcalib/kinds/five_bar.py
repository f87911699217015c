"""The planar five-bar mechanism: two driven arms and two rods that meet in one point, which moves in x and y.

Base frame: O_b in the middle of the workspace, `base_height` below the motors, x towards motor 2, y up; z = 0.
θ_i = q_i + z_i is the angle of arm i from −y outwards: s_1 = −1 towards −x, s_2 = +1 towards +x.

    P_i = (p_ix, p_iy)    E_i = P_i + a_i·(s_i·sin θ_i, −cos θ_i)    |X − E_i| = l_i

Both elbows point outwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib.kinds import Kind, masses, size
from pcalib.mechanics.layout import AS_DRAWN, EVERYTHING
from pcalib.mechanics.mechanism import Actuation, BaseSide, Level, Mechanism, Pose

ARMS = ("1", "2")
PARAMETERS = tuple(f"{symbol}{i}" for i in ARMS for symbol in ("z", "px", "py", "a", "l"))
COLUMNS = np.arange(10).reshape(2, 5)
"""Where the parameters of each arm stand in k."""
Z, PX, PY, ARM, ROD = COLUMNS.T
OUTWARDS = np.array([-1.0, 1.0])
"""s_i: sign of x on the side to which each elbow points."""


@dataclass(frozen=True, kw_only=True)
class PlanarArms(Actuation):
    """Arms that turn in the plane; their centres of mass lie on them."""

    @property
    def columns(self) -> np.ndarray:
        return COLUMNS

    def zeros(self, nk: int) -> np.ndarray:
        return np.eye(nk)[:, Z]

    def base(self, k: np.ndarray, q: np.ndarray) -> BaseSide:
        angle = q + k[Z]
        along = np.stack([OUTWARDS * np.sin(angle), -np.cos(angle), 0 * angle], axis=-1)
        across = np.stack([OUTWARDS * np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        P = np.stack([k[PX], k[PY], 0 * k[PX]], axis=-1)
        return BaseSide(A=P + k[ARM][:, None] * along, dA=k[ARM][:, None] * across, length=k[ROD])

    def rows(self, k: np.ndarray, q: np.ndarray, side: BaseSide, n: np.ndarray, d: np.ndarray) -> np.ndarray:
        angle = q + k[Z]
        arm = -(n[..., 0] * OUTWARDS * np.sin(angle) - n[..., 1] * np.cos(angle))
        return np.stack([-np.sum(n * side.dA, axis=-1), -n[..., 0], -n[..., 1], arm, -np.ones(q.shape)], axis=-1)

    def reach(self, k: np.ndarray, B: np.ndarray) -> np.ndarray:
        x, y = B[..., 0] - k[PX], B[..., 1] - k[PY]
        far = np.hypot(x, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            inner = np.arccos((k[ARM] ** 2 + far**2 - k[ROD] ** 2) / (2 * k[ARM] * far))
        return np.arctan2(OUTWARDS * x, -y) + inner - k[Z]

    def weight_moment(self, k: np.ndarray, q: np.ndarray, mass: Mapping[str, float], g: np.ndarray) -> np.ndarray:
        angle = q + k[Z]
        moment = mass.get("arm", 0.0) * mass.get("arm_com", 0.0)
        return moment * (g[0] * OUTWARDS * np.cos(angle) + g[1] * np.sin(angle))


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """The five-bar from its nominal dimensions: 10 parameters, all seen by positions in a known frame."""
    half, arm, rod = 0.5 * dimensions["base_width"], dimensions["arm_length"], dimensions["rod_length"]
    nominal = np.array([value for side in (-1, 1) for value in (0.0, side * half, dimensions["base_height"], arm, rod)])
    units = ("rad", "m", "m", "m", "m") * 2
    classical = np.eye(10)[:, [*Z, *ARM, *ROD]]
    names = tuple(PARAMETERS[i] for i in (*Z, *ARM, *ROD))
    return Mechanism(
        kind="five_bar",
        parameters=PARAMETERS,
        nominal=nominal,
        units=units,
        rods=ARMS,
        actuators=("q1", "q2"),
        actuator_dimension="angle",
        actuator=np.arange(2),
        actuation=PlanarArms(length=ROD),
        # The rods meet in the plate's origin: columns that do not count are those of the other arm.
        plate_columns=np.array([[PX[i], PY[i], ARM[i]] for i in (1, 0)]),
        plate_signs=np.zeros((2, 3)),
        levels={
            "nominal": Level("nominal", (), np.zeros((10, 0)), (), text=AS_DRAWN),
            "classical": Level(
                "classical", names, classical, ("rad", "rad", "m", "m", "m", "m"),
                text="A zero, an arm length and a rod length on either side; motors stand where drawn.",
            ),
            "complete": Level("complete", PARAMETERS, np.eye(10), units, text=EVERYTHING),
        },
        start=_start,
        task=(0, 1),
        plate_dofs=(0, 1),
        rod_side=0,
    )  # fmt: skip


def _start(k: np.ndarray, q: np.ndarray) -> Pose:
    """The lower of the two points where the circles about the elbows meet."""
    angle = q + k[Z]
    E = np.stack([k[PX] + k[ARM] * OUTWARDS * np.sin(angle), k[PY] - k[ARM] * np.cos(angle)], axis=-1)
    apart = E[:, 1] - E[:, 0]
    d = np.linalg.norm(apart, axis=-1)
    u = apart / d[:, None]
    along = (k[ROD[0]] ** 2 - k[ROD[1]] ** 2 + d**2) / (2 * d)
    below = np.sqrt(np.maximum(k[ROD[0]] ** 2 - along**2, 0.0))
    x = np.zeros((len(q), 3))
    x[:, :2] = E[:, 0] + along[:, None] * u + below[:, None] * np.stack([u[:, 1], -u[:, 0]], axis=-1)
    return Pose(x, np.broadcast_to(np.eye(3), (len(q), 3, 3)).copy(), np.zeros((len(q), 0)))


KIND = Kind(
    name="five_bar",
    dimensions=(size("base_width"), size("base_height"), size("arm_length"), size("rod_length")),
    build=build,
    masses=(*masses("arm", "rod", "plate"), size("arm_com", 0.0)),
)
