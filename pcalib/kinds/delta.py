"""The Delta: three arms, six rods in three parallelograms, three translations (paper section II)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pcalib import rotation
from pcalib.kinds import Kind, azimuths, radius, size
from pcalib.mechanics.actuation import Carriages, RotaryArms
from pcalib.mechanics.layout import AS_DRAWN, AXES, Block, Layout, along, arm_columns
from pcalib.mechanics.mechanism import Level, Mechanism, Pose

ARMS = ("1", "2", "3")
PAIRS = tuple(f"{i}{j}" for i in ARMS for j in "12")


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """A Delta from its nominal dimensions, 60 raw parameters: p(9) a(18) b(18) l(6) beta(9)."""
    azimuth = dimensions["axis_azimuth"]
    u = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
    v = np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1)
    arm = np.repeat(np.arange(3), 2)
    side = 0.5 * dimensions["rod_spacing"] * np.tile([-1.0, 1.0], 3)[:, None]
    layout = Layout.of(
        Block("p", ARMS, dimensions["base_radius"] * v),
        Block("a", PAIRS, side * [1.0, 0.0, 0.0] + [0.0, dimensions["arm_length"], 0.0]),
        Block("b", PAIRS, side * u[arm] + dimensions["plate_radius"] * v[arm]),
        Block("l", PAIRS, np.full(6, dimensions["rod_length"])),
        Block("beta", ARMS, np.zeros((3, 3)), "rad"),
    )
    actuation = layout.rotary_arms(azimuth, ARMS, PAIRS)
    plate_columns = layout.vectors("b", PAIRS)
    return Mechanism(
        kind="delta",
        parameters=layout.names,
        nominal=layout.nominal,
        units=layout.units,
        rods=PAIRS,
        actuators=tuple(f"q{i}" for i in ARMS),
        actuator_dimension="angle",
        actuator=arm,
        actuation=actuation,
        plate_columns=plate_columns,
        levels=_levels(layout, u, side[:, 0]),
        combinations={
            f"bp{pair}.{axis}": {f"b{pair}.{axis}": 1.0, f"p{pair[0]}.{axis}": -1.0} for pair in PAIRS for axis in AXES
        },
        closed_form_inverse=True,
        start=lambda k, q: simplified_pose(actuation, plate_columns, k, q),
        level_pairs=True,
    )


_CLASSICAL = (
    "One rod for each parallelogram, one length for each arm and rod, one offset for each motor. The plate cannot tilt "
    "in this model."
)
_FEW = "What the firmware of a printer holds, for a few contacts. The plate cannot tilt in this model."
_MODEL24 = (
    "All that perfect parallelograms can have wrong (Vischer's Model 24). The plate's centre is right; its tilt is not "
    "in the model, so the miss grows with the tool."
)


def _levels(layout: Layout, u: np.ndarray, ax: np.ndarray) -> dict[str, Level]:
    """The named geometry levels as subspaces of the 60 raw parameters.

    Args:
        u: (3, 3) nominal motor axes.
        ax: (6,) [m] nominal a_ij along them.
    """
    rods = [[f"{i}1", f"{i}2"] for i in ARMS]
    classical = arm_columns(u, rods)
    plates, turns = {}, {}
    for n, (i, pair) in enumerate(zip(ARMS, rods, strict=True)):
        for c, axis in zip(AXES, np.eye(3), strict=True):
            plates[f"bp{i}.{c}"] = ("m", {f"b{rod}.{c}": 1.0 for rod in pair})
            # The plate side turns with the motor axis, so that the parallelogram stays perfect (to first order).
            swing = np.cross(axis, u[n])
            swings = [along(f"b{rod}", swing, ax[2 * n + j]) for j, rod in enumerate(pair)]
            turns[f"beta{i}.{c}"] = ("rad", {f"beta{i}.{c}": 1.0} | swings[0] | swings[1])
    lengths = {name: column for name, column in classical.items() if column[0] == "m"}

    def common(names: Iterator[str]) -> tuple[str, dict[str, float]]:
        return "m", {part: change for name in names for part, change in classical[name][1].items()}

    few = {name: column for name, column in classical.items() if column[0] == "rad"}
    out = np.cross([0.0, 0.0, 1.0], u)
    firmware = {"firmware3": (dict(few), "The zeros of the motors")}
    for name, column, added in (
        ("radius", ("m", {e: d for n, i in enumerate(ARMS) for e, d in along(f"p{i}", out[n]).items()}), "one radius"),
        ("arm.length", common(f"arm{i}.length" for i in ARMS), "one arm length"),
        ("rod.length", common(f"rod{i}.length" for i in ARMS), "one rod length"),
    ):
        text = f"{firmware[f'firmware{len(few)}'][1]}, {added}"
        few[name] = column
        firmware[f"firmware{len(few)}"] = (dict(few), text)
    return {
        "nominal": layout.level("nominal", {}, perfect=True, text=AS_DRAWN),
        **{
            name: layout.level(name, columns, perfect=True, strict=True, text=f"{text}. {_FEW}")
            for name, (columns, text) in firmware.items()
        },
        "classical": layout.level("classical", classical, perfect=True, text=_CLASSICAL),
        "model24": layout.level("model24", plates | lengths | turns, perfect=True, text=_MODEL24),
        "complete": layout.complete_level(),
    }


def simplified_forward(
    actuation: RotaryArms | Carriages, plate_columns: np.ndarray, k: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """FPR_S: plate position of the perfect-parallelogram Delta, (N, 3) [m], NaN where its spheres do not meet.

    The middle of each pair is one virtual rod; shifted by the plate side, its three spheres meet in the plate
    centre, and the lower of the two points is the working branch.
    """
    side = actuation.base(k, q)
    centre = side.A - k[plate_columns]
    centre = 0.5 * (centre[:, 0::2] + centre[:, 1::2])
    length = k[actuation.length].reshape(3, 2).mean(axis=1)
    return trilaterate(centre[:, 0], centre[:, 1], centre[:, 2], *length)


def trilaterate(c1: np.ndarray, c2: np.ndarray, c3: np.ndarray, r1: float, r2: float, r3: float) -> np.ndarray:
    """The lower of the two points (N, 3) at distances r from three centres (N, 3); NaN where there is none."""
    e, f = c2 - c1, c3 - c1
    ee, ff, ef = rotation.dot(e, e), rotation.dot(f, f), rotation.dot(e, f)
    ge, gf = 0.5 * (ee + r1**2 - r2**2), 0.5 * (ff + r1**2 - r3**2)
    det = ee * ff - ef * ef
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = ((ge * ff - gf * ef) / det)[:, None] * e + ((gf * ee - ge * ef) / det)[:, None] * f
        normal = rotation.cross(e, f) / np.sqrt(det)[:, None]
        normal *= -np.sign(normal[:, 2:])
        height = np.sqrt(r1**2 - rotation.dot(foot, foot))
    return c1 + foot + height[:, None] * normal


def simplified_pose(actuation: RotaryArms | Carriages, plate_columns: np.ndarray, k: np.ndarray, q: np.ndarray) -> Pose:
    """FPR_S as a plate pose with the plate parallel to the base."""
    x = simplified_forward(actuation, plate_columns, k, q)
    return Pose(x, np.broadcast_to(np.eye(3), (len(x), 3, 3)).copy(), np.zeros((len(x), 0)))


KIND = Kind(
    name="delta",
    dimensions=(
        radius("base_radius"),
        size("arm_length"),
        size("rod_length"),
        radius("plate_radius"),
        size("rod_spacing"),
        azimuths("axis_azimuth", 3),
    ),
    build=build,
)
