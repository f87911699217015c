"""Poses as matrices: nine numbers of a rotation and three of a position, or a homogeneous 4 × 4, row by row.

One pose a line, 12 or 16 numbers in row-major order, R and t side by side, ``r11 r12 r13 x r21 … r33 z``,
and for 16 numbers ``0 0 0 1`` after them; a transposed matrix, with x y z in its last row, is recognised by its zeros.
A name may stand before the numbers. A heading is skipped; the unit is one that it names, else millimetres.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pcalib.errors import InputError
from pcalib.recordings import LENGTHS, Form, Recording, cells, lines_of, nothing_read, number

_ORTHOGONAL = 1e-3
"""Largest element of RᵀR − I that digits of a file explain."""


def read(path: Path) -> Recording:
    """Positions and rotations.

    Raises:
        InputError: no line of 12 or 16 numbers, or one whose first three columns are no rotation.
    """
    names, poses, at, factor = [], [], [], 1e-3
    for line, text in lines_of(path):
        found = cells(text)
        name = found[0] if len(found) in (13, 17) else ""
        values = [number(cell) for cell in (found[1:] if name else found)]
        if len(values) not in (12, 16) or None in values:
            word = re.search(r"[\[(_]\s*(um|mm|cm|m)\s*(?:[\])]|\b)", text)
            factor = LENGTHS[word.group(1)] if word else factor
            continue
        H = np.eye(4)
        H[: len(values) // 4] = np.reshape(np.array(values, float), (-1, 4))
        if not H[:3, 3].any() and H[3, :3].any():
            H = H.T
        R = H[:3, :3]
        if np.abs(R.T @ R - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(R) < 0 or (H[3] != [0, 0, 0, 1]).any():
            raise InputError(
                "these numbers are no rotation and position", file=path, line=line,
                remedy="write r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z, and 0 0 0 1 after them for a 4 × 4 matrix",
            )  # fmt: skip
        names.append(name)
        poses.append(H)
        at.append(line)
    if not poses:
        raise nothing_read(path, "12 or 16 numbers")
    H = np.stack(poses)
    U, _, Vt = np.linalg.svd(H[:, :3, :3])
    label = tuple(names) if all(names) else ()
    return Recording(factor * H[:, :3, 3], U @ Vt, np.array(at), str(path), label)


FORM = Form("poses as 3 × 4 or 4 × 4 matrices, 12 or 16 numbers a line", read)
