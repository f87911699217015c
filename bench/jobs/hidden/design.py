"""How data are taken: poses, conditions and instrument, and what the data file says of its noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench import sensors
from bench.instrument import Instrument
from bench.sensors import Sensor

BAR = ((0.0, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.5, 0.0, 0.0))
"""[m] The plate's centre and the ends of a metre bar across it."""
POINTS = ((0.0, 0.0, 0.0), (0.0, 0.0, -0.2), (0.12, 0.0, -0.1))
"""[m] Measured points of a rich plan: on the plate, below it, and to the side."""


@dataclass(frozen=True)
class Design:
    """One way to take data."""

    name: str
    plan: str = "rich"
    """'rich': payloads, directions, replicates, temperatures, time; 'plain': none of it."""
    rotations: bool = True
    """Whether the instrument sees the plate turn."""
    points: tuple[tuple[float, float, float], ...] = POINTS
    """(T, 3) [m] measured points in the plate frame."""
    stated: float = 1.0
    """σ in the data file over the σ there is."""
    rows: int = 120
    check: int = 30
    interleaved: bool = False
    """Whether the rows held out are drawn from all of the plan, and not its last ones."""
    sigma_pos: float = 15e-6
    """[m] the σ there is, per component."""
    sigma_rot: float = 60e-6
    """[rad]"""
    apart: bool = False
    """Whether replicates come at random times of the session, and not back to back."""
    instrument_settings: Mapping[str, Any] = field(default_factory=dict)
    """Further settings of the instrument, SI: the sort of its noise and what the file states of it."""
    sensors: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Sections of sensors of a truth file, which measure in place of an instrument that reads poses."""

    @property
    def columns(self) -> tuple[str, ...]:
        """What is recorded beside command and reading."""
        if self.plan == "plain":
            return ()
        return ("payload", "time", "temp_arms", "temp_rods", "temp_base", "dir1", "dir2", "dir3")

    @property
    def tools(self) -> list[np.ndarray]:
        """The tool of each measured point, (3,) [m], in the form that plans take."""
        return [np.array(point) for point in self.points]

    def instrument(self, noisy: bool = True) -> Instrument:
        """Return the instrument; without noise it sees the same."""
        kind = "none" if self.sensors else "pose" if self.rotations else "position"
        if not noisy:
            return Instrument(kind=kind)
        settings = {"sigma_pos": self.sigma_pos, "sigma_rot": self.sigma_rot} | dict(self.instrument_settings)
        return Instrument(kind=kind, **settings)

    def measuring(self, noisy: bool = True) -> tuple[Sensor, ...]:
        """Return the sensors; without noise their σ is multiplied by QUIET, so that the file still states one."""
        made = [sensors.make(name, table) for name, table in self.sensors.items()]
        for sensor in made:
            sensor.values = {**sensor.values, "sigma": sensor.values["sigma"] * (1.0 if noisy else QUIET)}
        return tuple(made)


QUIET = 1e-9
"""σ of sensors that have no noise, over the one that is counted with."""
_BALLBAR = {"sigma_um": 5, "stations_mm": [300, 0, -1050, -200, 250, -1050, -150, -280, -1050]}
_LEVEL = {"sigma_urad": 50, "zero_mrad": [3, -2], "level_mrad": [1, 2], "turn_deg": 1}
TRACKED = {
    "noise": "range_angle", "sigma_range": 5e-6, "sigma_distance": 5e-6, "sigma_angle": 8e-6,
    "position": np.array([1.5, -0.8, 0.2]), "state_covariance": True,
}  # fmt: skip
DESIGNS = {
    design.name: design
    for design in (
        Design("rich"),
        Design("rich-position", rotations=False),
        Design("plain", "plain", points=POINTS[:1]),
        Design("plain-position", "plain", rotations=False, points=POINTS[1:2]),
        Design("rich-understated", stated=0.6),
        Design("rich-overstated", stated=1.8),
        Design("ballbar", sensors={"ballbar": _BALLBAR, "inclinometer": _LEVEL}),
        Design("tracker", instrument_settings=TRACKED),
    )
}
