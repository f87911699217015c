# ruff: noqa: E501  (a table: one entry a line)
"""Ways to misread a measurement or a robot file, one line each: what was written, and how it should be read instead.

An entry has two directions. `mend` reads the columns the other way and gives measurements and robot as they should
have been; `spoil` is its inverse, and makes of right ones what a user with that mistake would have written. The
search (:mod:`pcalib.fitting.mixups`) uses the first, the tests the second. A new mistake is a new line of :func:`table`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np

from pcalib import kinds, rotation
from pcalib.data import orientation
from pcalib.data.measurement import Measurements
from pcalib.robot import Robot

DataAndRobot = tuple[Measurements, Robot]
Rewrite = Callable[[Measurements, Robot], DataAndRobot]
"""Makes of data and robot what they are when some of their numbers are read another way."""
FIXED = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
"""Orders of turns about the axes that stand still; about the moving axes they are the same in reverse."""
PROPER = ("ZYZ", "ZXZ", "XYX", "XZX", "YXY", "YZY")
"""Orders of Euler angles that turn about one axis twice; capitals: about the moving axes."""


@dataclass(frozen=True)
class Misreading:
    """One way to misread a file."""

    code: str
    """Stable name of its kind."""
    words: str
    """What stands in the file, as the end of 'the data fit where …'."""
    edit: str
    """What to change so that the file is read right."""
    mend: Rewrite
    spoil: Rewrite
    stretch: tuple[str, float] = ("", 1.0)
    """Group of readings ('position', 'rotation') that the mended values multiply, and by what: a reading must not
    win because it makes its own residuals small."""


def table(data: Measurements, robot: Robot) -> list[Misreading]:
    """All entries that such data of such a robot allow, the simplest first."""
    q, angle = list(data.actuators), data.actuator_dimension == "angle"
    all_q = ", ".join(q) if len(q) < 5 else f"{q[0]} … {q[-1]}"
    low, high = robot.joint_range
    turn = np.pi / 2
    out: list[Misreading] = []
    if angle:
        out += [
            commands("command_unit", f"{all_q} are in radians, not degrees", f"name them {q[0]}_rad …", np.degrees, np.radians),
            commands("command_unit", f"{all_q} are in degrees, not radians", f"name them {q[0]}_deg …", np.radians, np.degrees),
            commands("command_unit", f"{all_q} are in turns, not degrees", f"name them {q[0]}_rev …", *_times(360.0)),
            commands("command_zero", f"{all_q} count from the vertical downwards", "write q − 90°", *_plus(-turn)),
            commands("command_zero", f"{all_q} count from the vertical upwards", "write q + 90°", *_plus(turn)),
            commands("command_zero", f"{all_q} count from the vertical, the other way round", "write 90° − q", *_minus_from(turn)),
            commands("command_zero", f"{all_q} count from the vertical downwards, the other way round", "write −90° − q", *_minus_from(-turn)),
            commands("command_zero", f"{all_q} count from the opposite direction", "write q − 180°", *_plus(-2 * turn)),
        ]  # fmt: skip
    else:
        out += [
            commands("command_unit", f"{all_q} are in {unit}, not mm", f"name them {q[0]}_{unit} …", *_times(f))
            for unit, f in (("cm", 10.0), ("m", 1e3), ("um", 1e-3))
        ]
        out += [
            commands("command_unit", f"{all_q} are in inches", "multiply them by 25.4", *_times(25.4)),
            commands("command_zero", f"{all_q} count downwards from the end of the range", f"write {1e3 * high:.6g} mm − q", *_minus_from(high)),
            commands("command_zero", f"{all_q} count upwards from the start of the range", f"write q + {1e3 * low:.6g} mm", *_plus(low)),
            commands("command_zero", f"{all_q} count from the end of the range, negative", f"write q + {1e3 * high:.6g} mm", *_plus(high)),
        ]  # fmt: skip
    out.append(commands("command_sign", f"{all_q} have the wrong sign", "change their sign", np.negative, np.negative))
    for i, name in enumerate(q):
        sign = np.where(np.arange(len(q)) == i, -1.0, 1.0)
        out.append(commands("motor_reversed", f"{name} has the wrong sign (this drive runs the other way)", f"change the sign of {name}", *_times(sign)))  # fmt: skip
    for order in _orders(len(q)):
        said = [f"{q[j]} is what stands in {q[i]}" for j, i in enumerate(order) if i != j]
        names = ", ".join(q[i] for i in np.argsort(order))
        words = ", ".join(said) if len(said) < 4 else f"the columns {all_q} are those of drives {names}"
        out.append(commands("command_order", words, f"name the columns in the order {names}", *_columns(order)))
    out += _positions(data)
    if data.turned.any():
        out += rotations(data)
    if data.tool.any():
        out += _tools(data)
    return [*out, *_robots(robot)]


def _positions(data: Measurements) -> Iterator[Misreading]:
    for unit, factor in (("cm", 10.0), ("m", 1e3), ("um", 1e-3)):
        yield positions("position_unit", f"x, y and z are in {unit}, not mm", f"name the columns x_{unit}, y_{unit}, z_{unit}", factor * np.eye(3))  # fmt: skip
    yield positions("position_unit", "x, y and z are in inches", "multiply them by 25.4", 25.4 * np.eye(3))
    for M in _signed():
        mirrored = np.linalg.det(M) < 0
        if data.frame == "tracker" and not (mirrored and np.array_equal(M, np.diag([1, 1, -1]))):
            continue  # a proper turn of the measuring frame is part of its registration
        words = "the tracker's frame is left-handed" if data.frame == "tracker" else _axes(M, ("x", "y", "z"))
        edit = "change the sign of z, or correct the columns" if data.frame == "tracker" else "correct x, y and z"
        yield positions("position_axes", words, edit, M)
    yield Misreading(
        "position_not_tcp", "x, y and z are those of the plate's centre, not of the tool point",
        "leave the columns tool_x, tool_y, tool_z out", _no_tool, _at_centre,
    )  # fmt: skip


def rotations(data: Measurements) -> Iterator[Misreading]:
    """Entries that read rotations another way."""
    name = ("rx", "ry", "rz")
    if data.written is None or data.written.shape[1] == 3:
        for factor, words, unit in (
            (np.degrees(1), "the rotation is in radians, not degrees", "rad"),
            (np.radians(1), "the rotation is in degrees, not radians", "deg"),
        ):
            edit = f"name the columns rx_{unit}, ry_{unit}, rz_{unit}"
            yield vectors("rotation_unit", words, edit, *_times(factor), stretch=factor)
        for sequence in (*FIXED, *PROPER):
            if sequence != data.euler:
                yield euler(sequence)
        for sequence in FIXED:
            if sequence != "xyz":
                yield euler(sequence, reorder=True)
        if data.euler:
            words, edit = "rx, ry, rz are a rotation vector, and no Euler angles", "leave the line '# euler = …' out"
            same = _written(np.asarray, vector=True)
            yield Misreading("euler_angles", words, edit, same, same, ("rotation", 1.0))
    yield turns("rotation_inverse", "the rotation is that of the base seen from the plate", "change the sign of rx, ry and rz (of qx, qy and qz)", rotation.transposed, rotation.transposed)  # fmt: skip
    if data.written is None or data.written.shape[1] == 4:
        names = np.array(["qw", "qx", "qy", "qz"])
        for order, said in (((3, 0, 1, 2), "x, y, z, w"), ((1, 2, 3, 0), "z … w shifted by one"), ((3, 2, 1, 0), "z, y, x, w")):
            edit = f"name the columns {', '.join(names[np.argsort(order)])}"
            yield quaternions("quaternion_order", f"the quaternion's columns are in the order {said}", edit, order)
    for M in _signed():
        if data.written is None or data.written.shape[1] == 3:
            yield vectors("rotation_axes", _axes(M, name), "correct rx, ry and rz", *_matrix(M))
        elif np.linalg.det(M) > 0 or np.array_equal(np.abs(M), np.eye(3)):
            yield vectors("rotation_axes", _axes(M, ("qx", "qy", "qz")), "correct qx, qy and qz", *_matrix(M))


def _tools(data: Measurements) -> Iterator[Misreading]:
    for signs in product((1.0, -1.0), repeat=3):
        flipped = [f"tool_{c}" for c, s in zip("xyz", signs, strict=True) if s < 0]
        if flipped:
            words = f"{' and '.join(flipped)} {'has' if len(flipped) == 1 else 'have'} the wrong sign"
            yield tools("tool_sign", words, f"change the sign of {' and '.join(flipped)}", *_times(np.array(signs)))
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            words = ", ".join(f"tool_{'xyz'[j]} is what stands in tool_{'xyz'[i]}" for j, i in enumerate(order) if i != j)
            yield tools("tool_order", words, "correct the tool's columns", *_columns(order))
    for unit, factor in (("cm", 10.0), ("m", 1e3), ("um", 1e-3)):
        yield tools("tool_unit", f"the tool is in {unit}, not mm", f"name the columns tool_x_{unit} …", *_times(factor))


def _robots(robot: Robot) -> Iterator[Misreading]:
    settings = [s for s in kinds.get(robot.kind).dimensions if s.name in robot.dimensions]
    lengths = [s.name for s in settings if s.dimension == "length" and not s.count]
    azimuths = [s.name for s in settings if s.name.endswith("azimuth")]
    for a, b in combinations(lengths, 2):
        if robot.dimensions[a] != robot.dimensions[b]:
            words = f"the robot file's {_said(a)} and {_said(b)} are exchanged"
            swap = _dimensions(lambda d, a=a, b=b: {a: d[b], b: d[a]})
            yield Misreading("dimensions_exchanged", words, f"exchange {a} and {b} in the robot file", swap, swap)
    for k in lengths:
        if k.endswith("radius"):
            half, double = (_dimensions(lambda d, k=k, f=f: {k: f * d[k]}) for f in (0.5, 2.0))
            yield Misreading("diameter", f"the robot file's {_said(k)} is a diameter", f"halve {k} in the robot file", half, double)
            yield Misreading("diameter", f"the robot file's {_said(k)} is half of what it should be", f"double {k} in the robot file", double, half)
        if robot.dimensions[k] and k == "home_height":
            flip = _dimensions(lambda d, k=k: {k: -d[k]})
            yield Misreading("dimension_sign", f"the robot file's {_said(k)} has the wrong sign", f"change the sign of {k}", flip, flip)
    radii = [k for k in lengths if k.endswith("radius")]
    if len(radii) > 1:
        half, double = (_dimensions(lambda d, f=f: {k: f * d[k] for k in radii}) for f in (0.5, 2.0))
        said = f"{', '.join(map(_said, radii[:-1]))} and {_said(radii[-1])}"
        yield Misreading("diameter", f"the robot file's {said} are diameters", f"halve {' and '.join(radii)} in the robot file", half, double)
        yield Misreading("diameter", f"the robot file's {said} are half of what they should be", f"double {' and '.join(radii)} in the robot file", double, half)
    for a, b in combinations(azimuths, 2):
        swap = _dimensions(lambda d, a=a, b=b: {a: d[b], b: d[a]})
        if len(robot.dimensions[a]) == len(robot.dimensions[b]):
            yield Misreading("dimensions_exchanged", f"the robot file's {_said(a)} and {_said(b)} are exchanged", f"exchange {a} and {b} in the robot file", swap, swap)
    for k in azimuths:
        n = len(robot.dimensions[k])
        for shift in range(1, n):
            forth, back = (_dimensions(lambda d, k=k, s=s: {k: np.roll(d[k], s)}) for s in (shift, -shift))
            yield Misreading("azimuth_order", f"the robot file's {_said(k)} begins at drive {shift + 1}", f"move the last {shift} of {k} to its front", forth, back)
        mirror = _dimensions(lambda d, k=k: {k: -np.asarray(d[k])})
        yield Misreading("azimuth_sign", f"the robot file's {_said(k)} counts clockwise", f"change the signs of {k}", mirror, mirror)
        for degrees in (90.0, -90.0, 180.0):
            a = np.radians(degrees)
            forth, back = (_dimensions(lambda d, k=k, a=s * a: {k: np.asarray(d[k]) + a}) for s in (1, -1))
            yield Misreading("azimuth_zero", f"the robot file's {_said(k)} counts from a direction {degrees:+g}° off", f"add {degrees:g}° to {k}", forth, back)
    every = [s.name for s in settings if s.dimension == "length"]
    for words, f in (("a tenth of what they should be", 10.0), ("ten times what they should be", 0.1), ("in inches", 25.4)):
        forth, back = (_dimensions(lambda d, f=g: {k: f * d[k] for k in every if k in d}) for g in (f, 1 / f))
        yield Misreading("robot_unit", f"the robot file's lengths are {words}", "correct the units of [geometry]", forth, back)


def commands(code: str, words: str, edit: str, mend: Callable, spoil: Callable) -> Misreading:
    """Commands (N, nq) read another way."""
    def change(f: Callable) -> Rewrite:
        return lambda data, robot: (replace(data, q=f(data.q)), robot)

    return Misreading(code, words, edit, change(mend), change(spoil))


def positions(code: str, words: str, edit: str, M: np.ndarray) -> Misreading:
    """The misreading of positions that the signed permutation M of axes corrects; blanks move with their column."""

    def change(M: np.ndarray) -> Rewrite:
        source = np.abs(M).argmax(axis=1)  # each row of M has one entry

        def apply(data: Measurements, robot: Robot) -> DataAndRobot:
            position = data.position[:, source] * M[np.arange(3), source]
            mask = np.concatenate([data.mask[:, source], data.mask[:, 3:]], axis=1)
            return replace(data, position=position, mask=mask), robot

        return apply

    return Misreading(code, words, edit, change(M), change(np.linalg.inv(M)), ("position", float(np.abs(M).max())))


def turns(code: str, words: str, edit: str, mend: Callable, spoil: Callable, stretch: float = 1.0) -> Misreading:
    """Rotations (N, 3, 3) read another way."""

    def change(f: Callable[[np.ndarray], np.ndarray]) -> Rewrite:
        def apply(data: Measurements, robot: Robot) -> DataAndRobot:
            R, given = data.rotation.copy(), data.turned
            R[given] = f(R[given])
            return replace(data, rotation=R, written=None), robot

        return apply

    return Misreading(code, words, edit, change(mend), change(spoil), ("rotation", stretch))


def vectors(code: str, words: str, edit: str, mend: Callable, spoil: Callable, stretch: float = 1.0) -> Misreading:
    """The three numbers of each rotation read as another rotation vector."""
    return Misreading(code, words, edit, _written(mend), _written(spoil), ("rotation", stretch))


def euler(sequence: str, reorder: bool = False) -> Misreading:
    """rx, ry and rz are Euler angles.

    Args:
        sequence: as :func:`pcalib.data.orientation.from_euler` takes it.
        reorder: the three columns hold the angles in the order of the sequence, whatever their names say.
    """
    places = ["xyz".index(c) for c in sequence.lower()]
    back = np.argsort(places) if reorder else [0, 1, 2]

    def mend(v: np.ndarray) -> np.ndarray:
        return rotation.log(orientation.from_euler(sequence, v[:, back]))

    def spoil(v: np.ndarray) -> np.ndarray:
        angles = orientation.to_euler(sequence, rotation.exp(v))
        return angles[:, places] if reorder else angles

    kind = f"about the moving axes {'-'.join(sequence.lower())}"
    if sequence.islower():
        kind = f"{sequence}, that is about the moving axes {'-'.join(sequence[::-1])}, or {'-'.join(sequence)} about axes that stand still"
    words = f"rx, ry, rz are Euler angles ({kind})"
    edit = f"write '# euler = {sequence}' above the header"
    if reorder:
        words += " in the order of the turns"
        edit = f"name the columns {', '.join(f'r{c}' for c in sequence)} and {edit}"
    return Misreading("euler_angles", words, edit, _written(mend, vector=True), _written(spoil, vector=True), ("rotation", 1.0))


def quaternions(code: str, words: str, edit: str, order: Sequence[int]) -> Misreading:
    """The four numbers of each quaternion in another order."""

    def change(order: Sequence[int]) -> Rewrite:
        def apply(data: Measurements, robot: Robot) -> DataAndRobot:
            four = data.written
            given = data.turned
            if four is None or four.shape[1] != 4:
                four = np.full((len(data), 4), np.nan)
                four[given] = rotation.to_quaternion(data.rotation[given])
            four = four[:, list(order)]
            R = data.rotation.copy()
            R[given] = rotation.from_quaternion(four[given])
            return replace(data, rotation=R, written=four), robot

        return apply

    return Misreading(code, words, edit, change(order), change(np.argsort(order).tolist()), ("rotation", 1.0))


def tools(code: str, words: str, edit: str, mend: Callable, spoil: Callable) -> Misreading:
    """Tools (N, 3) read another way."""
    def change(f: Callable) -> Rewrite:
        return lambda data, robot: (replace(data, tool=f(data.tool)), robot)

    return Misreading(code, words, edit, change(mend), change(spoil))


def _written(f: Callable[[np.ndarray], np.ndarray], vector: bool = False) -> Rewrite:
    """The three numbers of each rotation (n, 3) changed by f, and read as they were before.

    Args:
        vector: f makes a rotation vector of them, whatever they are.
    """

    def apply(data: Measurements, robot: Robot) -> DataAndRobot:
        R, given = data.rotation.copy(), data.turned
        three = np.full((len(data), 3), np.nan)
        read = data.written if data.written is not None and data.written.shape[1] == 3 else None
        three[given] = f(rotation.log(R[given]) if read is None else read[given])
        order = data.euler if read is not None and not vector else ""
        R[given] = orientation.from_euler(order, three[given]) if order else rotation.exp(three[given])
        return replace(data, rotation=R, written=three, euler=order), robot

    return apply


def _no_tool(data: Measurements, robot: Robot) -> DataAndRobot:
    return replace(data, tool=np.zeros_like(data.tool)), robot


def _at_centre(data: Measurements, robot: Robot) -> DataAndRobot:
    """Positions of the plate's centre beside a tool that the file states."""
    given = data.tool if data.tool.any() else np.broadcast_to([0.02, 0.0, 0.05], data.tool.shape).copy()
    turned = np.where(np.isnan(data.rotation), np.eye(3), data.rotation)
    centre = data.position - (turned @ data.tool[..., None])[..., 0]
    return replace(data, position=centre, tool=given), robot


def _dimensions(change: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> Rewrite:
    return lambda data, robot: (data, replace(robot, dimensions={**robot.dimensions, **change(robot.dimensions)}))


def _times(factor: float | np.ndarray) -> tuple[Callable, Callable]:
    return (lambda v: v * factor), (lambda v: v / factor)


def _plus(amount: float) -> tuple[Callable, Callable]:
    return (lambda v: v + amount), (lambda v: v - amount)


def _minus_from(amount: float) -> tuple[Callable, Callable]:
    return (lambda v: amount - v), (lambda v: amount - v)


def _columns(order: Sequence[int]) -> tuple[Callable, Callable]:
    back = np.argsort(order)
    return (lambda v: v[:, list(order)]), (lambda v: v[:, back])


def _matrix(M: np.ndarray) -> tuple[Callable, Callable]:
    return (lambda v: v @ M.T), (lambda v: v @ M)


def _signed() -> Iterator[np.ndarray]:
    """The 47 ways to exchange and reverse three axes, single reversals and exchanges first."""
    all_of_them = [
        np.diag(signs)[:, list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
    ]
    yield from sorted(all_of_them[1:], key=lambda M: (np.trace(np.abs(M)) < 3, (M < 0).sum()))


def _axes(M: np.ndarray, names: Sequence[str]) -> str:
    said = []
    for j, row in enumerate(M):
        i = int(np.abs(row).argmax())
        if i == j and row[i] < 0:
            said.append(f"{names[j]} has the wrong sign")
        elif i != j:
            said.append(f"{names[j]} is {'minus ' if row[i] < 0 else ''}what stands in {names[i]}")
    return ", ".join(said)


def _orders(n: int) -> Iterator[tuple[int, ...]]:
    """Wrong orders of n drives: every one up to four drives, else shifts, reversals and exchanges of two."""
    same = tuple(range(n))
    if n <= 4:
        yield from sorted((o for o in permutations(same) if o != same), key=lambda o: sum(np.array(o) != same))
        return
    seen = {same}
    exchanged = []
    for i, j in combinations(same, 2):
        order = list(same)
        order[i], order[j] = j, i
        exchanged.append(tuple(order))
    for step in (1, -1):
        shifts = [tuple(int(v) for v in np.roll(same[::step], s)) for s in range(n)]
        for order in (*shifts, tuple(i ^ 1 for i in same) if n % 2 == 0 else same, *exchanged):
            if order not in seen:
                seen.add(order)
                yield order


def _said(dimension: str) -> str:
    return dimension.replace("_", " ")
