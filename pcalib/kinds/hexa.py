"""The Hexa: six arms, six single rods, six degrees of freedom (Pierrot, Uchiyama; a Delta with a motor per rod)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcalib.kinds import Kind, azimuths, radius, size
from pcalib.kinds.delta import simplified_pose
from pcalib.mechanics.actuation import RotaryArms
from pcalib.mechanics.layout import Block, Layout, arm_columns
from pcalib.mechanics.mechanism import Mechanism, Pose

ARMS = ("1", "2", "3", "4", "5", "6")


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """A Hexa from its nominal dimensions: three pairs of arms, 78 raw parameters p(18) a(18) b(18) l(6) beta(18)."""
    azimuth = np.repeat(dimensions["axis_azimuth"], 2)
    u = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
    v = np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1)
    side = np.tile([-0.5, 0.5], 3)[:, None]
    layout = Layout.of(
        Block("p", ARMS, dimensions["base_radius"] * v + dimensions["base_spacing"] * side * u),
        Block("a", ARMS, np.tile([0.0, dimensions["arm_length"], 0.0], (6, 1))),
        Block("b", ARMS, dimensions["plate_radius"] * v + dimensions["plate_spacing"] * side * u),
        Block("l", ARMS, np.full(6, dimensions["rod_length"])),
        Block("beta", ARMS, np.zeros((6, 3)), "rad"),
    )
    actuation = layout.rotary_arms(azimuth, ARMS, ARMS)
    plate_columns = layout.vectors("b", ARMS)

    def start(k: np.ndarray, q: np.ndarray) -> Pose:  # each pair is one virtual rod of a Delta, the plate level
        return simplified_pose(actuation, plate_columns, k, q)

    return six_arms("hexa", layout, actuation, u, start, level_pairs=True)


def six_arms(
    kind: str, layout: Layout, actuation: RotaryArms, u: np.ndarray, start: Any, level_pairs: bool = False
) -> Mechanism:
    """The mechanism of six arms with motor axes u (6, 3) that move a plate in all six directions."""
    return Mechanism(
        kind=kind,
        parameters=layout.names,
        nominal=layout.nominal,
        units=layout.units,
        rods=ARMS,
        actuators=tuple(f"q{i}" for i in ARMS),
        actuator_dimension="angle",
        actuator=np.arange(6),
        actuation=actuation,
        plate_columns=layout.vectors("b", ARMS),
        levels={
            "nominal": layout.nominal_level(),
            "classical": layout.level(
                "classical", arm_columns(u, [[tag] for tag in ARMS]),
                text="One offset for each motor, one length for each arm and rod; joints are where drawn.",
            ),
            "complete": layout.complete_level(),
        },
        start=start,
        level_pairs=level_pairs,
        task=(0, 1, 2, 3, 4, 5),
    )


KIND = Kind(
    name="hexa",
    dimensions=(
        radius("base_radius"),
        size("base_spacing"),
        size("arm_length"),
        size("rod_length"),
        radius("plate_radius"),
        size("plate_spacing"),
        azimuths("axis_azimuth", 3),
    ),
    build=build,
)
