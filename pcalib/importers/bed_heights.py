"""Heights of a linear Delta printer's bed, probed at known x and y.

The file has no header and three numbers per line, separated by commas: x, y and z in mm of where the firmware took the
nozzle to be when it, or a probe, touched the bed. What firmware prints while it probes is read as well: Klipper's
``probe at 10.000,20.000 is z=0.125``, Marlin's ``Bed X: 10.000 Y: 20.000 Z: 0.125``, among any other lines, and the
height map of RepRapFirmware. The carriages stood where the present configuration puts them for that point:

    q_i = z + √(rod² − |(x, y) − radius·(cos θ_i, sin θ_i)|²)

so that, as for :mod:`pcalib.importers.carriage_steps`, each line is one reading of z, 0 or the probe's own height.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcalib.errors import InputError
from pcalib.files import read_text
from pcalib.importers import Imported, Importer, carriage_steps

_NUMBER = r"(-?\d+(?:\.\d+)?)"
_LOGS = (
    re.compile(rf"probe at {_NUMBER},\s*{_NUMBER} is z={_NUMBER}"),
    re.compile(rf"Bed X:\s*{_NUMBER}\s+Y:\s*{_NUMBER}\s+Z:\s*{_NUMBER}"),
)
FEWEST = 4
"""Contacts without which nothing can be said."""


def read(path: Path, settings: Mapping[str, np.ndarray]) -> Imported:
    """Bed contacts and the printer they were made on.

    Raises:
        InputError: not three numbers per line, too few contacts, or a point that the rods do not reach.
    """
    found = _of_firmware(read_text(path))
    point, lines = carriage_steps.numbers(path, "x, y and z", "x,y,z in mm") if found is None else found
    if len(point) < FEWEST:
        raise InputError(f"{len(point)} contacts are too few", file=path, remedy="probe 10 points or more")
    rod, radius = (1e3 * float(settings[name][0]) for name in ("rod", "radius"))
    towers = radius * np.stack([np.cos(settings["towers"]), np.sin(settings["towers"])], axis=-1)
    across = np.linalg.norm(point[:, None, :2] - towers, axis=-1)
    if not (across < rod).all():
        row = int(np.argmax((across >= rod).any(axis=1)))
        raise InputError(
            f"rods of {rod:.6g} mm do not reach this point", file=path, line=int(lines[row]),
            remedy="check rod and radius, and that x and y are in mm",
        )  # fmt: skip
    return carriage_steps.contacts(path, settings, point[:, 2:] + np.sqrt(rod**2 - across**2))


def _of_firmware(text: str) -> tuple[np.ndarray, np.ndarray] | None:
    """(N, 3) contacts [mm] of a firmware's log or height map, and their lines; None where it is neither."""
    rows = text.splitlines()
    if rows and rows[0].startswith("RepRapFirmware height map"):
        return _height_map(rows)
    found = [(i, said) for i, row in enumerate(rows, 1) for form in _LOGS if (said := form.search(row))]
    if not found:
        return None
    return np.array([[float(v) for v in said.groups()] for _, said in found]), np.array([i for i, _ in found])


def _height_map(rows: Sequence[str]) -> tuple[np.ndarray, np.ndarray] | None:
    """A grid of heights; 0 without a decimal point stands where nothing was probed."""
    try:
        names = [name.strip() for name in rows[1].split(",")]
        grid = dict(zip(names, rows[2].split(","), strict=False))
        axes = ("xmin", "xspacing", "ymin", "yspacing") if "xmin" in grid else ("min0", "spacing0", "min1", "spacing1")
        x0, dx, y0, dy = (float(grid[name]) for name in axes)
        cells = [[cell.strip() for cell in row.split(",")] for row in rows[3:] if row.strip()]
        found = [
            (x0 + i * dx, y0 + j * dy, float(cell), j + 4)
            for j, row in enumerate(cells) for i, cell in enumerate(row) if cell != "0"
        ]  # fmt: skip
    except (IndexError, KeyError, ValueError):
        return None
    points = np.array(found).reshape(-1, 4)
    return (points[:, :3], points[:, 3].astype(int)) if np.isfinite(points).all() else None


IMPORTER = Importer(
    name="bed-heights",
    summary="heights of a linear Delta printer's bed at known points: lines 'x,y,z' in mm, or what Klipper, Marlin "
    "or RepRapFirmware print",
    options=carriage_steps.PRINTER,
    read=read,
)
