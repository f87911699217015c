"""What was mixed up in a measurement or a robot file, found by trying every other reading of it.

A quick fit (:mod:`pcalib.fitting.drawing`) says how far the data are from the robot as drawn. Where that is far, each
entry of the table of misreadings and each single number (the zero or scale of a drive, a dimension of the robot file)
is tried by the same fit; what brings the data home is named, with the edit that mends it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pcalib import rotation
from pcalib.data import misreadings
from pcalib.data.measurement import Measurements
from pcalib.errors import PcalibError
from pcalib.fitting import drawing, far_numbers
from pcalib.fitting.as_drawn import LARGE_TURN, Nominal, compare
from pcalib.fitting.drawing import ALIKE, DrawingDistance
from pcalib.fitting.wild import wild
from pcalib.robot import Robot

GAIN = 0.25
"""A reading that explains the data must bring the quick fit's cost below this share; what noise costs apart, where the
data are far from the drawing as they stand."""
OFF = 5.0
"""Times σ that a quick fit leaves over, from which on other readings are tried: physics that a model lacks leaves
less on most machines, and a reading must bring the data home to be named in any case."""
SMALL = 0.3
"""RMS residual, in σ, below which the unit of the readings is doubted: nobody states a σ three times too large, but
readings in the wrong unit have residuals that are far too small."""
TURNED = np.radians(5.0)
"""[rad] Median rotation above which other conventions of the three numbers are tried even where the data look near."""
AT_NOISE = 1.5
"""RMS residual of the quick fit, in σ, above which rotations beyond TURNED are tried in other conventions."""
BETTER = 0.7
"""Share to which another convention of the rotation must lower the cost to be named. Missing physics adds to the cost
of every convention."""
ABSURD = 100.0
"""Manufacturing tolerances (10 mm, 5°, 10 %) from which on a number is that of another robot, or of a mistake."""
_ROUGH = 0.06
"""Share of the robot's size, and 5 times LARGE_TURN, beyond which the nominal robot is not near under a reading."""


@dataclass(frozen=True)
class Judgement:
    """Whether data and robot belong together as they are written."""

    distance: DrawingDistance | None
    """How far the data, as they are read, are from the drawing; None where no quick fit is possible."""
    readings: tuple[tuple[str, str, str], ...] = ()
    """(code, words, edit) of every other reading that brings the data near the drawing, best first."""
    numbers: tuple[tuple[str, str, str, float], ...] = ()
    """(code, words, edit, tolerances) of single numbers that are far from the drawing."""
    frame: bool = False
    """Whether the data come home once the measuring frame is unknown: '# frame = tracker'."""
    tried: bool = False
    """Whether other readings were tried."""

    @property
    def far(self) -> bool:
        """Whether the data are far from the drawing as they are read."""
        return self.tried and (self.distance is None or not self.distance.near)

    @property
    def named(self) -> bool:
        """Whether a reading of the columns or a number explains why the data are far."""
        return bool(self.readings or self.numbers or self.frame)

    @property
    def absurd(self) -> bool:
        """Whether a fit needs --far: the data are misread, or far from the drawing beyond what a fit explains."""
        named = min((size for *_, size in self.numbers), default=None)
        if named is not None:
            return named > ABSURD
        here = self.distance
        return bool(self.readings) or (self.far and (here is None or not here.fits or here.tolerances > ABSURD))

    def to_json(self) -> dict[str, Any]:
        """For the JSON of commands."""
        every = (*self.readings, *self.numbers)
        named = [{"code": code, "words": words, "edit": edit} for code, words, edit, *_ in every]
        return {"far": self.far, "tolerances": self.distance and self.distance.tolerances, "named": named}

    @property
    def codes(self) -> frozenset[str]:
        """Codes of all that is named."""
        return frozenset([code for code, *_ in self.readings] + [code for code, *_ in self.numbers])


FEWEST = 4
"""Different poses below which nothing is judged: a few poses fit any robot that is bent to them."""
SHOWN = 3
"""Readings that are named where several explain the data alike."""


def _shown(readings: tuple[tuple[str, str, str], ...]) -> tuple[tuple[str, str, str], ...]:
    """The readings to name: the best of each kind of mistake first, so that none is left out for its rank alone."""
    first = {code: entry for entry in reversed(readings) for code in entry[:1]}
    each = [entry for entry in readings if first[entry[0]] is entry]
    return tuple([*each, *(entry for entry in readings if entry not in each)][:SHOWN])


def sentence(found: Judgement, nominal: Nominal) -> str:
    """What a judgement says of the data, for a message; '' where there is nothing to say."""
    away = nominal.distance if nominal.far else ""
    if found.readings:
        said = ", or where ".join(words for _, words, _ in _shown(found.readings))
        if len(found.readings) > SHOWN:
            said += f" ({len(found.readings) - SHOWN} more readings explain them alike)"
        if len({code for code, *_ in found.readings}) > 1:
            said += "; the data cannot tell which, so look at the machine and the instrument first"
        if away:
            return f"The data are {away} from the robot as drawn, and fit it where {said}"
        return f"The data fit the robot as drawn where {said}, and not as they stand"
    beside = f" ({away} as they stand)" if away else ""
    if found.numbers:
        return f"Far from the drawing{beside}: " + ", or ".join(words for _, words, *_ in found.numbers[:SHOWN])
    if found.frame:
        return f"The data fit the robot as drawn once the measuring frame is unknown{beside}"
    if found.far:
        return f"Far from the drawing{beside}, and no reading of the columns explains it"
    return ""


def remedy(found: Judgement) -> str:
    """The edit that mends it."""
    edits = [edit for _, _, edit, *_ in (_shown(found.readings) or found.numbers[:SHOWN])]
    if edits:
        return ", or ".join(dict.fromkeys(edits))
    if found.frame:
        return "write '# frame = tracker' above the header"
    return "check that robot file and measurements are of the same robot, and each command's row is its measurement's"


def judge(data: Measurements, robot: Robot, *, always: bool = False) -> Judgement:
    """Whether the data belong to the robot as they are read, and if not, which correction makes them agree.

    Args:
        always: try every other reading, even where nothing is suspicious.
    """
    with np.errstate(invalid="ignore", divide="ignore"):  # drawings that no robot can have are tried too
        return _judge(_without_far_rows(drawing.some_rows(_without_wild(data, robot)), robot), robot, always)


def _judge(some: Measurements, robot: Robot, always: bool) -> Judgement:
    if len(np.unique(np.round(some.q, 9), axis=0)) < FEWEST:
        return Judgement(None)
    here = drawing.distance(some, robot)
    if _suspicious(here):
        here = drawing.distance(some, robot, drawing.PATIENT)
    if not (always or _suspicious(here)):
        turned = tuple((m.code, m.words, m.edit) for m in _turned_otherwise(some, robot, here))
        return Judgement(here, turned, tried=bool(turned))
    readings = tuple((m.code, m.words, m.edit) for m in _readings(some, robot, here))
    if readings:
        return Judgement(here, readings, tried=True)
    if here is not None and here.near:
        return Judgement(here, tried=True)
    numbers = tuple(far_numbers.numbers(some, robot, here))
    frame = (
        not numbers and some.frame == "base" and _home(drawing.distance(replace(some, frame="tracker"), robot), here)
    )
    return Judgement(here, (), numbers, frame, tried=True)


def _suspicious(here: DrawingDistance | None) -> bool:
    if here is None or not here.near or here.misfit > OFF**2 * here.readings:
        return True
    enough = here.readings > 1.5 * here.parameters
    return enough and bool(here.ratio_pos < SMALL or here.ratio_rot < SMALL)


def _readings(data: Measurements, robot: Robot, here: DrawingDistance | None) -> list[misreadings.Misreading]:
    """Entries of the table with which the data agree with the robot, best first."""
    found: list[tuple[float, misreadings.Misreading]] = []
    for entry in misreadings.table(data, robot):
        try:
            read, drawn = entry.mend(data, robot)
            near = _roughly(read, drawn)
        except PcalibError:  # dimensions that no robot can have
            continue
        there = drawing.distance(read, drawn) if near else None
        if there is None or not there.near:
            continue
        group, factor = entry.stretch
        columns = {"": slice(0, 0), "position": slice(0, 3), "rotation": slice(3, 6)}[group]
        # A density has the unit of what it is of. A group that is 0 throughout looks the same in all units.
        shrunk = 2 * _counted(data, columns) * np.log(factor)
        if _home(there, here, shrunk):
            found.append((there.cost - shrunk, entry))
    best = min((cost for cost, _ in found), default=0.0)
    return [entry for cost, entry in found if cost < best + max(ALIKE, 0.5 * abs(best))]


def _turned_otherwise(data: Measurements, robot: Robot, here: DrawingDistance | None) -> list[misreadings.Misreading]:
    """Other readings of large rotations that explain the data better, although these look near as they are; best first.

    In a tracker's frame the body's own turn is found with the rest, which hides most of a wrong order of angles.
    """
    turned = data.turned
    if here is None or not turned.any() or not here.misfit > AT_NOISE**2 * here.readings:
        return []
    if not np.median(np.linalg.norm(rotation.log(data.rotation[turned]), axis=1)) > TURNED:
        return []
    found: list[tuple[float, misreadings.Misreading]] = []
    for entry in misreadings.rotations(data):
        if entry.stretch[1] != 1.0:
            continue  # in another unit such rotations would be far off
        read = entry.mend(data, robot)[0]
        there = drawing.distance(read, robot) if _roughly(read, robot) else None
        if there is not None and there.near and there.cost < BETTER * here.cost and here.cost - there.cost > 4 * ALIKE:
            found.append((there.cost, entry))
    best = min((cost for cost, _ in found), default=0.0)
    return [entry for cost, entry in sorted(found, key=lambda f: f[0]) if cost < best + max(ALIKE, 0.1 * best)]


def _counted(data: Measurements, columns: slice) -> int:
    """Readings of a group of columns of (N, 6); none where all of them are 0."""
    turned = np.zeros((len(data), 3))
    measured = data.turned
    turned[measured] = rotation.log(data.rotation[measured])
    values = np.where(data.mask, np.hstack([np.nan_to_num(data.position), turned]), 0.0)[:, columns]
    return int(data.mask[:, columns].sum()) if values.any() else 0


def _home(there: DrawingDistance | None, here: DrawingDistance | None, shrunk: float = 0.0) -> bool:
    """Whether the data `there`, read another way, agree with the robot clearly better than the data `here`."""
    if there is None or not there.near:
        return False
    if here is None:
        return True
    if shrunk > 0 and not there.misfit > OFF**2 * there.readings and here.cost - there.cost + shrunk > ALIKE:
        small = here.ratio_pos < SMALL or here.ratio_rot < SMALL
        if small:
            return True
    # What noise alone costs does not shrink with the better reading. Where parts are as drawn, little else may be left.
    share = there.cost / here.cost if here.near else _beyond_noise(there) / max(_beyond_noise(here), 1.0)
    return share < GAIN and here.cost - there.cost + min(shrunk, 0.0) > 4 * ALIKE


def _beyond_noise(found: DrawingDistance) -> float:
    """The cost above one unit for each reading, which is what noise leaves."""
    return max(found.cost - found.readings, 0.0)


def _roughly(data: Measurements, robot: Robot) -> bool:
    """Whether the nominal robot is anywhere near: spares most quick fits."""
    model = drawing.start(data, robot)
    if model is None:
        return False
    error = model[2][0]
    place, turn = (np.linalg.norm(e[~np.isnan(e).any(axis=1)], axis=1) for e in (error[:, :3], error[:, 3:]))
    size = _size(robot)
    far = (len(place) > 0 and np.median(place) > _ROUGH * size) or (len(turn) > 0 and np.median(turn) > 5 * LARGE_TURN)
    return not far


def _size(robot: Robot) -> float:
    """[m] the largest length of the drawing."""
    mechanism = robot.mechanism
    return float(np.abs(mechanism.nominal[np.array(mechanism.units) == "m"]).max())


def _without_wild(data: Measurements, robot: Robot) -> Measurements:
    """The data without readings of sensors that are far off where most are near: they are named by themselves."""
    far = [each.rows for each in wild(data, robot)]
    return data.take(np.setdiff1d(np.arange(len(data)), np.concatenate(far))) if far else data


def _without_far_rows(data: Measurements, robot: Robot) -> Measurements:
    """The data without a few rows that are far off where most are near: they are named by themselves."""
    far = compare(data, robot).odd
    return data.take(np.setdiff1d(np.arange(len(data)), far)) if 0 < len(far) < 0.2 * len(data) else data
