"""The hexapod (Gough–Stewart platform): six legs of commanded length between base and plate joints.

The plate stands above the base where `home_height` is positive. Commands are lengthenings, or motor angles where the
robot file states the `leg_travel` of each motor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcalib.kinds import Kind, azimuths, masses, offset, radius
from pcalib.mechanics.actuation import Legs
from pcalib.mechanics.layout import Block, Layout
from pcalib.mechanics.mechanism import Mechanism, Pose
from pcalib.settings import ABSENT, Setting

LEGS = ("1", "2", "3", "4", "5", "6")


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """A hexapod from its nominal dimensions: 48 raw parameters p(18) b(18) l(6) s(6), all seen by full poses."""
    home = np.array([0.0, 0.0, dimensions["home_height"]])
    p = _circle(dimensions["base_radius"], dimensions["base_azimuth"])
    b = _circle(dimensions["plate_radius"], dimensions["plate_azimuth"])
    layout = Layout.of(
        Block("p", LEGS, p),
        Block("b", LEGS, b),
        Block("l", LEGS, np.linalg.norm(home + b - p, axis=-1)),
        Block("s", LEGS, np.ones(6), "1"),
    )
    motors = "leg_travel" in dimensions
    zeros = {f"leg{i}.zero": ("m", {f"l{i}": 1.0}) for i in LEGS}
    travels = {f"leg{i}.travel": ("1", {f"s{i}": 1.0}) for i in LEGS}
    return Mechanism(
        kind="hexapod",
        parameters=layout.names,
        nominal=layout.nominal,
        units=layout.units,
        rods=LEGS,
        actuators=tuple(f"q{i}" for i in LEGS),
        actuator_dimension="angle" if motors else "length",
        actuator=np.arange(6),
        actuation=Legs(
            travel=dimensions["leg_travel"] if motors else np.ones(6),
            p=layout.vectors("p", LEGS),
            length=layout.numbers("l", LEGS),
            scale=layout.numbers("s", LEGS),
        ),
        plate_columns=layout.vectors("b", LEGS),
        levels={
            "nominal": layout.nominal_level(),
            "classical": layout.level(
                "classical", zeros | travels, text="A zero and a travel for each leg; joints are where drawn."
            ),
            "complete": layout.complete_level(),
        },
        start=lambda k, q: _home(home, len(q)),
        task=(0, 1, 2, 3, 4, 5),
        rod_side=1 if home[2] > 0 else -1,
    )


def _circle(radius: float, azimuth: np.ndarray) -> np.ndarray:
    return radius * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)


def _home(home: np.ndarray, n: int) -> Pose:
    """The plate at its home height: Newton reaches the whole workspace from there."""
    return Pose(np.tile(home, (n, 1)), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 0)))


KIND = Kind(
    name="hexapod",
    dimensions=(
        radius("base_radius"),
        radius("plate_radius"),
        offset("home_height"),
        azimuths("base_azimuth", 6),
        azimuths("plate_azimuth", 6),
        Setting("leg_travel", "travel", ABSENT, -1.0, 1.0, count=6),
    ),
    build=build,
    masses=masses("rod", "plate"),
)
