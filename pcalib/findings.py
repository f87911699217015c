"""Findings about a measurement file: what is wrong or lacking, in plain sentences, and what that means later on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pcalib import rotation, wording
from pcalib.data import orientation
from pcalib.data.columns import TEMPERATURES
from pcalib.data.measurement import Measurements
from pcalib.data.replicates import ReplicateScatter, groups
from pcalib.fitting import as_drawn, mixups
from pcalib.fitting.as_drawn import Nominal
from pcalib.fitting.mixups import Judgement
from pcalib.robot import Robot
from pcalib.uncertainty.forecast import Forecast

ENOUGH_DOF = 20
"""Degrees of freedom of replicates from which the noise counts as verified: σ to about ± 16 %."""
DOUBTFUL = 0.001
"""p below which the scatter of replicates and σ are said to disagree."""


@dataclass(frozen=True)
class Finding:
    """One thing to know about a file."""

    level: str
    """'error': not usable as it stands; 'warning': usable, something is wrong or will be missed; 'note'."""
    code: str
    """Stable name, for programs."""
    message: str
    remedy: str = ""
    """What to do about it, where that is more than the message says."""
    names: frozenset[str] = frozenset()
    """Codes of the misreadings that a finding names."""


def amount(data: Measurements, robot: Robot | None) -> Iterator[Finding]:
    """How much is measured, and what is held out."""
    used = data.take(data.fit_rows)
    readings = int(used.mask.sum())
    nothing = np.all(~data.mask, axis=1)
    if data.readings is not None and data.readings.origin is not None:  # distances are measured from these poses
        nothing[data.readings.origin[data.readings.origin >= 0]] = False
    if nothing.all():
        yield Finding(
            "error", "nothing_measured", "No row holds a measurement: x, y, z and rotation are all blank.",
            "Fill in what the instrument read.",
        )  # fmt: skip
        return
    if nothing.any():
        yield Finding("warning", "empty_rows", f"No measurement in {_lines(data, nothing)}.")
    if not len(used):
        yield Finding(
            "error", "nothing_to_fit", "All rows are set = check: there is nothing to fit.",
            "Mark some rows fit, or leave the column 'set' out.",
        )  # fmt: skip
        return
    poses = len(np.unique(np.round(used.q, 9), axis=0))
    if poses == 1:
        yield Finding("warning", "one_pose", "There is one pose only: a fit needs poses all over the workspace.")
    elif robot is not None:
        most = max(len(level.columns) for level in robot.mechanism.levels.values())
        if readings < 2 * most:
            yield Finding(
                "warning", "few_readings",
                f"{poses} poses give {readings} readings for up to {most} parameters of level 'complete': "
                "expect weakly determined ones, or fit a smaller level.",
            )  # fmt: skip
    if not data.check.any():
        yield Finding(
            "note", "no_check_rows",
            "No rows are held out (set = check): the accuracy on poses that were not fitted stays unknown.",
        )  # fmt: skip
    shared = np.intersect1d(data.pose_id[data.check], data.pose_id[~data.check])
    if (shared >= 0).any():
        yield Finding(
            "warning", "leak",
            f"Rows of one pose_id stand both in fit and in check ({np.sum(shared >= 0)} ids): the check is not "
            "independent.",
        )  # fmt: skip
    yield from _sensed(data)
    if not data.mask[:, 3:].any() and (robot is None or robot.mechanism.plate_turns):
        tools = len(np.unique(np.round(data.tool, 6), axis=0))
        if tools < 3:
            yield Finding(
                "note", "position_only",
                f"Only {'positions' if data.readings is None else 'lengths'} are measured, with {tools} tool "
                f"point{'s' * (tools > 1)}: the plate's own rotation, and the errors that only turn it, are seen in "
                "part; three tool points would show all of it.",
            )  # fmt: skip


def _sensed(data: Measurements) -> Iterator[Finding]:
    """Findings on what the readings of sensors cannot determine."""
    if data.readings is None:
        return
    if data.frame == "base" and np.isnan(data.position).all():
        yield Finding(
            "note", "base_unknown",
            "No reading says where the base stands: a fit holds it at its nominal place, and commands are right "
            "relative to each other.",
        )  # fmt: skip
    for sensor, to, rows in data.readings.parts:
        unknowns = sum(len(block.parameters) for block in sensor.blocks(to, data.readings.options))
        used = int(np.sum(~data.check[rows]))
        if used < 3 * unknowns and sensor.to is not None:
            yield Finding(
                "warning", "few_to_station",
                f"{sensor.to.capitalize()} {to} has {used} readings to fit and {unknowns} unknowns of its own: "
                "little is left to determine the robot.",
                "Measure to it at ten or more poses.",
            )  # fmt: skip


def with_forecast(found: list[Finding], told: Forecast | None) -> list[Finding]:
    """The findings, and what a fit to the data could not tell."""
    if told is None or not told.tilts_unseen:
        return found
    said = f"After a fit, 95 % of landings will lie within {told.landings}."
    if any(f.code == "position_only" for f in found):
        return [replace(f, message=f"{f.message} {said}") if f.code == "position_only" else f for f in found]
    seen = Finding(
        "note", "tilts_unseen", f"These readings show turns of the plate in part. {said}",
        "Before long tools are used, read its orientation as well (an inclinometer will do), or measure further tool "
        "points.",
    )  # fmt: skip
    return [*found, seen]


def joint_coverage(data: Measurements, robot: Robot | None) -> Iterator[Finding]:
    """How far the joints moved."""
    spans = np.ptp(data.q, axis=0)
    same = [
        f"{data.actuators[i]} and {data.actuators[j]}"
        for i in range(len(spans))
        for j in range(i)
        if spans[i] > 0 and np.array_equal(data.q[:, i], data.q[:, j])
    ]
    if same and len(data) > 2:
        yield Finding("warning", "equal_columns", f"{'; '.join(same)} are equal in every row: was one copied?")
    if robot is None:
        return
    low, high = robot.joint_range
    if len(data) > 1 and np.abs(data.q).max() < 0.03 * max(abs(low), abs(high)):
        unit = "rad" if data.actuator_dimension == "angle" else "m"
        yield Finding(
            "warning", "tiny_joints",
            f"All actuator values are tiny beside the joint range: if they were written in {unit}, name the columns "
            f"{data.actuators[0]}_{unit} and so on.",
        )  # fmt: skip
        return
    shares = zip(data.actuators, spans / (high - low), strict=True)
    narrow = [f"{name} {100 * share:.0f} %" for name, share in shares if share < 0.4]
    if narrow and len(data) > 1:
        yield Finding(
            "warning", "narrow_joints",
            f"Joints cover little of their range ({', '.join(narrow)}): lengths, offsets, gear ratio and encoder "
            "eccentricity are then hard to tell apart.",
        )  # fmt: skip


MASS = ("_kg", "_g")
"""Endings of the names of columns that hold masses."""


def conditions(data: Measurements) -> Iterator[Finding]:
    """Payload, direction, temperature and time: what their lack hides."""
    if np.ptp(data.payload) == 0:
        masses = [name for name in data.columns if name.endswith(MASS) and np.ptp(data.columns[name]) > 0]
        unread = "".join(f" Is {m} the payload? Name that column payload_{m.rpartition('_')[2]}." for m in masses[:1])
        yield Finding(
            "warning", "no_payload_variation",
            f"All rows carry the same payload ({data.payload[0]:g} kg): most of the compliance under gravity hides in "
            f"the geometry; measure some poses with another payload to tell them apart.{unread}",
        )  # fmt: skip
    directions = {n: v for n, v in data.columns.items() if is_direction(n)}
    if not directions or not any(v.any() for v in directions.values()):
        yield Finding(
            "note", "no_direction",
            "No directions of approach (dir1, dir2, …): backlash is judged by the side of the load only, and friction "
            "cannot be.",
        )  # fmt: skip
    else:
        one = [n for n, v in directions.items() if len(set(v[v != 0])) == 1]
        if one:
            yield Finding(
                "warning", "one_direction",
                f"{', '.join(one)}: always approached from one side, so that backlash hides in the motor offset.",
            )  # fmt: skip
    temperatures = [c for c in TEMPERATURES if c in data.columns]
    if not temperatures:
        yield Finding("note", "no_temperature", "No temperatures: thermal growth cannot be told from anything else.")
    elif all(np.ptp(data.columns[c]) < 1.0 for c in temperatures):
        yield Finding("note", "constant_temperature", "Temperatures vary by less than 1 °C: growth stays unseen.")
    if len(temperatures) > 1 and "temp" not in data.columns:
        for i, a in enumerate(temperatures):
            for b in temperatures[:i]:
                if _correlation(data.columns[a], data.columns[b]) > 0.98:
                    yield Finding("note", "equal_temperatures", f"{b} and {a} rise together: hard to tell apart.")
    time = data.columns.get("time")
    if time is None:
        yield Finding("note", "no_time", "No time: drift of base or tracker cannot be seen.")
        return
    for c in temperatures if "temp" not in data.columns else temperatures[:1]:
        if _correlation(data.columns[c], time) > 0.95:
            name = "The temperature" if "temp" in data.columns else c
            yield Finding(
                "warning", "temperature_follows_time",
                f"{name} is nearly proportional to time: thermal growth and drift cannot be told apart; repeat "
                "some poses after cooling, or in another order.",
            )  # fmt: skip


def noise_level(data: Measurements, noise: ReplicateScatter) -> Iterator[Finding]:
    """What is known of the noise."""
    keys = ("positions (# sigma_pos_mm)", "rotations (# sigma_rot_deg)")
    lacking = [k for k, said, seen in zip(keys, data.stated, data.kinds, strict=True) if seen and not said]
    if lacking:
        yield Finding(
            "warning", "sigma_not_stated",
            f"The file does not state the instrument's σ of {' and '.join(lacking)}: a usual value is assumed, and χ² "
            "cannot test the fit.",
        )  # fmt: skip
    if noise.dof_pos + noise.dof_rot == 0:
        why = "No replicates (pose_id)"
        if (data.pose_id >= 0).any():
            why = "No rows of one pose_id agree in command, payload, direction and temperature"
        elif repeated := int((groups(replace(data, pose_id=np.zeros(len(data), int))) >= 0).sum()):
            why = f"{repeated} rows repeat a command, but no pose_id says that they are replicates"
        yield Finding(
            "warning", "no_replicates",
            f"{why}: the noise is not verified, and a diagnosis can rank causes but gives no verdict; measure ten or "
            "more poses twice.",
        )  # fmt: skip
        return
    if not verified(noise):
        yield Finding(
            "warning", "few_replicates",
            f"Too few repeated poses to verify the noise ({noise.groups}); ten or more are needed.",
        )  # fmt: skip
    for what, ratio, dof, seen, said in (
        ("position", noise.ratio_pos, noise.dof_pos, wording.size(noise.sigma_pos), data.stated[0]),
        ("rotation", noise.ratio_rot, noise.dof_rot, wording.angle(noise.sigma_rot), data.stated[1]),
    ):
        p = _two_sided(ratio, dof)
        if p < DOUBTFUL:
            stated = "stated" if said else "assumed"
            yield Finding(
                "warning", f"noise_{what}",
                f"Replicates scatter by {seen} in {what}, {ratio:.2f} times the {stated} σ (p = {p:.1g}): "
                + ("the instrument or the robot repeats worse than stated." if ratio > 1 else "σ is overstated, or the "
                   "rows are copies and not measured anew."),
            )  # fmt: skip


def values(data: Measurements, robot: Robot | None) -> Iterator[Finding]:
    """Values that look odd but may be right."""
    seen = np.array(~np.isnan(data.position).any(axis=1))
    same = np.all(data.position[1:] == data.position[:-1], axis=1)
    moved = np.any(data.q[1:] != data.q[:-1], axis=1)
    still = np.append(False, seen[1:] & same & moved)
    if still.any():
        yield Finding(
            "warning", "frozen",
            f"The position is that of the row before although the command changed ({_lines(data, still)}): was the "
            "instrument frozen?",
        )  # fmt: skip
    copied = copies(data)
    if copied.any():
        yield Finding(
            "warning", "copies",
            f"Command and reading are those of an earlier row to the last digit ({_lines(data, copied)}): copies are "
            "no measurements, and make the noise look smaller than it is; remove them.",
        )  # fmt: skip
    for what, axes, low, high, unit in (
        ("position", slice(0, 3), 1e-7, 1e-3, "m"), ("rotation", slice(3, 6), 1e-7, 2e-2, "rad"),
    ):  # fmt: skip
        sigma = data.sigma[:, axes][data.mask[:, axes]]
        if len(sigma) and not (low <= np.median(sigma) <= high):
            yield Finding("warning", "odd_sigma", f"σ of {what} is {np.median(sigma):.1e} {unit}: is its unit right?")
    for c in TEMPERATURES:
        if c in data.columns and not (-40 <= data.columns[c].min() and data.columns[c].max() <= 100):
            yield Finding("warning", "odd_temperature", f"{c} reaches {span(data.columns[c])}: is it in °C?")
            break
    if robot is None:
        return
    if data.robot_name and data.robot_name != robot.name:
        yield Finding(
            "warning", "other_robot", f"The file names robot '{data.robot_name}', the robot file is of '{robot.name}'."
        )
    plate = robot.mass.get("plate", 0.0)
    if plate > 0 and data.payload.max() > 50 * plate:
        heavy = f"A payload of {data.payload.max():g} kg on a plate of {plate:g} kg: is it in g?"
        yield Finding("warning", "odd_payload", heavy, "If it is, name the column payload_g.")
    turned = data.turned
    if data.frame == "base" and turned.any() and not {3, 4} & set(robot.mechanism.task):
        tilt = np.arccos(np.clip(data.rotation[turned, 2, 2], -1, 1)).max()
        if tilt > robot.mechanism.max_tilt:
            tilted = f"The plate tilts by up to {np.rad2deg(tilt):.0f}°: is the rotation's unit right?"
            yield Finding("warning", "odd_rotation", tilted)


def rotations(data: Measurements) -> Iterator[Finding]:
    """How rx, ry and rz are read, and whether Euler angles would be something else."""
    turned = data.turned
    if data.written is None or data.written.shape[1] != 3 or data.euler or not turned.any():
        return
    vector, R = data.written[turned], data.rotation[turned]
    if not vector.any():
        yield Finding(
            "warning", "rotations_zero",
            "rx, ry and rz are 0 in every row: these cannot be readings, as every plate tilts a little.",
            "Leave these columns out, or blank, where rotation is not measured.",
        )  # fmt: skip
        return
    apart = [rotation.log(orientation.from_euler(order, vector) @ rotation.transposed(R)) for order in ("xyz", "zyx")]
    other = float(np.linalg.norm(apart, axis=-1).max())
    sigma = float(np.median(data.sigma[turned, 3]))
    so = f"by up to {wording.angle(other)}: if they are, write '# euler = ZYX' (or the order they have)"
    if other < sigma:
        so = f"by {wording.angle(other)} at most, less than σ: either reading gives the same fit"
    yield Finding(
        "note", "rotation_vector",
        f"rx, ry and rz are read as a rotation vector (axis × angle). Read as Euler angles, the "
        f"rotations would differ {so}.",
    )  # fmt: skip


_DAY = 86400.0
_LONGEST = 1e11
"""[s] three thousand years: more is a clock that counts in another unit, as milliseconds since 1970 are."""
_EVER = 10 * 365 * _DAY
"""[s] time between first and last row that no set of measurements takes."""


def clock(data: Measurements) -> Iterator[Finding]:
    """Clocks that jump, and times in another unit."""
    time = data.columns.get("time")
    if time is None or len(time) < 2:
        return
    if np.abs(time).max() > _LONGEST or np.ptp(time) > _EVER:
        yield Finding(
            "warning", "odd_time",
            f"time spans {np.ptp(time):.3g} s and reaches {np.abs(time).max():.3g} s: is it in milliseconds? Drift and "
            "thermal effects count in seconds.", "Divide it by 1000, or name its unit (time_s, time_min, time_h).",
        )  # fmt: skip
        return
    back = np.append(False, np.diff(time) < 0)
    if back.any():
        worst = float(-np.diff(time).min())
        midnight = " (a clock that starts anew at midnight?)" if 0.5 * _DAY < worst < 1.5 * _DAY else ""
        yield Finding(
            "warning", "clock_jumps",
            f"time goes back by up to {worst:.4g} s at {_lines(data, back)}{midnight}: effects of time take the rows "
            "in the order of the clock.", "Write seconds that run on, or rows in the order of measuring.",
        )  # fmt: skip


def copies(data: Measurements) -> np.ndarray:
    """(N,) bool, rows whose command, tool and complete position, and rotation if there is one, an earlier row has."""
    whole = np.flatnonzero(~np.isnan(data.position).any(axis=1))
    turn = np.nan_to_num(data.rotation[whole].reshape(-1, 9))
    content = np.hstack([data.q[whole], data.tool[whole], data.payload[whole, None], data.position[whole], turn])
    _, first = np.unique(content, axis=0, return_index=True)
    out = np.zeros(len(data), bool)
    out[np.delete(whole, first)] = True
    return out


def against_nominal(data: Measurements, nominal: Nominal, judged: Judgement) -> Iterator[Finding]:
    """Mix-ups that the robot as drawn shows."""
    if len(nominal.unreachable):
        where = _lines(data, nominal.unreachable)
        yield Finding("warning", "unreachable", f"The nominal robot cannot take the command of {where}.")
    said, advice = f"{mixups.sentence(judged, nominal)}.", f"{wording.capital(mixups.remedy(judged))}."
    if judged.readings:
        yield Finding("error", "swapped_columns", said, advice, judged.codes)
    elif judged.numbers:
        yield Finding("warning", "far_number", said, advice, judged.codes)
    elif judged.frame:
        yield Finding(
            "warning", "not_aligned",
            f"Positions are {nominal.rms * 1e3:.3g} mm rms from the nominal robot, {nominal.aligned_rms * 1e3:.3g} mm "
            "when the measuring frame is moved: if it is not aligned with the base, write '# frame = tracker'.",
        )  # fmt: skip
    elif judged.tried and judged.far:
        yield Finding("warning", "far_from_drawing", said, advice)
    elif apart := as_drawn.rows_apart(nominal, data):
        yield Finding("warning", "far_rows", apart)


def verified(noise: ReplicateScatter) -> bool:
    """Whether replicates say enough about the noise for verdicts to rest on it."""
    return noise.dof_pos + noise.dof_rot >= ENOUGH_DOF


def _two_sided(ratio: float, dof: int) -> float:
    """p of a scatter this far from its σ, either way (χ²)."""
    from scipy.special import chdtr, chdtrc

    if dof == 0:
        return 1.0
    chi2 = dof * ratio**2
    return float(min(1.0, 2 * min(chdtr(dof, chi2), chdtrc(dof, chi2))))


def is_direction(name: str) -> bool:
    """dir1, dir2, …"""
    return name.startswith("dir") and name[3:].isdigit()


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    if len(a) < 5 or np.ptp(a) < 1.0 or np.ptp(b) == 0:
        return 0.0
    return abs(float(np.corrcoef(a, b)[0, 1]))


def span(values: np.ndarray) -> dict[str, float]:
    """Smallest and largest value."""
    return {"min": float(values.min()), "max": float(values.max())}


def _lines(data: Measurements, rows: np.ndarray) -> str:
    """'lines 3, 7 and 9' of a mask or of indices."""
    return wording.lines(data.lines[rows])
