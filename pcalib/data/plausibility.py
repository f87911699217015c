"""Values that cannot be meant as they are written: past the joint range, or in another unit than the name says.

Each check raises an :class:`InputError` that names the line and, where a unit explains it, the right column name.
"""

from __future__ import annotations

import numpy as np

from pcalib import units
from pcalib.data.columns import Columns
from pcalib.errors import InputError
from pcalib.robot import Robot

_ANGLE_SLACK = np.deg2rad(5.0)
_LENGTH_SLACK = 0.05
"""Share of the joint range by which a commanded length may exceed it."""
_WORKSPACE_SLACK = 0.6
"""Share of the distance to the workspace's farthest corner: measured poses may lie well outside the working
cylinder, but not by this much."""


def joints(columns: Columns, robot: Robot, q: np.ndarray) -> None:
    """Refuse actuator values (N, nq) more than 5° or 5 % outside the joint range."""
    low, high = robot.joint_range
    angle = robot.mechanism.actuator_dimension == "angle"
    slack = _ANGLE_SLACK if angle else _LENGTH_SLACK * (high - low)
    outside = ~((q >= low - slack) & (q <= high + slack))
    if not outside.any():
        return
    row, joint = (int(i) for i in np.argwhere(outside)[0])
    quantity = robot.mechanism.actuators[joint]
    name, factor = columns.named[quantity]
    shown, scale = ("°", np.deg2rad(1)) if angle else (" mm", 1e-3)
    written = q / np.array([columns.named[a][1] for a in robot.mechanism.actuators])
    fits = [
        unit.suffix
        for unit in units.UNITS.values()
        if unit.dimension == robot.mechanism.actuator_dimension
        and unit.factor != factor
        and np.all((written * unit.factor >= low - slack) & (written * unit.factor <= high + slack))
        and np.min(np.max(np.abs(written), axis=0)) * unit.factor > 0.05 * (high - low)
    ]
    reversed_ = _reversed(q, outside, low - slack, high + slack)
    if reversed_:
        names = [columns.named[robot.mechanism.actuators[j]][0] for j in reversed_]
        several = len(names) > 1
        remedy = (
            f"with the other sign all values of {', '.join(names)} are in range: where "
            f"{'these drives count' if several else 'this drive counts'} the other way, change the sign of the "
            f"column{'s' * several}; else check [joints] of the robot file"
        )
    elif fits:
        remedy = f"the values look like {fits[0]}: name the column {quantity}_{fits[0]}"
    else:
        remedy = "check the value, its unit and sign, and [joints] of the robot file"
    raise columns.table.error(
        f"{q[row, joint] / scale:.6g}{shown} is outside the joint range "
        f"{low / scale:.6g}…{high / scale:.6g}{shown} of robot '{robot.name}'",
        row=row, column=name, remedy=remedy,
    )


_SOME = 3
"""Different commands from which on a whole column may have the wrong sign."""


def _reversed(q: np.ndarray, outside: np.ndarray, low: float, high: float) -> list[int]:
    """Drives with values outside the range all of which are inside it with the other sign; none where that leaves
    values of other drives outside.

    Args:
        outside: (N, nq) bool.
    """
    found = [j for j in range(q.shape[1]) if outside[:, j].any() and len(np.unique(q[:, j])) >= _SOME]
    inside = (-q >= low) & (-q <= high)
    right = all(inside[:, j].all() for j in found)
    others = [j for j in range(q.shape[1]) if j not in found]
    return found if right and not outside[:, others].any() else []


def tools(columns: Columns, robot: Robot, tool: np.ndarray) -> None:
    """Refuse tool vectors (N, 3) that are several times longer than the robot is large."""
    size, long = _size(robot), too_long(robot, tool)
    if long.any():
        row = int(np.argmax(long))
        name = columns.name("tool_x")
        raise columns.table.error(
            f"a tool of {np.linalg.norm(tool[row]):.4g} m is longer than the robot is large ({size:.2g} m)",
            row=row, column=name, remedy="check its unit: tool_x_mm, tool_y_mm, tool_z_mm",
        )


def too_long(robot: Robot, tool: np.ndarray) -> np.ndarray:
    """Which tools (…, 3) [m] are several times longer than the robot is large."""
    return np.linalg.norm(tool, axis=-1) > 3 * _size(robot)


def positions(columns: Columns, robot: Robot, point: np.ndarray) -> None:
    """Refuse plate positions (N, 3) in the base frame, NaN where unknown, that are far outside the workspace."""
    far = _excess(robot, point) > _slack(robot)
    if far.any() or _too_small(robot, point):
        advice = "; positions of a tracker that is not aligned with the base need '# frame = tracker'"
        raise _far_off(columns, robot, point, int(np.argmax(far)), advice)


def targets(columns: Columns, robot: Robot, point: np.ndarray) -> None:
    """Refuse wanted plate positions (N, 3) that are all far outside: a wrong unit. A single one is reported later."""
    if (_excess(robot, point) > _slack(robot)).all() or _too_small(robot, point):
        raise _far_off(columns, robot, point, 0)


def _far_off(columns: Columns, robot: Robot, point: np.ndarray, row: int, advice: str = "") -> InputError:
    column, written = next(columns.named[c] for c in "zyx" if c in columns)
    remedy = "check the unit and the sign of z (the workspace of a hanging robot has z < 0)"
    for unit in units.UNITS.values():
        scaled = point * (unit.factor / written)
        fits = (_excess(robot, scaled) <= _slack(robot) / 2).all() and not _too_small(robot, scaled)
        if unit.dimension == "length" and unit.factor != written and fits:
            names = ", ".join(f"{c}_{unit.suffix}" for c in "xyz")
            remedy = f"the values look like {unit.suffix}: name the columns {names}"
            break
    w = robot.workspace
    values = ", ".join("?" if np.isnan(v) else f"{v * 1e3:.6g}" for v in point[row])
    return columns.table.error(
        f"the plate at ({values}) mm is far off the workspace of robot '{robot.name}' (radius {w.radius * 1e3:.6g} mm, "
        f"z {w.z_min * 1e3:.6g}…{w.z_max * 1e3:.6g} mm)",
        row=row, column=column, remedy=remedy + advice,
    )


def _slack(robot: Robot) -> float:
    return _WORKSPACE_SLACK * _size(robot)


def _size(robot: Robot) -> float:
    """Distance from the base origin to the farthest corner of the workspace [m]."""
    return float(np.hypot(robot.workspace.radius, max(abs(robot.workspace.z_min), abs(robot.workspace.z_max))))


def _excess(robot: Robot, point: np.ndarray) -> np.ndarray:
    """(N,) [m] by how much points lie outside the working cylinder; unknown components count as inside."""
    w = robot.workspace
    x, y, z = np.nan_to_num(point[:, 0]), np.nan_to_num(point[:, 1]), point[:, 2]
    below, above = np.nan_to_num(w.z_min - z), np.nan_to_num(z - w.z_max)
    return np.maximum.reduce([np.hypot(x, y) - w.radius, below, above, np.zeros(len(point))])


def _too_small(robot: Robot, point: np.ndarray) -> bool:
    """All z a hundred times nearer to the base than the workspace is: metres where millimetres were meant."""
    w = robot.workspace
    nearest = 0.0 if w.z_min <= 0 <= w.z_max else min(abs(w.z_min), abs(w.z_max))
    z = point[~np.isnan(point[:, 2]), 2]
    return bool(len(z) and nearest > 0 and np.max(np.abs(z)) < nearest / 100)
