"""A rigid body tracked by OptiTrack, as Motive exports it (CSV, rotation type quaternion).

A first line of pairs (``Format Version,1.23,…,Length Units,Meters``), headings of type, name and kind of every column,
a line ``Frame,Time (Seconds),X,Y,Z,W,X,Y,Z``, and one row a frame. Frames in which the body was lost are blank.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcalib import rotation
from pcalib.errors import InputError
from pcalib.recordings import LENGTHS, Form, Recording, at, nothing_read, number, rows_of

_UNIT = 1e-3
"""Largest difference of a quaternion's length from 1 that digits of a file explain."""


def read(path: Path) -> Recording:
    """Positions and rotations of the first rigid body, with times.

    Raises:
        InputError: not such a file, or rotations that are no quaternions.
    """
    rows = rows_of(path)
    start = next((i for i, (_, cells) in enumerate(rows) if at(cells, 0) == "Frame"), None)
    if start is None or start < 3:
        raise nothing_read(path, "the heading 'Frame,Time (Seconds),…' of a Motive export")
    pairs = dict(zip(rows[0][1][::2], rows[0][1][1::2], strict=False))
    if (kind := pairs.get("Rotation Type", "Quaternion")) != "Quaternion":
        raise InputError(f"rotations are '{kind}'", file=path, line=1, remedy="export with rotation type Quaternion")
    unit = pairs.get("Length Units", "Meters").lower()
    if unit not in LENGTHS:
        accepted = ", ".join(LENGTHS)
        raise InputError(f"length unit '{unit}' is unknown", file=path, line=1, remedy=f"accepted: {accepted}")
    heads = [cells for _, cells in rows[1:start]]
    axes = rows[start][1]
    kinds = next((h for h in heads if {"Rotation", "Position"} <= set(h)), None)
    types = next((h for h in heads if "Rigid Body" in h), None)
    names = next((h for h in heads if h and h[1:2] == ["Name"]), None)
    if kinds is None or types is None:
        raise nothing_read(path, "a rigid body with rotation and position")
    first = types.index("Rigid Body")
    name = at(names or [], first)
    mine = [i for i in range(2, len(axes)) if at(types, i) == "Rigid Body" and (names is None or at(names, i) == name)]
    column = {(at(kinds, i), at(axes, i)): i for i in mine}
    wanted = [*(("Position", a) for a in "XYZ"), *(("Rotation", a) for a in "WXYZ")]
    if any(key not in column for key in wanted):
        raise nothing_read(path, "position X Y Z and rotation X Y Z W of one rigid body")
    values, times, lines = [], [], []
    for line, cells in rows[start + 1 :]:
        numbers, time = [number(at(cells, column[key])) for key in wanted], number(at(cells, 1))
        if time is None:
            continue
        values.append([np.nan if v is None else v for v in numbers])
        times.append(time)
        lines.append(line)
    found = np.array(values, float).reshape(-1, 7)
    seen = np.array(~np.isnan(found).any(axis=1))
    seen[seen] = np.abs(np.linalg.norm(found[seen, 3:], axis=1) - 1) < _UNIT
    R = np.full((len(found), 3, 3), np.nan)
    size = np.linalg.norm(found[seen, 3:], axis=1, keepdims=True)
    R[seen] = rotation.from_quaternion(found[seen, 3:] / size)
    found[~seen] = np.nan
    others = sorted({n for n, t in zip(names or [], types, strict=False) if t == "Rigid Body"} - {name})
    notes = (f"rigid body '{name}' is read, {', '.join(others)} not",) if others else ()
    notes += (f"{int((~seen).sum())} frames in which the body was lost are left out",) if not seen.all() else ()
    keep = np.flatnonzero(seen)
    if not len(keep):
        raise nothing_read(path, "a frame in which the body was seen")
    return Recording(
        LENGTHS[unit] * found[keep, :3], R[keep], np.array(lines)[keep], str(path), time=np.array(times)[keep],
        notes=notes,
    )


FORM = Form("a rigid body tracked by OptiTrack, as Motive exports it", read)
