"""Campaign specs (TOML), read with the content of every file that they name, so that one text holds everything."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any

import tomli_w

from bench import plan as plans
from bench.jobs.campaign import cell, samples, sweep
from bench.jobs.campaign.cell import Cell, Output, Regress
from bench.jobs.campaign.geometry import load_listed
from bench.jobs.campaign.sweep import Point
from bench.kinds import MODELS
from pcalib import files, settings
from pcalib import robot as robots
from pcalib.errors import InputError, unknown
from pcalib.settings import Setting

SCHEMA = "pcbench.campaign/1"
FORM = "see docs/scale.md for the form"
TOP = (
    Setting("schema", "word", SCHEMA, words=(SCHEMA,), about="of this file"),
    Setting("name", "word", about="of the campaign"),
    Setting("robots", "whole", 100, 1, 10_000_000, about="perturbed robots per combination of the sweeps"),
    Setting("seed", "whole", 0, 0, about="of everything that is drawn at random"),
)
TABLES = (*cell.SECTIONS, "sweep", "output", "regress")
CHECKED = 1000
"""So many combinations of swept values are read before anything runs, which takes some seconds. Beyond that, only every
value by itself is: a combination that is impossible then gives rows with the status 'failed'."""


@dataclass(frozen=True, eq=False)
class Spec:
    """A campaign, ready to run."""

    name: str
    robots: int
    """Per cell."""
    seed: int
    axes: tuple[tuple[Point, ...], ...]
    """The steps of each [[sweep]]; a cell is a combination of them, the last axis fastest."""
    output: Output
    regress: Regress
    source: str
    """The whole spec as canonical JSON: what results depend on, and what travels to workers."""
    table: Mapping[str, Any] = field(repr=False)
    _cells: dict[int, Cell] = field(default_factory=dict, repr=False)

    @property
    def paths(self) -> tuple[str, ...]:
        """The keys that are swept."""
        return tuple(path for axis in self.axes for path in axis[0])

    @property
    def n_cells(self) -> int:
        """The number of combinations; one where nothing is swept."""
        return prod(map(len, self.axes))

    @property
    def n_trials(self) -> int:
        """Robots in all."""
        return self.n_cells * self.robots

    def point(self, index: int) -> Point:
        """The swept values of a cell, by key."""
        chosen: list[Point] = []
        for axis in reversed(self.axes):
            index, step = divmod(index, len(axis))
            chosen.append(axis[step])
        return {path: value for step in reversed(chosen) for path, value in step.items()}

    def cell(self, index: int) -> Cell:
        """The settings of one cell."""
        if index not in self._cells:
            if len(self._cells) >= 8:  # cells are worked through in order
                self._cells.clear()
            self._cells[index] = cell.read(sweep.applied(self.table, self.point(index)))
        return self._cells[index]


def load(path: str | Path) -> Spec:
    """Read a spec.

    Raises:
        InputError: not readable, not TOML, or a key or value that cannot be used; the message names its path.
    """
    text = files.read_text(path)
    table = files.parse_toml(text, path, FORM)
    try:
        with files.locating(text, path, FORM):
            return parse(json.dumps(_inlined(table, Path(path).parent)))
    except TypeError:
        raise InputError("a spec has no dates or times", file=path, remedy=FORM) from None


@lru_cache(maxsize=2)
def parse(source: str) -> Spec:
    """A spec from canonical JSON; every cell is checked, of a large campaign every swept value."""
    table = json.loads(source)
    known = [*(s.name for s in TOP), *TABLES]
    for key in table:
        if key not in known:
            raise InputError(unknown("key", key, known), column=key)
    top = settings.read({key: v for key, v in table.items() if key not in TABLES}, TOP, "spec", {})
    if not table.get("method"):
        table["method"] = [{"name": name} for name in cell.DEFAULT_METHODS]
    out = Spec(
        name=top["name"],
        robots=top["robots"],
        seed=top["seed"],
        axes=sweep.axes(table.get("sweep", [])),
        output=Output(**settings.read(cell.section(table, "output"), cell.OUTPUT, "output", {})),
        regress=Regress(**settings.read(cell.section(table, "regress"), cell.REGRESS, "regress", {})),
        source=source,
        table={key: value for key, value in table.items() if key in cell.SECTIONS},
    )
    _check(out)
    return out


def _check(spec: Spec) -> None:
    """Read the settings of cells now, so that a wrong one does not stop a campaign hours later; errors name the key."""
    first = spec.point(0)
    tried = [("", first, first)]
    for number, axis in enumerate(spec.axes, 1):
        tried += [(f"sweep[{number}]", {**first, **step}, step) for step in axis]
    if len(spec.axes) > 1 and spec.n_cells <= CHECKED:
        tried += [("sweep", point, point) for point in map(spec.point, range(spec.n_cells))]
    for where, point, told in tried:
        try:
            read = cell.read(sweep.applied(spec.table, point))
            listed = read.geometry.listed
            if listed is not None and spec.robots > len(listed):
                raise InputError(
                    f"robots = {spec.robots}, but [geometry] file lists {len(listed)}", column="robots",
                    remedy=f"write robots = {len(listed)}",
                )  # fmt: skip
        except InputError as error:
            if not told or (not where and _same(error, _without_sweeps(spec))):
                raise
            values = ", ".join(f"{path} = {json.dumps(v)}" for path, v in told.items())
            problem = f"[{where or 'sweep'}] {values} is impossible: {error.problem}"
            raise error.but(problem=problem) from None


def _without_sweeps(spec: Spec) -> InputError | None:
    """The error of the spec without its sweeps; None where there is none."""
    try:
        cell.read(spec.table)
    except InputError as error:
        return error
    return None


def _same(a: InputError, b: InputError | None) -> bool:
    """Whether two errors are about the same key."""
    return b is not None and (a.section, a.key, a.column) == (b.section, b.key, b.column)


def _inlined(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with files replaced by their content: robot files, listed errors, plans."""
    out = dict(table)
    if "robot" in out:
        out["robot"] = _robot(out["robot"], folder)
    if isinstance(out.get("geometry"), dict):
        path = _beside(out["geometry"], "geometry", "robots", folder)
        if path:
            with files.named_by(folder / "spec", path, "file"):
                out["geometry"] = {**out["geometry"], "robots": load_listed(path)}
    if isinstance(out.get("plan"), dict):
        path = _beside(out["plan"], "plan", "listed", folder)
        if path and isinstance(out.get("robot"), dict):
            with files.named_by(folder / "spec", path, "file"):
                made = plans.make(robots.parse(tomli_w.dumps(out["robot"]), "robot"), path)
            out["plan"] = {**out["plan"], "listed": samples.as_lists(made)}
    if isinstance(out.get("sweep"), list):
        out["sweep"] = [
            {k: [_robot(v, folder) for v in values] if k == "robot" and isinstance(values, list) else values
             for k, values in axis.items()} if isinstance(axis, dict) else axis
            for axis in out["sweep"]
        ]  # fmt: skip
    return out


def _robot(given: Any, folder: Path) -> Any:
    if isinstance(given, dict):
        return given
    if not isinstance(given, str):
        raise InputError(f"'robot' must be the name of a robot file, not {given!r}", column="robot")
    names = sorted(path.stem for path in MODELS.glob("*.toml"))
    path = MODELS / f"{given}.toml" if given in names else folder / given
    if not os.path.isfile(path):  # which says no to a name that no file can have
        raise InputError(
            f"robot: {unknown('robot', given, names)}, or the path of a robot file", column="robot",
            remedy="a path is relative to the spec",
        )  # fmt: skip
    with files.named_by(folder / "spec", path, "robot"):
        text = files.read_text(path)
        return tomllib.loads(robots.parse(text, path).text)


def _beside(table: dict[str, Any], where: str, inlined: str, folder: Path) -> Path | None:
    """The file that a table names; None where it names none."""
    if inlined in table:
        raise InputError(f"[{where}] unknown key '{inlined}'; {inlined} are listed in a file", column=inlined)
    name = table.get("file")
    if name is None:
        return None
    if not isinstance(name, str) or not os.path.isfile(folder / name):
        raise InputError(f"[{where}] file {name!r} does not exist beside the spec", column="file")
    return folder / name

