"""What may be hidden in a robot: every fault at its typical size, and by which name a diagnosis should call it.

A fault with an `effect` is in the library of :mod:`pcalib.effects`; one without is in no library, and the right answer
to it is that nothing known explains the data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import faults
from bench.faults import Fault
from pcalib.robot import Robot

Vary = Callable[[dict[str, Any], np.random.Generator], None]
"""Draws in place what typical settings leave open: phases, directions, signs."""

UNEVEN = (0.3, 1.7)
"""Range of what one arm or rod has of a fault's typical size where they differ."""


def _phase(values: dict[str, Any], rng: np.random.Generator) -> None:
    values["phase"] = rng.uniform(-np.pi, np.pi, len(values["phase"]))


def _sign(name: str) -> Vary:
    def vary(values: dict[str, Any], rng: np.random.Generator) -> None:
        values[name] = np.asarray(values[name]) * rng.choice([-1.0, 1.0], np.shape(values[name]))

    return vary


def _aim(*names: str) -> Vary:
    """Return a function that gives vectors random directions."""

    def vary(values: dict[str, Any], rng: np.random.Generator) -> None:
        for name in names:
            way = rng.standard_normal(3)
            values[name] = np.linalg.norm(values[name]) * way / np.linalg.norm(way)

    return vary


def _tilt(values: dict[str, Any], rng: np.random.Generator) -> None:
    size, way = np.hypot(values["x"], values["y"]), rng.uniform(-np.pi, np.pi)
    values["x"], values["y"] = float(size * np.cos(way)), float(size * np.sin(way))


@dataclass(frozen=True)
class Hidden:
    """One thing that may be wrong with a robot."""

    fault: str
    typical: Mapping[str, Any]
    """Settings as a truth file writes them."""
    effect: str | None
    """Name of the library's effect that describes it; None: no library lists it."""
    vary: Vary | None = None
    bar: bool = False
    """Whether only a scale bar shows it, two targets of known distance: elsewhere geometry takes up most of it."""
    companion: bool = False
    """Whether it is felt only where drives give way as well, which the user's model then knows already."""

    @property
    def name(self) -> str:
        """That of the fault."""
        return self.fault

    def needs(self, robot: Robot) -> tuple[str, ...]:
        """Return columns that are needed to simulate the fault."""
        return faults.make(robot, self.fault, self.typical).NEEDS

    def draw(self, robot: Robot, rng: np.random.Generator, uneven: bool = False) -> Fault:
        """Return the fault at typical size, with what is open drawn at random.

        Args:
            uneven: every arm or rod has a size of its own, where the fault knows arms or rods.
        """
        made = faults.make(robot, self.fault, self.typical)
        values = dict(made.values)
        if self.vary is not None:
            self.vary(values, rng)
        per = {s.name: s.per for s in made.SETTINGS}
        for name in sizes(made):
            if uneven and per[name] in ("actuator", "rod"):
                values[name] = values[name] * rng.uniform(*UNEVEN, len(values[name]))
        return type(made)(robot, **values)


def sizes(fault: Fault) -> tuple[str, ...]:
    """Return the settings that say how large a fault is."""
    return fault.SIZES or (fault.SETTINGS[0].name,)


def scaled(fault: Fault, factor: float) -> Fault:
    """Return the same fault, `factor` times as large."""
    values = {name: factor * np.asarray(fault.values[name]) for name in sizes(fault)}
    plain = {name: value if value.ndim else float(value) for name, value in values.items()}
    return type(fault)(fault.robot, **{**fault.values, **plain})


def largest(fault: Fault) -> float:
    """Return how many times larger a fault may become until one of its settings leaves the range that makes sense."""
    ranges = {s.name: (s.low, s.high) for s in fault.SETTINGS}
    most = np.inf
    for name in sizes(fault):
        low, high = ranges[name]
        value = np.atleast_1d(fault.values[name])
        for bound, part in ((high, value[value > 0]), (low, value[value < 0])):
            if len(part):
                most = min(most, float(np.min(bound / part)))
    return most


_ALL = (
    Hidden("drive_compliance", {"compliance_urad_Nm": 20.0}, "drive_compliance"),
    Hidden("rod_compliance", {"compliance_um_N": 0.05}, "rod_compliance"),
    Hidden("arm_bending", {"vertical_um_N": 0.2, "lateral_um_N": 0.2}, "arm_bending"),
    Hidden("tool_bending", {"compliance_um_N": 2.0}, "tool_bending"),
    Hidden("backlash", {"gap_arcmin": 2.0}, "backlash"),
    Hidden("friction_hysteresis", {"per_load_urad_Nm": 10.0}, "friction_hysteresis"),
    Hidden("encoder_eccentricity", {"amplitude_arcsec": 80.0}, "encoder_eccentricity", _phase),
    Hidden("encoder_ovality", {"amplitude_arcsec": 40.0}, "encoder_ovality", _phase),
    Hidden("gear_ratio", {"error_ppm": 200.0}, "gear_ratio", _sign("error")),
    Hidden("gear_ripple", {"amplitude_arcmin": 1.0, "cycles_per_rev": 24.0}, "gear_ripple", _phase),
    Hidden("thermal_arms", {"expansion_ppm_K": 23.6}, "thermal_arms"),
    Hidden("thermal_rods", {"expansion_ppm_K": 12.0}, "thermal_rods"),
    Hidden("thermal_base", {"expansion_ppm_K": 23.6}, "thermal_base"),
    Hidden("joint_clearance", {"gap_um": 8.0}, "joint_clearance"),
    Hidden("base_drift", {"v_um_h": [60.0, 0, 0], "w_urad_h": [60.0, 0, 0]}, "base_drift", _aim("v", "w")),
    Hidden("tracker_drift", {"v_um_h": [60.0, 0, 0], "w_urad_h": [60.0, 0, 0]}, "base_drift", _aim("v", "w")),
    Hidden("tracker_scale", {"scale_ppm": 10.0}, "tracker_scale", _sign("scale"), bar=True),
    Hidden("gravity_tilt", {"x_mrad": 10.0, "y_mrad": 0.0}, "gravity_tilt", _tilt, companion=True),
    # Twice a turn would be an encoder off centre, seen through the rods: five times is a shape of its own.
    Hidden("bearing_runout", {"radius_um": 10.0, "cycles_per_rev": 5.0}, None, _phase),
    Hidden("encoder_warming", {"per_kelvin_urad_K": 5.0}, None, _sign("per_kelvin")),
    Hidden("frame_bending", {"compliance_urad_Nm": 2.0}, None),
    Hidden("hose", {"stiffness_N_m": 50.0}, None, companion=True),
    Hidden("plate_flexing", {"compliance_um_N": 0.1}, None),
    Hidden("tool_creep", {"turn_urad": [200.0, 0, 0]}, None, _aim("turn")),
)
BELTS = {"compliance_urad_Nm": 67.0}
"""Drive compliance of the robots on which faults are tried that are felt through it: toothed belts, 15 kN·m/rad."""
CATALOGUE = {hidden.name: hidden for hidden in _ALL}
LISTED = tuple(h.name for h in _ALL if h.effect is not None)
UNLISTED = tuple(h.name for h in _ALL if h.effect is None)
