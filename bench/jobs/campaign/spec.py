"""Campaign specs (TOML): reading, with every file they name put in its place, so that one text says it all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
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
    Setting("seed", "whole", 0, 0, about="of all that is drawn"),
)
TABLES = (*cell.SECTIONS, "sweep", "output", "regress")


@dataclass(frozen=True, eq=False)
class Campaign:
    """A spec, ready to run."""

    name: str
    robots: int
    """Per cell."""
    seed: int
    points: tuple[Point, ...]
    """The swept values of each cell; one empty point where nothing is swept."""
    output: Output
    regress: Regress
    source: str
    """The whole spec as canonical JSON: what results depend on, and what travels to workers."""
    table: Mapping[str, Any] = field(repr=False)
    _cells: dict[int, Cell] = field(default_factory=dict, repr=False)

    @property
    def paths(self) -> tuple[str, ...]:
        """What is swept."""
        return tuple(self.points[0])

    @property
    def n_trials(self) -> int:
        """Robots in all."""
        return len(self.points) * self.robots

    @property
    def fingerprint(self) -> str:
        """A hash of the spec's content."""
        return hashlib.sha256(self.source.encode()).hexdigest()

    def cell(self, index: int) -> Cell:
        """The settings of one cell."""
        if index not in self._cells:
            if len(self._cells) >= 8:  # cells are worked through in order
                self._cells.clear()
            self._cells[index] = cell.read(sweep.applied(self.table, self.points[index]))
        return self._cells[index]

    def parts(self) -> list[range]:
        """Trials, numbered cell after cell, in the pieces in which they are done and kept."""
        size = self.output.part_robots
        return [range(i, min(i + size, self.n_trials)) for i in range(0, self.n_trials, size)]


def load(path: str | Path) -> Campaign:
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
        raise InputError("dates and times have no place in a spec", file=path, remedy=FORM) from None


@lru_cache(maxsize=2)
def parse(source: str) -> Campaign:
    """A campaign from canonical JSON; every cell is checked."""
    table = json.loads(source)
    known = [*(s.name for s in TOP), *TABLES]
    for key in table:
        if key not in known:
            raise InputError(unknown("key", key, known), column=key)
    top = settings.read({key: v for key, v in table.items() if key not in TABLES}, TOP, "spec", {})
    if "method" in table and (
        not isinstance(table["method"], list) or not all(isinstance(m, dict) for m in table["method"])
    ):
        raise InputError("'method' must be written as [[method]]", column="method")
    if not table.get("method"):
        table["method"] = [{"name": name} for name in cell.DEFAULT_METHODS]
    for key in ("output", "regress"):
        if not isinstance(table.get(key, {}), dict):
            raise InputError(f"'{key}' must be a section", column=key, remedy=f"write [{key}]")
    steps = sweep.axes(table.get("sweep", []))
    out = Campaign(
        name=top["name"],
        robots=top["robots"],
        seed=top["seed"],
        points=tuple(sweep.combinations(steps)),
        output=cell.output(table.get("output", {})),
        regress=cell.regress(table.get("regress", {})),
        source=source,
        table={key: value for key, value in table.items() if key in cell.SECTIONS},
    )
    _check(out, steps)
    return out


def _check(campaign: Campaign, steps: tuple[tuple[Point, ...], ...]) -> None:
    """Read every cell, so that nothing is found out hours later; the key that is to blame is named."""
    first = {path: value for axis in steps for path, value in axis[0].items()}
    tried = [("", first, first)]
    for number, axis in enumerate(steps, 1):
        tried += [(f"sweep[{number}]", {**first, **step}, step) for step in axis]
    if len(steps) > 1:
        tried += [("sweep", point, point) for point in campaign.points]
    for where, point, told in tried:
        try:
            _require_enough(campaign, cell.read(sweep.applied(campaign.table, point)))
        except InputError as error:
            if where == "" and steps:
                _unswept(campaign, error)
            if not told:
                raise
            values = ", ".join(f"{path} = {json.dumps(v)}" for path, v in told.items())
            problem = f"[{where or 'sweep'}] {values} is impossible: {error.problem}"
            raise error.but(problem=problem) from None


def _unswept(campaign: Campaign, found: InputError) -> None:
    """Raise where the spec is wrong in the same way without its sweeps."""
    try:
        cell.read(campaign.table)
    except InputError as error:
        if (error.section, error.key, error.column) == (found.section, found.key, found.column):
            raise


def _require_enough(campaign: Campaign, read: Cell) -> None:
    listed = read.geometry.listed
    if listed is not None and campaign.robots > len(listed):
        raise InputError(
            f"robots = {campaign.robots}, but [geometry] file lists {len(listed)}", column="robots",
            remedy=f"write robots = {len(listed)}",
        )  # fmt: skip


def _inlined(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with files replaced by what they say: robot files, listed errors."""
    out = dict(table)
    if "robot" in out:
        out["robot"] = _robot(out["robot"], folder)
    if isinstance(out.get("geometry"), dict):
        out["geometry"] = _listed(out["geometry"], folder)
    if isinstance(out.get("plan"), dict):
        out["plan"] = _planned(out["plan"], out.get("robot"), folder)
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
    if not path.is_file():
        raise InputError(
            f"robot: {unknown('robot', given, names)}, or the path of a robot file", column="robot",
            remedy="a path is relative to the spec",
        )  # fmt: skip
    return files.parse_toml(files.read_text(path), path, "see models/delta.toml for the form")


def _listed(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    if "robots" in table:
        raise InputError("[geometry] unknown key 'robots'; robots are listed in a file", column="robots")
    name = table.get("file")
    if name is None:
        return table
    if not isinstance(name, str) or not (folder / name).is_file():
        raise InputError(f"[geometry] file {name!r} does not exist beside the spec", column="file")
    return {**table, "robots": load_listed(folder / name)}


def _planned(table: dict[str, Any], robot: Any, folder: Path) -> dict[str, Any]:
    if "listed" in table:
        raise InputError("[plan] unknown key 'listed'; poses are listed in a file", column="listed")
    name = table.get("file")
    if name is None or not isinstance(robot, dict):
        return table
    if not isinstance(name, str) or not (folder / name).is_file():
        raise InputError(f"[plan] file {name!r} does not exist beside the spec", column="file")
    made = plans.make(robots.parse(tomli_w.dumps(robot), "robot"), folder / name)
    return {**table, "listed": samples.as_lists(made)}
