"""What instruments write: readings without the robot's commands, one file a form; :mod:`pcalib.recordings.pairing` puts
both together.

A file of this folder that defines ``FORM`` is a form; nothing else has to be told about it. What it reads stands in its
docstring.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcalib.data.table import decoded
from pcalib.errors import InputError
from pcalib.registry import Registry

LENGTHS = {
    "um": 1e-6, "mm": 1e-3, "millimeters": 1e-3, "millimetres": 1e-3, "cm": 1e-2, "centimeters": 1e-2, "m": 1.0,
    "meters": 1.0, "metres": 1.0, "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
}  # fmt: skip
"""Units of length as instruments spell them → metres."""


@dataclass(frozen=True, eq=False)
class Recording:
    """N readings of an instrument, in its own frame."""

    position: np.ndarray
    """(N, 3) [m]; NaN where nothing was seen."""
    rotation: np.ndarray
    """(N, 3, 3) body → frame; NaN where not measured."""
    lines: np.ndarray
    """(N,) int, lines of the file."""
    source: str
    label: tuple[str, ...] = ()
    """Name of each reading; empty where they have none."""
    time: np.ndarray | None = None
    """(N,) [s]; None where readings are single ones, made while the robot stood."""
    notes: tuple[str, ...] = field(default=())
    """What the user should know."""

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True)
class Form:
    """A reader of one form."""

    summary: str
    """What it is, in half a sentence."""
    read: Callable[[Path], Recording]


FORMS = Registry[Form](
    __name__, "FORM", "form", helpers=("pairing", "dwells"), separator="-",
    remedy="'pcalib import --help' describes them",
)  # fmt: skip


def lines_of(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of every line that is not blank; any encoding that spreadsheets write."""
    for number, line in enumerate(decoded(path).lstrip("\ufeff").splitlines(), 1):
        if line.strip():
            yield number, line.strip()


def cells(line: str) -> list[str]:
    """The cells of a line: separated by semicolons or tabs, else by commas, else by blanks; quotes are taken off.

    Where semicolons, tabs or blanks separate, a comma in a number is its decimal point.
    """
    if ";" in line or "\t" in line:
        parts = re.split(r"[;\t]", line)
    elif re.search(r",\s", line) or (line.count(",") > 1 and not re.search(r"\d,\d+\s+-?\d", line)):
        return [part.strip().strip('"') for part in line.split(",")]
    else:
        parts = re.findall(r'"[^"]*"|\S+', line)
    return [re.sub(r"^([-+]?\d+),(\d+(?:[eE][-+]?\d+)?)$", r"\1.\2", part.strip().strip('"')) for part in parts]


def rows_of(path: Path) -> list[tuple[int, list[str]]]:
    """Line number and cells of every line of a CSV that is not blank; a line that is no CSV has one cell."""
    out = []
    for line, text in lines_of(path):
        try:
            out.append((line, next(csv.reader([text]))))
        except csv.Error:
            out.append((line, [text]))
    return out


def at(cells: Sequence[str], i: int) -> str:
    """A cell without the blanks around it; '' beyond the end of the row."""
    return cells[i].strip() if 0 <= i < len(cells) else ""


def number(cell: str) -> float | None:
    """The number in a cell; None where there is none."""
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def nothing_read(path: Path, wanted: str) -> InputError:
    """The error for a file that is not of the form."""
    return InputError(f"no line holds {wanted}", file=path, remedy="'pcalib import FORM' says what a form looks like")
