"""Sweeps: which keys of a spec take which values.

    [[sweep]]
    "plan.poses" = [12, 20, 40, 80]

    [[sweep]]                                     # crossed with the one above
    "geometry.sigma_length_mm" = [0.1, 0.5]
    "geometry.sigma_angle_deg" = [0.05, 0.2]      # varies together with the line above

A key is the path to a setting, written as in the spec; a method is reached by its name: "method.complete.loss".
"""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from typing import Any

from bench.jobs.campaign.cell import SECTIONS
from bench.truth import flat
from pcalib import units
from pcalib.errors import InputError, unknown

Point = Mapping[str, Any]
"""Path → value: one step of an axis, or one combination of all."""


def axes(tables: Any) -> tuple[tuple[Point, ...], ...]:
    """The steps of every axis.

    Raises:
        InputError: no list of tables, a key that cannot be swept or comes twice, lists of different lengths.
    """
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise InputError("'sweep' must be written as [[sweep]]", column="sweep")
    seen: set[str] = set()
    out = tuple(_axis(number, table, seen) for number, table in enumerate(tables, 1))
    for number, steps in enumerate(out, 1):
        _distinct(number, steps)
    return out


def label(value: Any) -> Any:
    """A swept value as a number, a truth value or text."""
    if isinstance(value, Mapping):
        return str(value.get("name", json.dumps(value, sort_keys=True)))
    return json.dumps(value) if isinstance(value, list) else value


def short(value: Any) -> str:
    """The label of a swept value as tables show it."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def applied(table: Mapping[str, Any], point: Point) -> dict[str, Any]:
    """A copy of a spec's table with the values of a point in their places.

    Raises:
        InputError: a path that leads nowhere.
    """
    out = copy.deepcopy(dict(table))
    for path, value in point.items():
        _put(out, path, value)
    return out


def _axis(number: int, table: Mapping[str, Any], seen: set[str]) -> tuple[Point, ...]:
    where = f"[sweep[{number}]]"
    lists = dict(flat(table))
    if not lists:
        raise InputError(f"{where} is empty", column="sweep", remedy='for example "plan.poses" = [20, 40, 80]')
    for path, values in lists.items():
        root = path.partition(".")[0]
        if root not in SECTIONS:
            raise InputError(f"{where} '{path}': {unknown('section to sweep', root, SECTIONS)}", column=path)
        if not isinstance(values, list) or not values:
            raise InputError(f"{where} '{path}' must be a list of values, not {values!r}", column=path)
        quantity = ".".join([*path.split(".")[:-1], units.split(path.split(".")[-1])[0]])
        if quantity in seen:
            raise InputError(f"{where} '{path}' is swept twice", column=path, remedy="keep one of them")
        seen.add(quantity)
    lengths = {path: len(values) for path, values in lists.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{path} {length}" for path, length in lengths.items())
        raise InputError(
            f"{where}: lists of one table vary together and need the same length: {told}", column=next(iter(lengths)),
            remedy="make them equally long, or give each its own [[sweep]] to cross them",
        )  # fmt: skip
    return tuple(dict(zip(lists, step, strict=True)) for step in zip(*lists.values(), strict=True))


def _distinct(number: int, steps: Sequence[Point]) -> None:
    """That tables and figures can tell the steps of an axis apart."""
    named: set[str] = set()
    for step in steps:
        name = ", ".join(f"{path} = {short(label(value))}" for path, value in step.items())
        if name in named:
            raise InputError(
                f"[sweep[{number}]]: two steps are called '{name}'", column=next(iter(step)),
                remedy="give robot files names of their own, and numbers that differ in their first six digits",
            )  # fmt: skip
        named.add(name)


def _put(table: dict[str, Any], path: str, value: Any) -> None:
    """Write one value; the same quantity in another unit makes way for it."""
    node: Any = table
    parts = path.split(".")
    if parts[:2] == ["geometry", "errors"]:  # names of parameters have points of their own
        parts = [*parts[:2], ".".join(parts[2:])]
    for i, part in enumerate(parts[:-1]):
        here = ".".join(parts[: i + 1])
        if isinstance(node, list):
            node = _item(node, part, here)
            continue
        node = node.setdefault(part, {})
        if not isinstance(node, (dict, list)):
            raise InputError(f"'{path}' leads nowhere: '{here}' is a value, not a section", column=path)
    last = parts[-1]
    if not isinstance(node, dict):
        raise InputError(f"'{path}' leads nowhere", column=path, remedy="name a key of one of the list's items")
    quantity = units.split(last)[0]
    for key in [key for key in node if units.split(key)[0] == quantity]:
        del node[key]
    node[last] = value


def _item(items: list[Any], part: str, here: str) -> Any:
    names = [str(item.get("name", number)) for number, item in enumerate(items, 1) if isinstance(item, Mapping)]
    if part not in names:
        raise InputError(f"'{here}': {unknown('item', part, names)}", column=here)
    return items[names.index(part)]
