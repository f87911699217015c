"""Configuration values for linear-Delta printers, in the names of Klipper and RepRapFirmware.

Such a firmware knows three virtual rods that share one plate point: three upright towers on one circle, each with a
direction, an endstop, a motor scale and a rod length. Carriage i at height z_i and nozzle at (x, y, z) obey

    (x − r·cos α_i)² + (y − r·sin α_i)² + (z − z_i)² = L_i²,      z_i = H_i − s_i·(q_home − q_i)

with q counted by the present configuration and q_home its value at the endstops, the upper end of the joint range. The
values returned make this model agree best with a calibrated one over the workspace, effects included: a gear ratio
goes into s_i. What it cannot hold is stated, and so is what payload, temperature, time and direction change, of which a
firmware knows nothing: effects count without payload, at 20 °C and at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pcalib import prediction, wording
from pcalib.errors import InputError
from pcalib.mechanics import kinematics
from pcalib.model import Model
from pcalib.prediction import Conditions, Prediction
from pcalib.robot import Robot

_SLOTS = np.radians([210.0, 330.0, 90.0])
"""Directions of the towers that both firmwares call first (a, X), second (b, Y) and third (c, Z)."""


@dataclass(frozen=True)
class ThreeArms:
    """A printer as its firmware sees it."""

    radius: float
    """[m] r: tower joints to plate joints, seen from above: 'delta radius'."""
    rod: np.ndarray
    """(3,) [m] L_i."""
    angle: np.ndarray
    """(3,) [rad] α_i."""
    homed: np.ndarray
    """(3,) [m] H_i: heights of the carriage joints at the endstops."""
    scale: np.ndarray
    """(3,) s_i: true over counted motion of the carriages."""
    q_home: float
    """[m]."""

    @property
    def endstop(self) -> np.ndarray:
        """(3,) [m] height of a nozzle in the middle over the bed when this carriage is at its endstop."""
        return self.homed - np.sqrt(self.rod**2 - self.radius**2)

    def nozzle(self, q: np.ndarray) -> np.ndarray:
        """Nozzle positions (N, 3) [m] for carriage heights q (N, 3) as counted; NaN where the rods do not meet."""
        z = self.homed - self.scale * (self.q_home - q)
        tower = self.radius * np.stack([np.cos(self.angle), np.sin(self.angle)], axis=-1)
        # The spheres' differences are linear: (x, y) = a + b·z; the first sphere then is a quadratic in z.
        M = np.linalg.inv(2 * (tower[1:] - tower[0])).T
        a = (z[:, 1:] ** 2 - z[:, :1] ** 2 - self.rod[1:] ** 2 + self.rod[0] ** 2) @ M
        b = -2 * (z[:, 1:] - z[:, :1]) @ M
        e = a - tower[0]
        A, B = np.sum(b * b, axis=-1) + 1, np.sum(e * b, axis=-1) - z[:, 0]
        C = np.sum(e * e, axis=-1) + z[:, 0] ** 2 - self.rod[0] ** 2
        with np.errstate(invalid="ignore"):
            height = (-B - np.sqrt(B * B - A * C)) / A
        return np.concatenate([a + b * height[:, None], height[:, None]], axis=-1)


@dataclass(frozen=True)
class Configuration:
    """The best three-arm model of a calibrated printer, and what it loses."""

    arms: ThreeArms
    rms: float
    """[m] RMS distance between the three-arm model and the calibrated one over the workspace."""
    largest: float
    """[m] Largest distance between the two models."""
    rms_z: float
    """[m] RMS of the vertical part of the distance."""
    tilt: float
    """[rad] Largest tilt of the plate, which a three-arm model does not know."""
    level: str
    """Geometry level of the calibrated model."""
    bed_radius: float
    """[m] Radius of the workspace, which the firmware takes for that of the bed."""
    effects: tuple[str, ...] = ()
    """Effects of the calibrated model."""
    unknown: Mapping[str, float] = field(default_factory=dict)
    """[m] Condition that a firmware does not know → largest shift of the nozzle by it."""

    def klipper(self) -> str:
        """The changed values of a printer.cfg."""
        lines = ["[printer]", "kinematics: delta", f"delta_radius: {self.arms.radius * 1e3:.4f}"]
        for i, name in enumerate("abc"):
            lines += [
                "",
                f"[stepper_{name}]",
                f"position_endstop: {self.arms.endstop[i] * 1e3:.4f}",
                f"arm_length: {self.arms.rod[i] * 1e3:.4f}",
                f"angle: {np.degrees(self.arms.angle[i]) % 360:.4f}",
            ]
            if abs(self.arms.scale[i] - 1) > 1e-7:
                lines.append(f"# rotation_distance: the present value times {self.arms.scale[i]:.7f}")
        return "\n".join(lines) + "\n"

    def rrf(self) -> str:
        """The commands of a config.g.

        Raises:
            InputError: the towers do not stand where RepRapFirmware expects X, Y and Z.
        """
        correction = np.degrees(np.mod(self.arms.angle - _SLOTS + np.pi, 2 * np.pi) - np.pi)
        if np.abs(correction).max() > 20:
            raise InputError(
                "RepRapFirmware counts towers X, Y, Z at 210°, 330° and 90°; this robot's stand elsewhere",
                remedy="name the towers in that order in tower_azimuth_deg",
            )
        rods = [f"{v * 1e3:.4f}" for v in self.arms.rod]
        homed = float(self.arms.endstop.mean())
        turn = " ".join(f"{axis}{v:.4f}" for axis, v in zip("XYZ", correction, strict=True))
        stops = " ".join(f"{axis}{v * 1e3:.4f}" for axis, v in zip("XYZ", self.arms.endstop - homed, strict=True))
        lines = [
            f"M665 L{rods[0] if len(set(rods)) == 1 else ':'.join(rods)} R{self.arms.radius * 1e3:.4f} "
            f"H{homed * 1e3:.4f} B{self.bed_radius * 1e3:.1f} {turn}",
            f"M666 {stops}",
        ]
        for axis, value in zip("XYZ", self.arms.scale, strict=True):
            if abs(value - 1) > 1e-7:
                lines.append(f"; M92 {axis}: the present value divided by {value:.7f}")
        return "\n".join(lines) + "\n"

    def statement(self) -> str:
        """What is lost by writing the calibration into a three-arm firmware."""
        text = (
            "A three-arm firmware holds one radius, three upright towers and one rod per tower that meet in one point: "
            "no difference between the two rods of a pair, no lean of a tower, no tilt of the plate, no radius of a "
            "tower's own. "
        )
        level = f"level {self.level}{' with ' * bool(self.effects)}{', '.join(self.effects)}"
        if self.largest < 1e-6 and self.tilt < 1e-6:
            text += f"L{level[1:]} has no more than that, so nothing of it is lost here"
            text += "." if self.unknown else "; what else the printer has was not looked for."
        else:
            text += (
                f"Of {level} it loses {wording.size(self.rms)} RMS ({wording.size(self.largest)} at most, "
                f"{wording.size(self.rms_z)} RMS in height) over the workspace, and a tilt of the plate of up to "
                f"{wording.angle(self.tilt)}, which moves a nozzle 50 mm below the joints by "
                f"{wording.size(0.05 * self.tilt)}."
            )
        if self.unknown:
            each = ", ".join(f"{what} by {wording.size(most)}" for what, most in self.unknown.items())
            text += (
                " The values hold without payload, at 20 °C and at rest. A firmware does not know what else moves the "
                f"nozzle, at most: {each}."
            )
        return text

    def json(self) -> dict[str, Any]:
        """Stable keys; lengths in mm, angles in degrees, as the firmwares count."""
        a = self.arms
        return {
            "delta_radius_mm": a.radius * 1e3,
            "arm_length_mm": a.rod * 1e3,
            "angle_deg": np.degrees(a.angle) % 360,
            "position_endstop_mm": a.endstop * 1e3,
            "rotation_distance_factor": a.scale,
            "loss": {
                "rms_um": self.rms * 1e6, "max_um": self.largest * 1e6, "rms_z_um": self.rms_z * 1e6,
                "tilt_urad": self.tilt * 1e6,
            },
            "effects": self.effects,
            "unknown": [{"condition": what, "max_um": most * 1e6} for what, most in self.unknown.items()],
            "statement": self.statement(),
        }  # fmt: skip


def configuration(model: Model) -> Configuration:
    """The three-arm model nearest to a calibrated linear Delta.

    Raises:
        InputError: another kind of robot.
    """
    from scipy.optimize import least_squares

    robot, mechanism = model.robot, model.robot.mechanism
    if robot.kind != "linear_delta":
        raise InputError(
            f"printer firmware knows linear Deltas; '{robot.name}' is of kind {robot.kind}",
            remedy="use 'pcalib compensate' for corrected commands",
        )
    found = kinematics.inverse(mechanism, mechanism.nominal, _grid(robot))
    q = found.q[found.ok & (found.q >= robot.joint_min).all(axis=1) & (found.q <= robot.joint_max).all(axis=1)]
    there, x = _nozzle(model, q, _conditions(model, len(q)))
    q, x, R = q[there.reached], x[there.reached], there.rotation[there.reached]
    if x.size < 13:
        raise InputError(
            f"only {len(x)} points of the workspace can be reached within the joint range",
            remedy="check [workspace] and [joints] of the robot file, as the model file carries it",
        )
    q_home = robot.joint_max
    scale = model.k[[mechanism.index(f"s{i}") for i in (1, 2, 3)]]

    def arms(v: np.ndarray) -> ThreeArms:
        return ThreeArms(float(v[0]), v[1:4], v[4:7], v[7:10], v[10:] if model.effects else scale, q_home)

    size = robot.dimensions
    start = np.concatenate([
        [size["tower_radius"] - size["plate_radius"]], np.full(3, size["rod_length"]), size["tower_azimuth"],
        model.k[[mechanism.index(f"p{i}.z") for i in (1, 2, 3)]] + scale * q_home,
        scale if model.effects else [],
    ])  # fmt: skip
    best = least_squares(
        lambda v: (arms(v).nozzle(q) - x).ravel(), start, method="lm", x_scale="jac", xtol=1e-15, ftol=1e-15,
        gtol=1e-15,
    )  # fmt: skip
    error = arms(best.x).nozzle(q) - x
    length = np.linalg.norm(error, axis=1)
    return Configuration(
        arms=arms(best.x),
        rms=float(np.sqrt(np.mean(length**2))),
        largest=float(length.max()),
        rms_z=float(np.sqrt(np.mean(error[:, 2] ** 2))),
        tilt=float(np.arccos(np.clip(R[:, 2, 2], -1, 1)).max()),
        level=model.level,
        bed_radius=robot.workspace.radius,
        effects=tuple(fitted.effect.name for fitted in model.effects),
        unknown=_unknown(model, q, x),
    )


def _conditions(model: Model, n: int, payload: float = 0.0, **changed: float) -> Conditions:
    """What a firmware takes for granted at N poses: no payload, 20 °C, rest, 0 elsewhere; save what is `changed`."""
    own = {name for fitted in model.effects for name in fitted.effect.needs if not name.startswith("temp_")}
    values = dict.fromkeys(sorted(own | set(_directions(model))), 0.0) | {"temp": 20.0, "time": 0.0} | changed
    columns = {name: np.full(n, value) for name, value in values.items()}
    return Conditions(np.zeros((n, 3)), np.full(n, payload), columns)


def _directions(model: Model) -> list[str]:
    return [f"dir{i + 1}" for i in range(len(model.robot.mechanism.actuators))]


def _nozzle(model: Model, q: np.ndarray, conditions: Conditions) -> tuple[Prediction, np.ndarray]:
    """The prediction in the base frame, and nozzle positions (N, 3) [m] without what an instrument adds."""
    p = prediction.predict(replace(model, frame=None), q, conditions)
    return p, p.position if p.contribution.sensor is None else p.position - p.contribution.sensor


def _unknown(model: Model, q: np.ndarray, x: np.ndarray) -> dict[str, float]:
    """[m] Condition that a firmware does not know → largest shift of the nozzles x (N, 3), where there is one."""
    if not model.effects:
        return {}
    usual = _conditions(model, 1)
    changes = [("1 kg of payload", {"payload": 1.0}), ("10 °C more", {"temp": 30.0}), ("an hour", {"time": 3600.0})]
    changes += [("the direction of motion", dict.fromkeys(_directions(model), sign)) for sign in (1.0, -1.0)]
    known = {"temp", "time", *_directions(model)}
    changes += [(f"1 more of {name}", {name: 1.0}) for name in usual.columns if name not in known]
    out: dict[str, float] = {}
    for what, change in changes:
        there, moved = _nozzle(model, q, _conditions(model, len(q), **change))
        most = float(np.linalg.norm(moved - x, axis=1)[there.reached].max(initial=0.0))
        if most > 1e-7:
            out[what] = max(most, out.get(what, 0.0))
    return out


def _grid(robot: Robot) -> np.ndarray:
    """Points (N, 3) [m] throughout the working cylinder, its rim included."""
    w = robot.workspace
    rings = [np.zeros((1, 2))]
    for share in (0.25, 0.5, 0.75, 1.0):
        turn = np.linspace(0, 2 * np.pi, int(24 * share) + 1)[:-1]
        rings.append(share * w.radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1))
    flat = np.concatenate(rings)
    heights = np.linspace(w.z_min, w.z_max, 5)
    return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in heights])
