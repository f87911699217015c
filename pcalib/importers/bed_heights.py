"""Heights of a linear Delta printer's bed, probed at known x and y.

The file has no header and three numbers per line, separated by commas: x, y and z in mm of where the firmware took the
nozzle to be when it, or a probe, touched the bed. Firmware prints these after a probing of the bed. The carriages
stood where the present configuration puts them for that point:

    q_i = z + √(rod² − |(x, y) − radius·(cos θ_i, sin θ_i)|²)

so that, as for :mod:`pcalib.importers.carriage_steps`, each line is one reading of z, 0 or the probe's own height.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcalib.errors import InputError
from pcalib.importers import Imported, Importer, carriage_steps


def read(path: Path, settings: Mapping[str, np.ndarray]) -> Imported:
    """Bed contacts and the printer they were made on.

    Raises:
        InputError: not three numbers per line, too few contacts, or a point that the rods do not reach.
    """
    point, lines = carriage_steps.numbers(path, "x, y and z", "x,y,z in mm")
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


IMPORTER = Importer(
    name="bed-heights",
    summary="heights of a linear Delta printer's bed probed at known points, one line 'x,y,z' in mm each, no header",
    options=carriage_steps.PRINTER,
    read=read,
)
