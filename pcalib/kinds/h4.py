"""The H4: four arms, eight rods in four parallelograms, an articulated plate; three translations and a turn about z.

The plate is a central body with two hinges. Each hinge carries a side body that two of the parallelograms hold parallel
to the base, and the difference of the two turns the central body (Pierrot, Company, Krut): eight unknowns, of which x
refers to the central body, whose origin lies midway between the hinges. An arrangement of arms with a fourfold symmetry
is singular; the azimuths of a robot file therefore are not equally spaced.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcalib.kinds import Kind, azimuths, radius, size
from pcalib.mechanics.layout import Block, Layout, arm_columns
from pcalib.mechanics.mechanism import HingeColumns, Mechanism, Pose

ARMS = ("1", "2", "3", "4")
PAIRS = tuple(f"{i}{j}" for i in ARMS for j in "12")
SIDES = ("1", "2")


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """An H4 from its nominal dimensions, 92 raw parameters: p(12) a(24) b(24) l(8) beta(12) hinge(6) tilt(6)."""
    azimuth = dimensions["axis_azimuth"]
    u = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
    v = np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1)
    arm = np.repeat(np.arange(4), 2)
    side = 0.5 * dimensions["rod_spacing"] * np.tile([-1.0, 1.0], 4)[:, None]
    body = 1 + arm // 2
    outward = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    hinges = 0.5 * dimensions["hinge_distance"] * outward
    bases = 0.5 * dimensions["base_spacing"] * outward[body[::2] - 1]
    layout = Layout.of(
        Block("p", ARMS, bases + dimensions["base_radius"] * v),
        Block("a", PAIRS, side * [1.0, 0.0, 0.0] + [0.0, dimensions["arm_length"], 0.0]),
        Block("b", PAIRS, hinges[body - 1] + side * u[arm] + dimensions["side_radius"] * v[arm]),
        Block("l", PAIRS, np.full(8, dimensions["rod_length"])),
        Block("beta", ARMS, np.zeros((4, 3)), "rad"),
        Block("hinge", SIDES, hinges),
        Block("tilt", SIDES, np.zeros((2, 3)), "rad"),
    )
    points, tilts = layout.vectors("hinge", SIDES), layout.vectors("tilt", SIDES)
    reach = dimensions["base_radius"] + dimensions["arm_length"] - dimensions["side_radius"]
    home = np.array([0.0, 0.0, -np.sqrt(max(dimensions["rod_length"] ** 2 - reach**2, 0.0))])
    return Mechanism(
        kind="h4",
        parameters=layout.names,
        nominal=layout.nominal,
        units=layout.units,
        rods=PAIRS,
        actuators=tuple(f"q{i}" for i in ARMS),
        actuator_dimension="angle",
        actuator=arm,
        actuation=layout.rotary_arms(azimuth, ARMS, PAIRS),
        plate_columns=layout.vectors("b", PAIRS),
        levels={
            "nominal": layout.nominal_level(),
            "classical": layout.level(
                "classical", arm_columns(u, [[f"{i}1", f"{i}2"] for i in ARMS]),
                text="One offset for each motor, one length for each arm and its pair of rods; joints are where drawn.",
            ),
            "complete": layout.complete_level(),
        },
        start=lambda k, q: Pose(np.tile(home, (len(q), 1)), np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 2))),
        task=(0, 1, 2, 5),
        hinges=tuple(HingeColumns(points[h], tilts[h], np.array([0.0, 0.0, 1.0])) for h in range(2)),
        body=body,
    )


KIND = Kind(
    name="h4",
    dimensions=(
        radius("base_radius"),
        size("base_spacing"),
        size("arm_length"),
        size("rod_length"),
        radius("side_radius"),
        size("rod_spacing"),
        size("hinge_distance"),
        azimuths("axis_azimuth", 4),
    ),
    build=build,
)
