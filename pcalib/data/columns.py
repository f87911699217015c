"""Columns that measurements, targets and plans share, read from a :class:`Table` into SI.

A column of a known quantity carries its unit in its name; any other column is the user's own and keeps its full name
and its values as they are: numbers throughout, or text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pcalib import units
from pcalib.data.table import LARGEST, Table
from pcalib.errors import InputError, unknown
from pcalib.robot import Robot

POSITION = {"x": "length", "y": "length", "z": "length"}
ROTATION = {"rx": "angle", "ry": "angle", "rz": "angle"}
TOOL = {"tool_x": "length", "tool_y": "length", "tool_z": "length"}
SMALLEST_SIGMA = 1e-15
"""[m, rad] Smallest standard deviation that is accepted; below it, weights overflow."""
TEMPERATURES = ("temp_arms", "temp_rods", "temp_base")
CONDITIONS = {**TOOL, "payload": "mass", **dict.fromkeys(("temp", *TEMPERATURES), "temperature"), "time": "time"}


@dataclass(frozen=True)
class Columns:
    """Which column of a table gives which quantity."""

    table: Table
    named: Mapping[str, tuple[str, float]]
    """Quantity → (column, factor to SI)."""
    own: tuple[str, ...]
    """The user's own columns."""

    def __contains__(self, quantity: str) -> bool:
        return quantity in self.named

    def name(self, quantity: str) -> str:
        """The column of a quantity."""
        return self.named[quantity][0]

    def si(self, quantity: str, *, blank: bool = False) -> np.ndarray:
        """(N,) values in SI; NaN for blank, which is an error unless `blank`."""
        name, factor = self.named[quantity]
        return self.table.numbers(name, blank=blank) * factor

    def matrix(self, quantities: Iterable[str], *, blank: bool = False) -> np.ndarray:
        """(N, n) values in SI."""
        return np.stack([self.si(q, blank=blank) for q in quantities], axis=1)


def assign(table: Table, wanted: Mapping[str, str], plain: Iterable[str], actuators: int) -> Columns:
    """Separate the columns of known quantities from the user's own columns.

    Args:
        wanted: quantity → dimension, for columns that carry a unit.
        plain: columns without a unit, by their exact name.
        actuators: how many actuators and directions may be numbered.

    Raises:
        InputError: no unit, an unknown or wrong one, a quantity given twice, or a name that is nearly a known one.
    """
    try:
        named = units.resolve([n for n in table.columns if n not in set(plain)], dict(wanted), where="column")
    except InputError as error:
        raise table.error(error.problem, remedy=error.remedy) from None
    named |= {name: (name, 1.0) for name in plain if name in table.columns}
    used = {name for name, _ in named.values()}
    own = tuple(name for name in table.columns if name not in used)
    known = {s.lower(): s for q, d in wanted.items() for s in units.spellings(q, d).split(", ")}
    known |= {name.lower(): name for name in plain} | {q.lower(): q for q in wanted}
    for name in own:
        # 'X_mm', 'x [mm]' and 'x-mm' would otherwise pass as columns of the user's own, and be ignored.
        near = known.get(re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_"))
        if near is not None:
            remedy = f"write '{near}', or rename your own column"
            raise table.error(f"column '{name}' is nearly a known one", remedy=remedy)
        numbered = re.fullmatch(r"(q|dir)(\d+)(?:_.*)?", name)
        if numbered and not 1 <= int(numbered.group(2)) <= actuators:
            raise table.error(
                f"column '{name}': there is no actuator {numbered.group(2)}",
                remedy=f"this robot has {actuators}, counted from 1; is it the right robot file?",
            )
    return Columns(table, named, own)


def actuators(table: Table, robot: Robot | None) -> tuple[tuple[str, ...], str]:
    """Names and dimension of the actuators, from the robot, or from the header if no robot is given."""
    if robot is not None:
        return robot.mechanism.actuators, robot.mechanism.actuator_dimension
    numbers, dimensions = set(), set()
    for name in table.columns:
        match = re.fullmatch(r"q(\d+)(?:_(.+))?", name)
        if match:
            unit = units.UNITS.get(match.group(2) or "")
            numbers.add(int(match.group(1)))
            dimensions.add(unit.dimension if unit else "angle")
    count = max((n for n in numbers if n <= len(table.columns)), default=3)
    return tuple(f"q{i + 1}" for i in range(count)), "length" if dimensions == {"length"} else "angle"


def require(columns: Columns, wanted: Mapping[str, str], why: str) -> None:
    """Check that every wanted quantity has a column.

    Raises:
        InputError: one has none; names the accepted spellings.
    """
    for quantity, dimension in wanted.items():
        if quantity not in columns:
            spellings = units.spellings(quantity, dimension) or quantity
            raise columns.table.error(f"column '{quantity}' is missing: {why}", remedy=f"write one of {spellings}")


def tool(columns: Columns) -> np.ndarray | None:
    """(N, 3) [m] measured or commanded point in the plate frame; None where the file does not say."""
    if not any(q in columns for q in TOOL):
        return None
    require(columns, TOOL, "a tool needs x, y and z")
    return columns.matrix(TOOL)


def payload(columns: Columns) -> np.ndarray:
    """(N,) [kg], 0 where the file does not say."""
    if "payload" not in columns:
        return np.zeros(len(columns.table))
    values = columns.si("payload")
    if (values < 0).any():
        row = int(np.argmax(values < 0))
        name, remedy = columns.name("payload"), "write 0 where there is none"
        raise columns.table.error("a payload cannot be negative", row=row, column=name, remedy=remedy)
    return values


def conditions(columns: Columns, count: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Temperatures, time, directions and the user's own columns: the numeric ones in SI, and those of text.

    One temperature ('temp') stands for arms, rods and base where they have none of their own.
    """
    numeric: dict[str, np.ndarray] = {}
    if "temp" in columns:
        numeric |= dict.fromkeys(("temp", *TEMPERATURES), columns.si("temp"))
    numeric |= {q: columns.si(q) for q in (*TEMPERATURES, "time") if q in columns}
    for name in (f"dir{i + 1}" for i in range(count)):
        if name in columns:
            numeric[name] = columns.si(name)
            odd = ~np.isin(numeric[name], (-1, 0, 1))
            if odd.any():
                row = int(np.argmax(odd))
                cell = columns.table.texts(name)[row]
                raise columns.table.error(f"{cell!r} is no direction", row=row, column=name, remedy="write -1, 0 or 1")
    text: dict[str, np.ndarray] = {}
    for name in columns.own:
        cells = columns.table.columns[name]
        # A column of words is kept as such; one number in it makes it a column of numbers, all of which must be right.
        if not isinstance(cells, np.ndarray) and not any(map(_numeric, cells)):
            text[name] = np.array(cells, object)
        else:
            numeric[name] = columns.table.numbers(name)
    return numeric, text


def _numeric(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def metadata(
    table: Table, wanted: Mapping[str, str], plain: Iterable[str], others: Mapping[str, str] | None = None
) -> dict[str, float | str]:
    """Metadata by quantity: positive numbers in SI for those with a unit, text for the plain ones.

    Args:
        others: keys that are accepted here and read elsewhere, and the spelling that a message names.

    Raises:
        InputError: an unknown key, no or a wrong unit, no positive number, or a comment that looks like a key.
    """
    accepted = [f"{q}_{'mm' if d == 'length' else 'deg'}" for q, d in wanted.items()] + list(plain)
    others = others or {}
    accepted += dict.fromkeys(others.values())

    for line, text in table.comments.items():
        word, colon = re.split(r"[\s:]", text, maxsplit=1)[0], ":" in text.split(maxsplit=1)[0]
        if word in wanted or units.split(word)[0] in wanted or (colon and word in plain):
            key = word.rstrip(":")
            raise InputError(f"'{key}' stands in a comment", file=table.source, line=line, remedy=f"write # {key} = …")
    out: dict[str, float | str] = {}
    used: dict[str, tuple[str, float]] = {}
    for key in (key for key in table.metadata if key not in others):
        try:
            used |= units.resolve([*(name for name, _ in used.values()), key], dict(wanted), where="metadata")
        except InputError as problem:
            raise table.metadata_error(key, problem.problem, problem.remedy) from None
        if key in plain:
            out[key] = table.metadata[key]
        elif key not in {name for name, _ in used.values()}:
            remedy = "a comment is a '#' line without '='"
            raise table.metadata_error(key, unknown("metadata key", key, accepted), remedy)
    for quantity, (key, factor) in used.items():
        text = table.metadata[key]
        try:
            value = float(text.replace(",", ".") if re.fullmatch(r"\d+,\d+", text) else text)
        except ValueError:
            value = np.nan
        if not SMALLEST_SIGMA <= value * factor < LARGEST:
            problem = f"metadata '{key}' must be a positive number, not {table.metadata[key]!r}"
            raise table.metadata_error(key, problem, "e.g. 0.02")
        out[quantity] = value * factor
    return out
