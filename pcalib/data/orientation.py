"""The rotation of the plate as files give it: rotation vector, Euler angles or quaternion."""

from __future__ import annotations

import numpy as np

from pcalib import rotation
from pcalib.data import columns as cols
from pcalib.data.columns import Columns
from pcalib.errors import InputError
from pcalib.robot import Robot

QUATERNION = ("qw", "qx", "qy", "qz")


def read(
    columns: Columns, robot: Robot | None, euler: float | str | None = None, in_part: bool = False
) -> tuple[np.ndarray, np.ndarray | None]:
    """Rotations (N, 3, 3), NaN in rows that have none, and the numbers behind them, (N, 3) [rad] or (N, 4).

    Args:
        euler: order of turns where rx ry rz are Euler angles, e.g. 'xyz' about axes that stand still or 'ZYX' about
            the moving ones; None where they are a rotation vector.
        in_part: whether single components of a rotation vector may be given; such rows have no rotation here.
    """
    table = columns.table
    vector = [c for c in cols.ROTATION if c in columns]
    quaternion = [c for c in QUATERNION if c in columns]
    out = np.full((len(table), 3, 3), np.nan)
    if vector and quaternion:
        raise table.error("rotation is given twice: as rx ry rz and as a quaternion", remedy="keep one of them")
    if euler is not None and not vector:
        remedy = "name the columns rx_deg, ry_deg, rz_deg, or leave the line out"
        raise table.metadata_error("euler", "euler says how rx, ry and rz are read, and there are none", remedy)
    if quaternion:
        cols.require(columns, dict.fromkeys(QUATERNION, ""), "a quaternion needs qw, qx, qy and qz")
        values = columns.matrix(QUATERNION, blank=True)
    elif vector:
        free = (3, 4, 5) if robot is None else robot.mechanism.plate_dofs
        needed = {name: "angle" for i, name in enumerate(cols.ROTATION, 3) if i in free}
        cols.require(columns, needed, "a rotation vector needs all of its components")
        zero = np.zeros(len(table))
        values = np.stack([columns.si(c, blank=True) if c in columns else zero for c in cols.ROTATION], axis=1)
        vector = list(needed) or vector
    else:
        return out, None
    used = quaternion or vector
    blank = np.stack([table.blank(columns.name(c)) for c in used], axis=1)
    half = blank.any(axis=1) & ~blank.all(axis=1)
    if half.any() and not (in_part and not quaternion and euler is None):
        row = int(np.argmax(half))
        name = columns.name(used[int(np.argmax(blank[row]))])
        remedy = "give all of its components or leave all blank"
        if vector:
            remedy += "; single components of a rotation vector are read in the base frame"
        raise table.error("the rotation is given in part", row=row, column=name, remedy=remedy)
    given = ~blank.any(axis=1)
    if not quaternion:
        out[given] = (
            rotation.exp(values[given]) if euler is None else from_euler(str(euler), values[given], table.source)
        )
        return out, values
    length = np.linalg.norm(values, axis=1)
    odd = given & (np.abs(length - 1) > 1e-3)
    if odd.any():
        row = int(np.argmax(odd))
        raise table.error(
            f"the quaternion has length {length[row]:.6g}, not 1",
            row=row,
            column="qw",
            remedy="check the order qw qx qy qz and that all four belong to one rotation",
        )
    out[given] = rotation.from_quaternion(values[given] / length[given, None])
    return out, values


def from_euler(sequence: str, angles: np.ndarray, source: str = "") -> np.ndarray:
    """Rotations (N, 3, 3) of Euler angles (N, 3) [rad].

    Args:
        sequence: three axes in the order of the rotations: capitals for moving axes, small letters for fixed ones.
            Where every axis occurs once the columns hold the angles about x, y and z; else they hold the
            first, second and third angle.
    """
    axes = sequence.lower()
    one_case = sequence in (axes, axes.upper())
    if len(axes) != 3 or set(axes) - set("xyz") or axes[0] == axes[1] or axes[1] == axes[2] or not one_case:
        raise InputError(
            f"euler = {sequence} does not name an order of rotations",
            file=source or None,
            remedy="write three axes: 'xyz' for rotations about fixed axes, 'ZYX' for rotations about moving axes; "
            "roll, pitch and yaw are either of them, with rx = roll, ry = pitch, rz = yaw",
        )
    places = ["xyz".index(c) for c in axes] if len(set(axes)) == 3 else [0, 1, 2]
    out = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    for axis, place in zip(axes, places, strict=True):
        turn = rotation.exp(angles[:, place, None] * np.eye(3)["xyz".index(axis)])
        out = out @ turn if sequence.isupper() else turn @ out
    return out


def to_euler(sequence: str, R: np.ndarray) -> np.ndarray:
    """Euler angles (N, 3) [rad] of rotations, the inverse of :func:`from_euler`."""
    import warnings

    from scipy.spatial.transform import Rotation

    axes = sequence.lower()
    places = ["xyz".index(c) for c in axes] if len(set(axes)) == 3 else [0, 1, 2]
    out = np.empty((len(R), 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an untilted plate has no unique Euler angles: any of them is right
        out[:, places] = Rotation.from_matrix(R).as_euler(sequence)
    return out
