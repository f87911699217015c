"""The kinematics of :mod:`pcalib.mechanics.kinematics` in C, where the extension was built: the same answers, faster.

The C is that of `pcalib export`, compiled for vectors of poses (`native/`). It says which poses it solved to rounding;
all others are left to NumPy, which is the reference. With the environment variable PCALIB_NATIVE=0 all are.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcalib.mechanics.extension import library
from pcalib.mechanics.loops import RIGID, Deviation
from pcalib.mechanics.mechanism import Mechanism, Pose
from pcalib.mechanics.paths import SAME, base_paths

SHAPES = ("three_arms", "six_arms", "two_bodies", "plane")
"""The files of `native/`, one per shape of robot."""
ROUNDS = 10
"""Newton steps at most, as in native/batch.c."""
MOST_PARAMETERS = 128
"""Parameters of a robot whose derivatives the C can hold, as in native/batch.c; the most are the Hexa's 78."""


@dataclass(frozen=True)
class Found:
    """What the extension says of N poses."""

    q: np.ndarray
    pose: Pose
    residual: np.ndarray
    """(N,) [m] largest loop error."""
    solved: np.ndarray
    """(N,) bool: closed to rounding on the working branch; nothing else here is of use where this is false."""


@lru_cache(maxsize=64)
def _shape(mechanism: Mechanism) -> str | None:
    """The shape of a mechanism; None where none fits, or where its joints run neither on circles nor on lines."""
    loaded = library()
    paths = base_paths(mechanism, mechanism.nominal)
    if loaded is None or paths.misses(mechanism, mechanism.nominal) > SAME:
        return None
    commanded = {3, 4, 5} & set(mechanism.task)
    m = len(mechanism.rods)
    topology = [
        len(mechanism.actuators), m, len(mechanism.hinges), len(mechanism.plate_dofs),
        0 if {3, 4} <= commanded else 1 if commanded else 2,
        int(5 in commanded and not {3, 4} & commanded and len(mechanism.plate_dofs) == 6), *mechanism.actuator,
        *(np.zeros(m, int) if mechanism.body is None else mechanism.body), *paths.guided, *mechanism.plate_dofs,
        *(mechanism.free_state or [0]),
    ]  # fmt: skip
    wanted = np.array(topology, np.intc).tobytes()
    for name in SHAPES:
        known = (ctypes.c_int * 4).in_dll(loaded, f"{name}_topology")
        if list(known) == topology[:4]:
            whole = (ctypes.c_int * len(topology)).in_dll(loaded, f"{name}_topology")
            return name if bytes(whole) == wanted else None
    return None


def knows(mechanism: Mechanism) -> bool:
    """Whether the extension was built and has the shape of this mechanism; all others are left to NumPy."""
    return bool(library()) and _shape(mechanism) is not None


def _numbers(mechanism: Mechanism, k: np.ndarray) -> np.ndarray:
    """The numbers of a robot in the order of `table` in native/batch.c."""
    return _numbers_of(mechanism, np.ascontiguousarray(k, float).tobytes())


@lru_cache(maxsize=16)  # loads and poses are iterated at one geometry
def _numbers_of(mechanism: Mechanism, parameters: bytes) -> np.ndarray:
    k = np.frombuffer(parameters)
    p = base_paths(mechanism, k)
    turns = float(mechanism.actuator_dimension == "angle")
    hinges = [hinge.at(k) for hinge in mechanism.hinges]
    parts = [
        p.centre, p.cosine, p.sine, p.slope, p.length, p.rate, mechanism.plate_points(k), p.guide_cosine, p.guide_sine,
        p.guide_length, [turns, mechanism.rod_side, mechanism.max_tilt], *(h.point for h in hinges),
        *(h.axis for h in hinges),
    ]  # fmt: skip
    return np.concatenate([np.ravel(part) for part in parts])


def _address(array: np.ndarray | None) -> ctypes.c_void_p | None:
    return None if array is None else ctypes.c_void_p(array.ctypes.data)


def _run(
    name: str, numbers: np.ndarray, n: int, started: bool, deviation: Deviation, *arrays: np.ndarray | None
) -> None:
    deviates = [None if v is None else np.ascontiguousarray(v, float) for v in vars(deviation).values()]
    four = (ctypes.c_void_p * 4)(*(None if v is None else v.ctypes.data for v in deviates))
    flag = ctypes.c_int(started)
    getattr(library(), name)(_address(numbers), ctypes.c_long(n), flag, four, *(_address(a) for a in arrays))


def _own(values: np.ndarray, *shape: int) -> np.ndarray:
    """A copy that the C can read and write."""
    return np.array(np.broadcast_to(values, shape), float, order="C")


def forward(
    mechanism: Mechanism, k: np.ndarray, q: np.ndarray, start: Pose | None = None, deviation: Deviation = RIGID
) -> Found | None:
    """Plate poses for commands q (N, nq); None where NumPy has to find them all."""
    name = library() and _shape(mechanism)
    if not name:
        return None
    n, h = len(q), len(mechanism.hinges)
    if start is None and not (mechanism.level_pairs and deviation.none):
        start = mechanism.start(k, q)
    if start is None:
        pose = Pose(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, h)))
    else:
        pose = Pose(_own(start.x, n, 3), _own(start.R, n, 3, 3), _own(start.phi, n, h) if h else np.empty((n, 0)))
    residual, solved = np.empty(n), np.empty(n, bool)
    q = np.ascontiguousarray(q, float)
    arrays = (q, pose.x, pose.R, pose.phi, residual, solved)
    _run(f"{name}_forward", _numbers(mechanism, k), n, start is not None, deviation, *arrays)
    return Found(q, pose, residual, solved)


def inverse(
    mechanism: Mechanism,
    k: np.ndarray,
    position: np.ndarray,
    R: np.ndarray | None,
    tool: np.ndarray,
    start: tuple[np.ndarray, Pose] | None = None,
    deviation: Deviation = RIGID,
    errors: np.ndarray | None = None,
) -> Found | None:
    """Commands for tool points (N, 3) and orientations R (N, 3, 3); None where NumPy has to find them all.

    Args:
        tool: (), (3,) or (N, 3) [m].
        start: commands (N, nq) and poses to start from; the closed form where absent, which knows no deviation.
        errors: (nk,) geometric errors for which the commands are then compensated to first order.
    """
    name = library() and _shape(mechanism)
    if not name or not {0, 1, 2} & set(mechanism.plate_dofs) <= set(mechanism.task):
        return None  # what the task leaves free of a place is looked for from another start
    if start is None and not deviation.none:
        return None
    by = None
    if errors is not None:
        if (slopes := _slopes(mechanism, k)) is None:
            return None
        base = slopes @ errors[mechanism.actuation.columns][:, :, None]
        by = np.hstack([base[..., 0], errors[mechanism.plate_columns]])
    n, h = len(position), len(mechanism.hinges)
    position = np.ascontiguousarray(position, float)
    turn = None if R is None else np.ascontiguousarray(np.broadcast_to(R, (n, 3, 3)), float)
    tool = np.ascontiguousarray(np.broadcast_to(tool, (n, 3)), float)
    if start is None:
        q = np.empty((n, len(mechanism.actuators)))
        pose = Pose(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, h)))
    else:
        q = _own(start[0], n, len(mechanism.actuators))
        phi = _own(start[1].phi, n, h) if h else np.empty((n, 0))
        pose = Pose(np.empty((n, 3)), _own(start[1].R, n, 3, 3), phi)
    residual, solved = np.empty(n), np.empty(n, bool)
    arrays = (position, turn, tool, by, q, pose.x, pose.R, pose.phi, residual, solved)
    _run(f"{name}_inverse", _numbers(mechanism, k), n, start is not None, deviation, *arrays)
    return Found(q, pose, residual, solved)


def _slopes(mechanism: Mechanism, k: np.ndarray) -> np.ndarray | None:
    """(m, 14, c) what the base side's derivatives by parameters are made of; None where NumPy has to find them."""
    plain = not mechanism.hinges and mechanism.plate_signs is None and mechanism.n_state == 6
    return mechanism.actuation.slopes(k) if plain and len(k) <= MOST_PARAMETERS else None


@lru_cache(maxsize=64)
def _columns(mechanism: Mechanism) -> np.ndarray:
    """(m, c + 3) int32 where the parameters of each rod stand in k, those of its joint on the plate last."""
    return np.hstack([mechanism.actuation.columns, mechanism.plate_columns]).astype(np.int32)


def motion(mechanism: Mechanism, k: np.ndarray, q: np.ndarray, pose: Pose, tool: np.ndarray) -> np.ndarray | None:
    """Derivative of the plate's state about its tool point (N, 3) by every parameter, (N, n_state, nk), without
    deviations; None where NumPy has to find it."""
    name = library() and _shape(mechanism)
    slopes = _slopes(mechanism, k) if name else None
    if slopes is None:
        return None
    n = len(q)
    out = np.empty((n, mechanism.n_state, len(k)))
    given = [np.ascontiguousarray(a, float) for a in (q, pose.x, pose.R, np.broadcast_to(tool, (n, 3)), slopes)]
    numbers, columns = _numbers(mechanism, k), _columns(mechanism)
    sizes = ctypes.c_int(slopes.shape[2]), ctypes.c_int(len(k))
    run = getattr(library(), f"{name}_motion")
    run(_address(numbers), ctypes.c_long(n), *map(_address, given), _address(columns), *sizes, _address(out))
    return out
