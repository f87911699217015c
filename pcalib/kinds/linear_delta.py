"""The linear Delta: three carriages on towers that may lean, six rods in three parallelograms, three translations.

q is the height of a carriage's joints over the base plane. On a printer the base plane is the bed and C the nozzle.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcalib.kinds import Kind, azimuths, masses, radius, size
from pcalib.kinds.delta import simplified_pose
from pcalib.mechanics.actuation import Carriages
from pcalib.mechanics.layout import Block, Layout, along
from pcalib.mechanics.mechanism import Level, Mechanism

TOWERS = ("1", "2", "3")
PAIRS = tuple(f"{i}{j}" for i in TOWERS for j in "12")


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """A linear Delta from its nominal dimensions, 63 raw parameters: p(9) a(18) b(18) l(6) beta(9) s(3)."""
    azimuth = dimensions["tower_azimuth"]
    v = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
    u = np.stack([np.sin(azimuth), -np.cos(azimuth), 0 * azimuth], axis=-1)
    tower = np.repeat(np.arange(3), 2)
    side = 0.5 * dimensions["rod_spacing"] * np.tile([-1.0, 1.0], 3)[:, None] * u[tower]
    layout = Layout.of(
        Block("p", TOWERS, dimensions["tower_radius"] * v),
        Block("a", PAIRS, side),
        Block("b", PAIRS, side + dimensions["plate_radius"] * v[tower]),
        Block("l", PAIRS, np.full(6, dimensions["rod_length"])),
        Block("beta", TOWERS, np.zeros((3, 3)), "rad"),
        Block("s", TOWERS, np.ones(3), "1"),
    )
    actuation = Carriages(
        direction=np.tile([0.0, 0.0, 1.0], (3, 1)),
        actuator=tower,
        p=layout.vectors("p", TOWERS),
        beta=layout.vectors("beta", TOWERS),
        scale=layout.numbers("s", TOWERS),
        a=layout.vectors("a", PAIRS),
        length=layout.numbers("l", PAIRS),
    )
    plate_columns = layout.vectors("b", PAIRS)
    return Mechanism(
        kind="linear_delta",
        parameters=layout.names,
        nominal=layout.nominal,
        units=layout.units,
        rods=PAIRS,
        actuators=tuple(f"q{i}" for i in TOWERS),
        actuator_dimension="length",
        actuator=tower,
        actuation=actuation,
        plate_columns=plate_columns,
        levels=_levels(layout, u, v, dimensions["tower_radius"] - dimensions["plate_radius"]),
        start=lambda k, q: simplified_pose(actuation, plate_columns, k, q),
        level_pairs=True,
    )


_LEVEL = "The plate cannot tilt in this model."


def _levels(layout: Layout, u: np.ndarray, v: np.ndarray, radius: float) -> dict[str, Level]:
    """Levels of the field and of printer firmware, whose three virtual rods have one common plate point."""
    zeros = {f"q{i}.offset": ("m", {f"p{i}.z": 1.0}) for i in TOWERS}
    rods = {f"rod{i}.length": ("m", {f"l{i}1": 1.0, f"l{i}2": 1.0}) for i in TOWERS}
    radii = {f"tower{i}.radius": ("m", along(f"p{i}", v[n])) for n, i in enumerate(TOWERS)}
    angles = {f"tower{i}.angle": ("rad", along(f"p{i}", -radius * u[n])) for n, i in enumerate(TOWERS)}
    leans = {f"tower{i}.lean.{c}": ("rad", {f"beta{i}.{c}": 1.0}) for i in TOWERS for c in "xy"}
    # A turn of all three towers only turns the robot about z: tower 3 holds the direction.
    two_angles = {name: angles[name] for name in ("tower1.angle", "tower2.angle")}
    common_radius = {"radius": ("m", {e: d for _, entries in radii.values() for e, d in entries.items()})}
    common_rod = {"rod.length": ("m", {e: d for _, entries in rods.values() for e, d in entries.items()})}
    firmware6 = zeros | common_radius | two_angles
    firmware = {
        "firmware4": (zeros | common_radius, "Endstops and one radius"),
        "firmware6": (firmware6, "Endstops, one radius and the angles of the towers"),
        "firmware7": (firmware6 | common_rod, "Endstops, one radius, the angles of the towers and one rod length"),
        "tower_radii": (
            zeros | radii | two_angles | common_rod, "Endstops, a radius and an angle of each tower, one rod length"
        ),
    }  # fmt: skip
    lean = "What six numbers of a firmware hold, and which way each tower leans"
    classical = "One rod for each parallelogram; an endstop, a radius and a rod length for each tower"
    return {
        "nominal": layout.nominal_level(),
        **{
            name: layout.level(name, columns, perfect=True, strict=True, text=f"{text}. {_LEVEL}")
            for name, (columns, text) in firmware.items()
        },
        "tower_lean": layout.level("tower_lean", firmware6 | leans, perfect=True, text=f"{lean}. {_LEVEL}"),
        "classical": layout.level("classical", zeros | radii | rods, perfect=True, text=f"{classical}. {_LEVEL}"),
        "complete": layout.complete_level(),
    }


KIND = Kind(
    name="linear_delta",
    dimensions=(
        radius("tower_radius"),
        radius("plate_radius"),
        size("rod_length"),
        size("rod_spacing"),
        azimuths("tower_azimuth", 3),
    ),
    build=build,
    masses=masses("carriage", "rod", "plate"),
)
