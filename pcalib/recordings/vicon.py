"""An object tracked by Vicon, as Tracker and Nexus export it.

A line ``Objects`` (or ``Segments``), the frame rate, the object's name, then ``Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ`` with
the units below it (``rad`` or ``deg``, ``mm``), and one row a frame. RX RY RZ are a rotation vector (axis times angle).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcalib import rotation
from pcalib.errors import InputError
from pcalib.recordings import LENGTHS, Form, Recording, at, nothing_read, number, rows_of

_COLUMNS = ("RX", "RY", "RZ", "TX", "TY", "TZ")


def read(path: Path) -> Recording:
    """Positions and rotations of the first object, with times.

    Raises:
        InputError: not such a file, or units that are not known.
    """
    rows = rows_of(path)
    head = next((i for i, (_, cells) in enumerate(rows) if at(cells, 0) == "Frame"), None)
    if head is None or head < 2 or head + 1 >= len(rows) or any(c not in rows[head][1] for c in _COLUMNS):
        raise nothing_read(path, "the heading 'Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ' of a Vicon export")
    rate = next((value for _, cells in rows[:head] if (value := number(at(cells, 0))) and value > 0), 100.0)
    where = [rows[head][1].index(c) for c in _COLUMNS]
    line, units = rows[head + 1]
    angle, length = at(units, where[0]), at(units, where[3])
    if angle not in ("rad", "deg") or length not in LENGTHS:
        raise InputError(
            f"units '{angle}' and '{length}' are unknown", file=path, line=line,
            remedy="accepted: rad or deg, and mm, cm or m",
        )  # fmt: skip
    kept, times, lines = [], [], []
    for line, cells in rows[head + 2 :]:
        values, frame = [number(at(cells, i)) for i in where], number(at(cells, 0))
        if None not in values and frame is not None:
            kept.append(values)
            times.append(frame / rate)
            lines.append(line)
    if not kept:
        raise nothing_read(path, "a frame in which the object was seen")
    found = np.array(kept, float)
    R = rotation.exp(found[:, :3] * (np.pi / 180 if angle == "deg" else 1.0))
    lost = len(rows) - head - 2 - len(kept)
    notes = (f"{lost} frames in which the object was lost are left out",) if lost else ()
    return Recording(LENGTHS[length] * found[:, 3:], R, np.array(lines), str(path), time=np.array(times), notes=notes)


FORM = Form("an object tracked by Vicon, as Tracker or Nexus exports it", read)
