"""What a measurement file holds, what is wrong with it, and what each lack means for the steps that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib import findings, wording
from pcalib.data import replicates
from pcalib.data.columns import TEMPERATURES
from pcalib.data.measurement import Measurements
from pcalib.data.replicates import ReplicateScatter
from pcalib.findings import Finding, is_direction, span, verified
from pcalib.fitting import as_drawn, mixups
from pcalib.fitting.as_drawn import Nominal
from pcalib.robot import Robot
from pcalib.uncertainty.forecast import forecast

SCHEMA = "pcalib.inspect/1"


@dataclass(frozen=True)
class Inspection:
    """Facts and findings of a measurement file."""

    facts: Mapping[str, Any]
    """What the file holds, in the form of the JSON."""
    findings: tuple[Finding, ...]
    absurd: bool = False
    """Whether no calibration should be made of the file without being asked for."""

    @property
    def errors(self) -> tuple[Finding, ...]:
        """What makes the file unusable as it stands."""
        return tuple(f for f in self.findings if f.level == "error")

    def to_json(self) -> dict[str, Any]:
        """Schema pcalib.inspect/1."""
        return {
            "schema": SCHEMA,
            **self.facts,
            "findings": [{**vars(f), "names": sorted(f.names)} for f in self.findings],
        }


def inspect(data: Measurements, robot: Robot | None = None) -> Inspection:
    """Facts and findings; with a robot also its joint coverage and the comparison with its nominal geometry."""
    noise = replicates.noise(data)
    nominal = as_drawn.compare(data, robot) if robot is not None else None
    facts = _facts(data, robot, noise, nominal)
    found = [
        *findings.amount(data, robot),
        *findings.joint_coverage(data, robot),
        *findings.conditions(data),
        *findings.noise_level(data, noise),
        *findings.values(data, robot),
        *findings.rotations(data),
        *findings.clock(data),
    ]
    absurd = False
    if nominal is not None and robot is not None:
        judged = mixups.judge(data, robot)
        found += findings.against_nominal(data, nominal, judged)
        absurd = judged.absurd
        told = None if judged.far or judged.named else forecast(data, robot)
        facts["forecast"] = told and told.to_json()
        found = findings.with_forecast(found, told)
    order = ("error", "warning", "note")
    return Inspection(facts, tuple(sorted(found, key=lambda f: order.index(f.level))), absurd)


def _median(data: Measurements, axes: slice) -> float:
    """Median σ of the readings; of all σ where nothing is measured."""
    seen = data.mask[:, axes]
    return float(np.median(data.sigma[:, axes][seen] if seen.any() else data.sigma[:, axes]))


def _facts(data: Measurements, robot: Robot | None, noise: ReplicateScatter, nominal: Nominal | None) -> dict[str, Any]:
    place = ~np.isnan(data.position)
    whole, some, turned = place.all(axis=1), place.any(axis=1), data.turned
    scale = np.rad2deg(1.0) if data.actuator_dimension == "angle" else 1e3
    joints = []
    for name, q in zip(data.actuators, data.q.T, strict=True):
        low, high = robot.joint_range if robot is not None else (np.nan, np.nan)
        joints.append({
            "name": name, "unit": "deg" if data.actuator_dimension == "angle" else "mm",
            "min": q.min() * scale, "max": q.max() * scale, "share_of_range": np.ptp(q) / (high - low),
        })  # fmt: skip
    payloads, counts = np.unique(np.round(data.payload, 6), return_counts=True)
    directions = {
        name: {str(side): int(np.sum(values == side)) for side in (-1, 0, 1)}
        for name, values in data.columns.items()
        if is_direction(name)
    }
    sensors = [
        {"sensor": sensor.name, "title": sensor.title, "to": to, "rows": len(rows)}
        for sensor, to, rows in (data.readings.parts if data.readings is not None else [])
    ]
    known = {"temp", *TEMPERATURES, "time", *directions}
    return {
        "file": data.source,
        "robot": data.robot_name or None,
        "frame": data.frame,
        "rows": len(data),
        "fit": int(np.sum(~data.check)),
        "check": int(np.sum(data.check)),
        "measured": {
            "full_pose": int(np.sum(whole & turned)),
            "position_only": int(np.sum(whole & ~turned)),
            "partial": int(np.sum(~whole & (some | turned))),
            "nothing": int(np.sum(~data.mask.any(axis=1))),
        },
        "sensors": sensors,
        "readings": int(data.mask.sum()),
        "joints": joints,
        "position_mm": {
            axis: {"min": np.nanmin(v) * 1e3, "max": np.nanmax(v) * 1e3} if not np.isnan(v).all() else None
            for axis, v in zip("xyz", data.position.T, strict=True)
        },
        "tools_mm": np.unique(np.round(data.tool * 1e3, 6), axis=0)[:20],
        "payloads": [{"payload_kg": p, "rows": int(n)} for p, n in zip(payloads, counts, strict=True)][:20],
        "temperatures_degC": {c: span(data.columns[c]) for c in ("temp", *TEMPERATURES) if c in data.columns},
        "time_s": span(data.columns["time"]) if "time" in data.columns else None,
        "directions": directions,
        "own_columns": [c for c in data.columns if c not in known] + list(data.notes),
        "sigma": {
            "stated": data.sigma_stated,
            "pos_stated": data.stated[0] if data.kinds[0] else None,
            "rot_stated": data.stated[1] if data.kinds[1] else None,
            "pos_um": _median(data, slice(0, 3)) * 1e6,
            "rot_urad": _median(data, slice(3, 6)) * 1e6,
        },
        "replicates": {
            "groups": noise.groups, "rows": noise.rows, "verified": verified(noise),
            "sigma_pos_um": noise.sigma_pos * 1e6, "dof_pos": noise.dof_pos, "ratio_pos": noise.ratio_pos,
            "sigma_rot_urad": noise.sigma_rot * 1e6, "dof_rot": noise.dof_rot, "ratio_rot": noise.ratio_rot,
        },
        "nominal": nominal
        and {"rms_pos_um": nominal.rms * 1e6, "aligned_rms_pos_um": nominal.aligned_rms * 1e6},
    }  # fmt: skip


def words(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The facts of a file in words."""
    measured, noise, sigma = facts["measured"], facts["replicates"], facts["sigma"]
    kinds = [f"{n} {kind.replace('_', ' ')}" for kind, n in measured.items() if n]
    kinds += _sensed(facts["sensors"])
    rows = [
        ("rows", f"{facts['rows']} ({facts['fit']} fit, {facts['check']} check)"),
        ("measured", f"{', '.join(kinds)}; {facts['readings']} readings"),
        ("frame", facts["frame"]),
        ("robot", facts["robot"] or "not named"),
        *(
            (f"{axis}", f"{span['min']:.1f} … {span['max']:.1f} mm")
            for axis, span in facts["position_mm"].items()
            if span
        ),
        ("tools", "; ".join("(" + ", ".join(f"{v:g}" for v in tool) + ") mm" for tool in facts["tools_mm"][:4])),
        ("payloads", ", ".join(f"{p['payload_kg']:g} kg × {p['rows']}" for p in facts["payloads"][:8])),
    ]
    for name, seen in facts["temperatures_degC"].items():
        if name == "temp" or "temp" not in facts["temperatures_degC"]:
            rows.append((name, f"{seen['min']:.1f} … {seen['max']:.1f} °C"))
    if facts["time_s"]:
        rows.append(("time", f"{facts['time_s']['min']:.0f} … {facts['time_s']['max']:.0f} s"))
    for name, sides in facts["directions"].items():
        rows.append((name, ", ".join(f"{'+' if side == '1' else ''}{side} × {n}" for side, n in sides.items() if n)))
    each = [
        f"{text} ({'stated' if stated else 'not stated, assumed'})"
        for text, stated in (
            (wording.size(1e-6 * sigma["pos_um"]), sigma["pos_stated"]),
            (wording.angle(1e-6 * sigma["rot_urad"]), sigma["rot_stated"]),
        )
        if stated is not None
    ]  # fmt: skip
    rows.append(("σ of the instrument", ", ".join(each) or "–"))
    if noise["groups"]:
        parts = [f"{noise['rows']} rows in {noise['groups']} groups"]
        if noise["dof_pos"]:
            parts.append(f"scatter {wording.size(1e-6 * noise['sigma_pos_um'])} ({noise['ratio_pos']:.2f} σ)")
        if noise["dof_rot"]:
            parts.append(f"{wording.angle(1e-6 * noise['sigma_rot_urad'])} ({noise['ratio_rot']:.2f} σ)")
        rows.append(("replicates", ", ".join(parts)))
    if facts["own_columns"]:
        rows.append(("own columns", ", ".join(facts["own_columns"])))
    nominal = facts["nominal"]
    if nominal is not None and nominal["rms_pos_um"] == nominal["rms_pos_um"]:
        rows.append(("from the nominal robot", f"{nominal['rms_pos_um'] / 1e3:.3g} mm rms"))
    told = facts.get("forecast")
    if told is not None:
        first, last = told["landings"][0], told["landings"][-1]  # one and the same where tools change nothing
        longer = ""
        if last != first:
            longer = f", {wording.size(1e-6 * last['u95_um'])} with a {last['tool_mm']:.0f} mm tool"
        rows.append(("a fit lets land within", f"{wording.size(1e-6 * first['u95_um'])} at the plate{longer} (95 %)"))
    return rows


def _sensed(found: list[dict[str, Any]]) -> list[str]:
    """What sensors read, in words: '150 distances to stations (A × 50, B × 100)'."""
    out = []
    for title in dict.fromkeys(one["title"] for one in found):
        mine = [one for one in found if one["title"] == title]
        to = ", ".join(f"{one['to']} × {one['rows']}" for one in mine if one["to"])
        out.append(f"{sum(one['rows'] for one in mine)} {title}" + (f" ({to})" if to else ""))
    return out
