"""Contacts of a linear Delta's nozzle with its flat bed, as step counts of the carriages.

The file has no header and three numbers per line, separated by commas: how many steps each carriage went down from
its endstop until the nozzle touched the bed, or until a probe triggered with the nozzle `contact_height` above it.
Each line is one reading of z; x and y of the contact are not known. A probe beside the nozzle reads there.
Firmware that probes the bed reports these numbers in its log.

A carriage's height over the bed, as the present configuration counts it, is

    q_i = endstop + √(rod² − radius²) − steps_i/steps_per_mm

so that the robot made from these settings is the printer as its firmware believes it to be.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.files import read_text
from pcalib.importers import Imported, Importer, Option

_ROBOT = """\
# A linear Delta printer as its firmware is configured: the base plane is the bed, C the nozzle.
name = "printer"
kind = "linear_delta"

[geometry]
tower_radius_mm = {tower:.6g}
plate_radius_mm = {plate:.6g}    # the firmware knows only the difference, its delta radius
rod_length_mm = {rod:.6g}
rod_spacing_mm = {spacing:.6g}
tower_azimuth_deg = [{towers}]

[joints]                  # height of the carriage joints over the bed; the largest is that at the endstops
min_mm = {low:.6f}
max_mm = {high:.6f}

[workspace]
radius_mm = {bed:.6g}
z_min_mm = 0.0
z_max_mm = {top:.6g}
"""


def read(path: Path, settings: Mapping[str, np.ndarray]) -> Imported:
    """Bed contacts and the printer they were made on.

    Raises:
        InputError: not three numbers per line, fewer than four contacts, rods shorter than the radius, or steps that
            lead to carriages below the bed.
    """
    steps, lines = numbers(path, "three step counts", "steps_a,steps_b,steps_c")
    mm = {name: 1e3 * value for name, value in settings.items()}
    rod, radius, endstop = (float(mm[name][0]) for name in ("rod", "radius", "endstop"))
    if not 0 < radius < rod:
        raise InputError(f"rods of {rod:.6g} mm cannot span a radius of {radius:.6g} mm", remedy="check rod and radius")
    if (steps < 0).any():
        row = int(np.argmax((steps < 0).any(axis=1)))
        raise InputError(
            "negative steps put a carriage beyond its endstop", file=path, line=int(lines[row]),
            remedy="steps are counted downwards from the endstop",
        )  # fmt: skip
    homed = endstop + np.sqrt(rod**2 - radius**2)
    q = homed - steps / float(settings["steps_per_mm"][0])
    if not (q > 0).all():
        row = int(np.argmax((q <= 0).any(axis=1)))
        raise InputError(
            f"these steps put a carriage {-q[row].min():.6g} mm below the bed", file=path, line=int(lines[row]),
            remedy="check steps_per_mm and endstop; steps are counted downwards from the endstop",
        )
    return contacts(path, settings, q)


def contacts(path: Path, settings: Mapping[str, np.ndarray], q: np.ndarray) -> Imported:
    """Contacts at carriage heights q (N, 3) [mm], and the printer as its firmware is configured."""
    mm = {name: 1e3 * value for name, value in settings.items()}
    rod, radius, endstop = (float(mm[name][0]) for name in ("rod", "radius", "endstop"))
    homed = endstop + np.sqrt(rod**2 - radius**2)
    bed = float(mm["bed_radius"][0])
    text = _ROBOT.format(
        tower=radius + mm["plate_radius"][0], plate=mm["plate_radius"][0], rod=rod, spacing=mm["rod_spacing"][0],
        towers=", ".join(f"{v:.6g}" for v in np.degrees(settings["towers"])), bed=bed, top=max(0.8 * endstop, 1.0),
        low=min(q.min(), np.sqrt(max(rod**2 - (radius + bed) ** 2, 0.0))) - 10.0, high=homed,
    )  # fmt: skip
    robot = robots.parse(text, f"robot made from {path.name}")
    contact = np.full((len(q), 3), np.nan)
    contact[:, 2] = float(settings["contact_height"][0])
    probe = np.append(settings["probe_offset"], 0.0)
    data = Measurements.create(
        robot, q * 1e-3, contact, tool=probe, sigma_pos=float(settings["sigma"][0]), source=str(path)
    )
    height = mm["contact_height"][0]
    return Imported(
        data, robot,
        notes=(
            f"{len(q)} bed contacts: z = {height:.6g} mm at each (contact_height=…), x and y unknown, so that heights "
            "are calibrated and absolute scale in x and y hardly is; levels firmware4, firmware6, firmware7 are what "
            "such contacts support",
            f"σ of a contact is taken as {1e6 * settings['sigma'][0]:.3g} µm (sigma=…): the bed's form counts too",
        ),
    )


def numbers(path: Path, what: str, form: str) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) numbers of a file without header, and the line of each row."""
    rows, lines = [], []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(cell) for cell in line.split(",")]
        except ValueError:
            row = []
        if len(row) != 3 or not np.isfinite(row).all():
            raise InputError(
                f"'{line.strip()[:40]}' is not {what}", file=path, line=number,
                remedy=f"one line per contact, '{form}', without a header",
            )
        rows.append(row)
        lines.append(number)
    if len(rows) < 4:
        raise InputError(f"{len(rows)} contacts are too few", file=path, remedy="probe 10 points or more")
    return np.array(rows), np.array(lines)


PRINTER = {
    "rod": Option((340.0,), "mm", "rod length in the present configuration"),
    "radius": Option((172.0,), "mm", "delta radius: carriage joints to plate joints, seen from above"),
    "endstop": Option((333.0,), "mm", "height of the nozzle over the bed at the endstops"),
    "towers": Option((210.0, 330.0, 90.0), "deg", "directions of the three towers"),
    "plate_radius": Option((30.0,), "mm", "plate joints from the nozzle; contacts cannot see it"),
    "rod_spacing": Option((50.0,), "mm", "distance between the rods of a pair; contacts hardly see it"),
    "contact_height": Option((0.0,), "mm", "height of the nozzle over the bed when the probe triggers"),
    "probe_offset": Option((0.0, 0.0), "mm", "x and y of the probe seen from the nozzle"),
    "bed_radius": Option((140.0,), "mm", "bed"),
    "sigma": Option((0.03,), "mm", "1σ of a contact's height, the bed's form included"),
}
"""Settings of a printer and its probe."""

IMPORTER = Importer(
    name="carriage-steps",
    summary="step counts of a linear Delta's carriages at contacts with the bed, one line 'a,b,c' each, no header",
    options={"steps_per_mm": Option((106.667,), "", "steps of a carriage motor per millimetre"), **PRINTER},
    read=read,
)
