"""A list of measured points, as SpatialAnalyzer, PolyWorks, Leica and FARO software write them.

One point a line: a name, then x, y and z; separated by commas, semicolons, tabs or blanks, with decimal points or
commas. Names may hold collection and group (``A::Main::P1``, of which P1 counts) and stand in quotes. Lines that begin
with #, // or * are comments; other lines without three numbers are headings. The unit is that of a heading such as
``Units: mm`` or ``X [mm]``, else millimetres.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pcalib.recordings import LENGTHS, Form, Recording, cells, lines_of, nothing_read, number


def read(path: Path) -> Recording:
    """Points without rotations.

    Raises:
        InputError: no line holds a name and three numbers.
    """
    names, points, at, factor, said, more = [], [], [], 1e-3, False, 0
    for line, text in lines_of(path):
        found = cells(text)
        numbers = [value for value in map(number, found[1:4]) if value is not None]
        if text.startswith(("#", "//", "*")) or len(found) < 4 or len(numbers) < 3:
            word = re.search(r"(?:units?\s*[:=]\s*|[\[(])([A-Za-z]+)", text, re.IGNORECASE)
            if word and word.group(1).lower() in LENGTHS and not said:
                factor, said = LENGTHS[word.group(1).lower()], True
            continue
        names.append(found[0].split("::")[-1].strip())
        points.append(numbers)
        at.append(line)
        more += sum(number(value) is not None for value in found[4:7]) == 3
    if not points:
        raise nothing_read(path, "a name and three numbers")
    n = len(points)
    notes = () if said else ("the file names no unit of length; millimetres are taken",)
    if more:
        notes += (
            f"three more numbers stand behind {more} of {n} points and are not read: where they are rotations, make a "
            "measurement file with columns rx_deg, ry_deg and rz_deg, or export matrices and read them as 'matrices'",
        )
    return Recording(
        factor * np.array(points), np.full((n, 3, 3), np.nan), np.array(at), str(path), tuple(names), notes=notes
    )


FORM = Form("a list of points, 'name x y z' each", read)
