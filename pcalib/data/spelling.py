"""Names of columns as other programs write them, brought into the form of docs/files.md.

Units in brackets (`x [mm]`, `Rx (deg)`) and quaternions by other names (`q_w`, `quat_x`) are understood without asking.
Any other names are given by a line `# columns = q1_deg, q2_deg, …` above the header, one name for each column in order;
a file whose names look like those of a robot's controller is refused with that line ready to paste.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from pcalib import units
from pcalib.data import table as tables
from pcalib.data.table import Table

_BRACKETS = re.compile(r"(\w+)\s*[\[(]\s*([^\])]+?)\s*[\])]")
_OURS = re.compile(r"r?[xyz]|q\d+|tool_[xyz]", re.IGNORECASE)
_QUATERNION = re.compile(r"(?:q|quat|quaternion|orientation)_?([wxyz])", re.IGNORECASE)
_UNITS = {"°": "deg", "degree": "deg", "degrees": "deg", "µm": "um", "μm": "um", "radians": "rad"}
_COMMAND = re.compile(r"q\d+(_.*)?")
_DRIVE = re.compile(r"(?!dir)[^\W\d_]+[ _]?(\d+)")
"""Names of joints in the exports of controllers and trackers: J1, Axis 1, theta_1, Achse1."""
_DRIVE_WITH_UNIT = re.compile(r"(?!dir)[^\W\d_]+[ _]?(\d+)_(deg|rad|mrad|rev|mm|um|m)")
_OTHERS = {"x": "x_mm", "y": "y_mm", "z": "z_mm", "rx": "rx_deg", "ry": "ry_deg", "rz": "rz_deg"} | {
    "a": "rz_deg", "b": "ry_deg", "c": "rx_deg", "roll": "rx_deg", "pitch": "ry_deg", "yaw": "rz_deg"
}  # fmt: skip
_ANGLES = {"a", "b", "c", "roll", "pitch", "yaw"}
"""Names of Euler angles: turns about z, y and x in this order."""
_STEMS = {
    "tool": re.compile(r"(?:tool|tcp|wz|werkzeug)[ _]?([xyz])", re.IGNORECASE),
    "pose_id": re.compile(r"pose|pose[ _]?(?:id|no|nr)|point|punkt", re.IGNORECASE),
    "set": re.compile(r"satz|subset|split|usage", re.IGNORECASE),
}
"""What other programs, English and German, call columns of docs/files.md, without the unit."""


def read(path: str | Path) -> Table:
    """Read a table, with its columns named as docs/files.md has them where that is plain.

    Raises:
        InputError: not a table, names that come out alike, or those of a robot's controller.
    """
    table = tables.read(path)
    if "columns" in table.metadata:
        return _named(table, [name.strip() for name in table.metadata["columns"].split(",")])
    named = [_plain(name) for name in table.columns]
    bare = {"x", "y", "z"} & set(map(str.lower, named))
    if bare and any(map(_DRIVE.fullmatch, named)) and not any(map(_COMMAND.fullmatch, named)):
        _refuse(table)
    for name in (name for name in named if named.count(name) > 1):
        raise table.error(f"two columns are called '{name}', however they are spelled", remedy="keep one of them")
    return replace(table, columns=dict(zip(named, table.columns.values(), strict=True)))


def require_commands(table: Table) -> None:
    """Refuse a table of measurements whose commands have another name, with the line that reads them.

    Raises:
        InputError: no column is called q1, q2, …, and some are called as controllers call their joints.
    """
    joints = [name for name in table.columns if _DRIVE_WITH_UNIT.fullmatch(name)]
    if joints and not any(map(_COMMAND.fullmatch, table.columns)):
        line = ",".join(_DRIVE_WITH_UNIT.sub(r"q\1_\2", _ours(name)) for name in table.columns)
        angles = any(units.split(name)[0].lower() in _ANGLES for name in table.columns)
        raise table.error(
            f"no column holds the commands q1, q2, …, and {', '.join(joints)} look like them",
            remedy=f"if they are, write this line above the header: # columns = {line}{_EULER * angles}",
        )


_EULER = "; A, B, C and roll, pitch, yaw are Euler angles: write '# euler = ZYX' too"


def _ours(name: str) -> str:
    """The name of docs/files.md that a name with a unit seems to mean; else the name as it is."""
    stem, unit = units.split(name)
    ending = name[len(stem) :] if unit else ""
    if stem.lower() in _ANGLES:
        return _OTHERS[stem.lower()].removesuffix("_deg") + ending
    for own, pattern in _STEMS.items():
        if found := pattern.fullmatch(stem):
            return own + "".join(f"_{axis.lower()}" for axis in found.groups()) + ending
    return name


def _plain(name: str) -> str:
    quaternion = _QUATERNION.fullmatch(name)
    if quaternion:
        return f"q{quaternion.group(1).lower()}"
    brackets = _BRACKETS.fullmatch(name)
    if brackets is None:
        return name
    stem, unit = brackets.groups()
    unit = _UNITS.get(unit.lower(), unit)
    stem = stem.lower() if _OURS.fullmatch(stem) else stem
    return f"{stem}_{unit}" if unit in units.UNITS else name


def _named(table: Table, names: Sequence[str]) -> Table:
    """The table with its columns named by its line '# columns = …'."""
    if len(names) != len(table.columns) or len(set(names)) != len(names) or not all(names):
        counts = f"{len(names)} names for {len(table.columns)} columns"
        problem = f"'columns' gives {counts}, each of which needs one of its own"
        raise table.metadata_error("columns", problem, "write one name for each column, in order, separated by commas")
    said = {key: value for key, value in table.metadata.items() if key != "columns"}
    return replace(table, columns=dict(zip(names, table.columns.values(), strict=True)), metadata=said)


def _refuse(table: Table) -> NoReturn:
    """Refuse names of joints that are none of ours, with the line that reads them."""
    names, angles = [], False
    for name in table.columns:
        drive = _DRIVE.fullmatch(name)
        bare = name.lower()
        if drive:
            names.append(f"q{drive.group(1)}_deg")
        else:
            quaternion = _QUATERNION.fullmatch(name)
            names.append(f"q{quaternion.group(1).lower()}" if quaternion else _OTHERS.get(bare, name))
            angles = angles or bare in _ANGLES
    raise table.error(
        f"columns are named {', '.join(list(table.columns)[:6])} …, without units",
        remedy=f"if commands and rotations are in degrees and positions in mm, write this line above the header: "
        f"# columns = {','.join(names)}{_EULER * angles}",
    )  # fmt: skip
