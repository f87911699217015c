"""Single numbers that are far from the drawing: the zero or scale of a drive, a dimension of the robot file.

Each is searched for beside all geometry (:func:`pcalib.fitting.drawing.search`). Those that bring the data home are
named, with the edit that mends them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pcalib import kinds, wording
from pcalib.data.measurement import Measurements
from pcalib.fitting import drawing
from pcalib.fitting.drawing import ALIKE, FAR, DrawingDistance
from pcalib.robot import Robot


@dataclass(frozen=True)
class _Number:
    code: str
    words: Callable[[np.ndarray], str]
    edit: Callable[[np.ndarray], str]
    units: tuple[str, ...]
    change: drawing.Change


def numbers(data: Measurements, robot: Robot, here: DrawingDistance | None) -> Iterator[tuple[str, str, str, float]]:
    """Single numbers that are far from the drawing and whose correction makes the data agree, best first."""
    found = []
    for number in _candidates(data, robot):
        alpha = drawing.search(data, robot, number.units, number.change)
        if alpha is None:
            continue
        tolerances = np.abs(alpha) / [drawing.PRIOR[unit] for unit in number.units]
        there = drawing.distance(*number.change(data, robot, alpha))
        if there is None or not there.near or tolerances.max() < FAR:
            continue
        if here is None or here.cost - there.cost > ALIKE:
            found.append((there.cost + ALIKE * len(alpha), number, alpha, float(tolerances.max())))
    best = min((cost for cost, *_ in found), default=0.0)
    for cost, number, alpha, size in sorted(found, key=lambda f: f[0]):
        if cost < best + ALIKE:
            yield number.code, number.words(alpha), number.edit(alpha), size


def _candidates(data: Measurements, robot: Robot) -> Iterator[_Number]:
    mechanism, n = robot.mechanism, len(data.actuators)
    unit = "rad" if mechanism.actuator_dimension == "angle" else "m"
    for i, name in enumerate(data.actuators):
        one = np.arange(n) == i
        yield _Number(
            "drive_zero", lambda a, name=name: f"the zero of motor {name} is off by {_signed(a[0], unit)}",
            lambda a, name=name: f"home it anew, or add {_signed(a[0], unit)} to {name}", (unit,),
            lambda d, r, a, one=one: (replace(d, q=d.q + a[0] * one), r),
        )  # fmt: skip
        yield _Number(
            "drive_scale", lambda a, name=name: f"motor {name} moves {1 + a[0]:.5g} times as far as commanded",
            lambda a, name=name: f"multiply {name} by {1 + a[0]:.5g}, or check its steps per turn", ("1",),
            lambda d, r, a, one=one: (replace(d, q=d.q * (1 + a[0] * one)), r),
        )  # fmt: skip
    yield _Number(
        "drive_zero", lambda a: f"the zeros of all motors are off by {_signed(a[0], unit)}",
        lambda a: f"add {_signed(a[0], unit)} to every command", (unit,),
        lambda d, r, a: (replace(d, q=d.q + a[0]), r),
    )  # fmt: skip
    yield _Number(
        "drive_scale", lambda a: f"all motors move {1 + a[0]:.5g} times as far as commanded",
        lambda a: f"multiply every command by {1 + a[0]:.5g}, or check the unit", ("1",),
        lambda d, r, a: (replace(d, q=d.q * (1 + a[0])), r),
    )  # fmt: skip
    lengths = [s.name for s in kinds.get(robot.kind).dimensions if s.dimension == "length" and not s.count]
    lengths = [key for key in lengths if key in robot.dimensions]
    for key in lengths:

        def words(a: np.ndarray, key: str = key) -> str:
            longer = "larger" if a[0] > 0 else "smaller"
            said = f"{key.replace('_', ' ')} is {wording.size(abs(a[0]))} {longer} than in the robot file"
            now, drawn = robot.dimensions[key] + a[0], robot.dimensions[key]
            return f"{said} ({wording.size(now)} instead of {wording.size(drawn)})"

        def edit(a: np.ndarray, key: str = key) -> str:
            needed = 1e3 * (robot.dimensions[key] + a[0])
            return f"is this the robot file of this robot? it would need {key}_mm = {needed:.5g}"

        def change(d: Measurements, r: Robot, a: np.ndarray, key: str = key) -> tuple[Measurements, Robot]:
            return d, replace(r, dimensions={**r.dimensions, key: r.dimensions[key] + a[0]})

        yield _Number("dimension", words, edit, ("m",), change)
    yield _Number(
        "position_zero", lambda a: f"z is counted from another height ({_signed(a[0], 'm')})",
        lambda a: f"add {_signed(a[0], 'm')} to z, or write '# frame = tracker'", ("m",),
        lambda d, r, a: (replace(d, position=d.position + a[0] * np.array([0.0, 0.0, 1.0])), r),
    )  # fmt: skip
    if len(lengths) > 1:

        def every(d: Measurements, r: Robot, a: np.ndarray) -> tuple[Measurements, Robot]:
            return d, replace(
                r, dimensions={**r.dimensions, **{k: r.dimensions[k] + v for k, v in zip(lengths, a, strict=True)}}
            )

        def values(a: np.ndarray) -> str:
            return ", ".join(f"{k}_mm = {1e3 * (robot.dimensions[k] + v):.5g}" for k, v in zip(lengths, a, strict=True))

        yield _Number(
            "other_robot", lambda a: f"the robot has other dimensions than the robot file: {values(a)}",
            lambda a: "is this the robot file of this robot?", ("m",) * len(lengths), every,
        )  # fmt: skip


def _signed(value: float, unit: str) -> str:
    said = f"{np.degrees(value):+.2f}°" if unit == "rad" else f"{1e3 * value:+.2f} mm"
    return said.replace("-", "−")


