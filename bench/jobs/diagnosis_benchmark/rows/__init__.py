"""Rows of the benchmark: one file each, which makes data sets of one sort and judges what is said of them.

A file of this folder that defines ``ROW``, a :class:`Row`, is a row; its name is the file's. Files that start with `_`
hold what several share. A set is named `row.variant/task#number`, for instance `noise.heavy_tails/7#2`: together with
the seed of the run that name fixes every byte of it.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.jobs.hidden.grading import Grade, Line
from pcalib.data.measurement import Measurements
from pcalib.errors import FitError, InputError, unknown
from pcalib.fitting import identification
from pcalib.model import Model
from pcalib.registry import Registry
from pcalib.robot import Robot

STREAM = 0x7EE7


@dataclass(frozen=True)
class Task:
    """A piece of work: one robot and one plan, measured `sets` times."""

    row: str
    variant: str
    number: int
    sets: int
    robot: str = ""
    """Text of the robot file for rows of hidden faults; empty: the default Delta."""

    @property
    def name(self) -> str:
        """Row, variant and number."""
        return f"{self.row}.{self.variant}/{self.number}"

    def generator(self, seed: int) -> np.random.Generator:
        """Return the random numbers of this task."""
        key = zlib.crc32(f"{self.row}.{self.variant}".encode())
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, key, self.number)))


@dataclass(frozen=True, eq=False)
class Set:
    """One data set, and from what the user's model of the robot is made."""

    start: Robot | Model
    """What the fit of these data starts from."""
    data: Measurements
    about: str
    """What is in the data, for a table."""
    truth: Mapping[str, Any] = field(default_factory=dict)
    """Whatever the judgement needs to know."""
    level: str = "complete"
    """Geometry level of the fit."""
    stale: bool = False
    """Whether the model is `start` as it stands, and not fitted to these data."""

    @cached_property
    def model(self) -> Model:
        """The model that the user has.

        Raises:
            FitError: the fit cannot be used.
        """
        if self.stale and isinstance(self.start, Model):
            return self.start
        return identification.fit(self.data, self.start, self.level).model


@dataclass(frozen=True)
class Said:
    """The answer to a data set, and which rates it counts for."""

    words: str
    hits: Mapping[str, bool]
    """Bound → whether this set counts as a hit; bounds that do not ask this set are absent."""
    grade: Grade | None = None
    """Where a fault of known size is hidden: the diagnosis, judged."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Further numbers of the record."""


@dataclass(frozen=True)
class Outcome:
    """What came of one set."""

    task: Task
    number: int
    about: str
    said: Said
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """Name by which :func:`replay` makes the set again."""
        return f"{self.task.name}#{self.number}"

    def to_json(self) -> dict[str, Any]:
        """Return one record."""
        out: dict[str, Any] = {
            "set": self.name, "about": self.about, "said": self.said.words, "hits": dict(self.said.hits),
            "seconds": round(self.seconds, 3),
        }  # fmt: skip
        graded = {} if self.said.grade is None else self.said.grade.to_json()
        return out | graded | dict(self.said.figures)


@dataclass(frozen=True)
class Bound:
    """A rate and its limit; `{}` in `what` stands for the variant."""

    what: str
    bound: float = float("nan")
    """NaN: for comparison only."""
    at_most: bool = True
    each: bool = True
    """Whether every variant is held to it by itself."""


@dataclass(frozen=True)
class Row:
    """Data sets of one sort."""

    name: str
    variants: Mapping[str, int]
    """Variant → data sets of the long form."""
    bounds: Mapping[str, Bound]
    sets: Callable[[Task, np.random.Generator], Iterator[Set]]
    """The sets of a task: as many as it says, fewer where one cannot be made."""
    judge: Callable[[Set], Said]
    """What is said of a set; a FitError means that no model can be made, and the set counts for no bound."""
    per_task: int | Callable[[str, int], int] = 5
    """Data sets of one robot and plan, or how many a task has by its variant and number."""
    further: Callable[[Sequence[Outcome]], list[Line]] | None = None
    """Rates that are no shares of single data sets."""

    def size(self, variant: str, number: int) -> int:
        """Return the number of data sets of one task."""
        return self.per_task if isinstance(self.per_task, int) else self.per_task(variant, number)

    def tasks(self, most: int | None = None) -> list[Task]:
        """Return all tasks, or as many as give `most` sets per variant."""
        out = []
        for variant, count in self.variants.items():
            left, number = count if most is None else min(count, most), 0
            while left > 0:
                sets = min(self.size(variant, number), left)
                out.append(Task(self.name, variant, number, sets))
                left, number = left - sets, number + 1
        return out

    def lines(self, outcomes: Sequence[Outcome]) -> list[Line]:
        """Return rates against bounds."""
        out = []
        for variant in self.variants:
            mine = [o for o in outcomes if o.task.variant == variant]
            out += [self._line(key, variant, mine) for key, bound in self.bounds.items() if bound.each]
        out += [self._line(key, "", outcomes) for key, bound in self.bounds.items() if not bound.each]
        return out + (self.further(outcomes) if self.further is not None else [])

    def _line(self, key: str, variant: str, outcomes: Sequence[Outcome]) -> Line:
        bound = self.bounds[key]
        hits = [o.said.hits[key] for o in outcomes if key in o.said.hits]
        name = f"{self.name}.{variant}.{key}" if variant else f"{self.name}.{key}"
        words = bound.what.format(variant.replace("_", " "))
        return Line(name, words, bound.bound, bound.at_most, sum(hits), len(hits))


ROWS = Registry[Row](__name__, "ROW", "row")
names, get = ROWS.names, ROWS.get


def tasks(wanted: Sequence[str], most: int | None = None, robot: str = "") -> list[Task]:
    """Return the tasks of rows (`noise`), of a variant (`noise.correlated`), or of variants that begin alike
    (`hidden.pair`).

    Args:
        robot: text of the robot file for rows of hidden faults.

    Raises:
        InputError: no such row or variant.
    """
    out: list[Task] = []
    for name in wanted:
        row, _, variant = name.partition(".")
        found = get(row)
        some = [v for v in found.variants if v == variant] or [v for v in found.variants if v.startswith(variant)]
        if not some:
            raise InputError(unknown(f"variant of row {row}", variant, found.variants))
        out += [replace(task, robot=robot) for task in found.tasks(most) if task.variant in some]
    return out


def lines(outcomes: Sequence[Outcome]) -> list[Line]:
    """Return the rates of the rows that were run, against their bounds."""
    asked = dict.fromkeys(o.task.row for o in outcomes)
    found = (get(name).lines([o for o in outcomes if o.task.row == name]) for name in asked)
    return [line for some in found for line in some if line.n]


def run(task: Task, seed: int) -> list[Outcome]:
    """Make the data sets of a task, diagnose each, and judge the answers."""
    row, out = get(task.row), []
    for number, made in enumerate(row.sets(task, task.generator(seed))):
        begun = time.perf_counter()
        try:
            said = row.judge(made)
        except FitError as error:
            said = Said(f"no fit: {error.args[0].splitlines()[0]}", {})
        out.append(Outcome(task, number, made.about, said, time.perf_counter() - begun))
    return out


def replay(name: str, seed: int, robot: str = "") -> Set:
    """Return one set by its name.

    Raises:
        InputError: no such set.
    """
    head, _, number = name.rpartition("#")
    kind, _, task = head.rpartition("/")
    row, _, variant = kind.partition(".")
    if not (number.isdigit() and task.isdigit()) or variant not in get(row).variants:
        raise InputError(f"'{name}' names no set", remedy="copy the name from a table, such as noise.white/7#2")
    found = get(row)
    wanted = Task(row, variant, int(task), found.size(variant, int(task)), robot)
    for at, made in enumerate(found.sets(wanted, wanted.generator(seed))):
        if at == int(number):
            return made
    raise InputError(f"'{name}': that task makes no set of this number")
