"""Rows of the benchmark: one file each, which makes data sets of one sort and judges what is said of them.

A file of this folder that defines ``ROW``, a :class:`Row`, is a row; its name is the file's. Files that start with `_`
hold what several share. A set is named `row.variant/task#number`, for instance `noise.heavy_tails/7#2`: together with
the seed of the run that name fixes every byte of it.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.jobs.hidden.grading import Line
from pcalib.data.measurement import Measurements
from pcalib.errors import FitError, InputError, unknown
from pcalib.model import Model
from pcalib.registry import Registry

STREAM = 0x7EE7


@dataclass(frozen=True)
class Task:
    """A piece of work: one robot and one plan, measured `sets` times."""

    row: str
    variant: str
    number: int
    sets: int

    @property
    def name(self) -> str:
        """Row, variant and number."""
        return f"{self.row}.{self.variant}/{self.number}"

    def generator(self, seed: int) -> np.random.Generator:
        """The random numbers of this task."""
        key = zlib.crc32(f"{self.row}.{self.variant}".encode())
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, key, self.number)))


@dataclass(frozen=True, eq=False)
class Set:
    """One data set, with the model that the user has of the robot."""

    model: Model
    data: Measurements
    about: str
    """What is in it, for a table."""
    truth: Mapping[str, Any]
    """Whatever the judgement needs to know."""


@dataclass(frozen=True)
class Outcome:
    """What was said of one set, and whether that was right."""

    name: str
    about: str
    said: str
    hits: Mapping[str, bool]
    """Bound → whether this set counts as a hit; bounds that do not ask this set are absent."""
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """One record."""
        return {
            "set": self.name, "about": self.about, "said": self.said, "hits": dict(self.hits),
            "seconds": round(self.seconds, 3),
        }  # fmt: skip


@dataclass(frozen=True)
class Bound:
    """A rate that is asked for; `{}` in `what` stands for the variant."""

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
    judge: Callable[[Set], tuple[str, Mapping[str, bool]]]
    """What was said of a set, and its hits by bound."""
    per_task: int = 5
    """Data sets of one robot and plan."""

    def tasks(self, most: int | None = None) -> list[Task]:
        """All tasks, or as many as give `most` sets per variant."""
        out = []
        for variant, count in self.variants.items():
            count = count if most is None else min(count, most)
            for number, start in enumerate(range(0, count, self.per_task)):
                out.append(Task(self.name, variant, number, min(self.per_task, count - start)))
        return out

    def lines(self, outcomes: Sequence[Outcome]) -> list[Line]:
        """Rates against bounds."""
        out = []
        for variant in self.variants:
            mine = [o for o in outcomes if o.name.startswith(f"{self.name}.{variant}/")]
            out += [self._line(key, variant, mine) for key, bound in self.bounds.items() if bound.each]
        return out + [self._line(key, "", outcomes) for key, bound in self.bounds.items() if not bound.each]

    def _line(self, key: str, variant: str, outcomes: Sequence[Outcome]) -> Line:
        bound = self.bounds[key]
        hits = [o.hits[key] for o in outcomes if key in o.hits]
        name = f"{self.name}.{variant}.{key}" if variant else f"{self.name}.{key}"
        words = bound.what.format(variant.replace("_", " "))
        return Line(name, words, bound.bound, bound.at_most, sum(hits), len(hits))


ROWS = Registry[Row](__name__, "ROW", "row")
names, get = ROWS.names, ROWS.get


def tasks(wanted: Sequence[str], most: int | None = None) -> list[Task]:
    """The tasks of rows and of single variants, `noise` or `noise.correlated`.

    Raises:
        InputError: no such row or variant.
    """
    out: list[Task] = []
    for name in wanted:
        row, _, variant = name.partition(".")
        found = get(row)
        if variant and variant not in found.variants:
            raise InputError(unknown(f"variant of row {row}", variant, found.variants))
        out += [task for task in found.tasks(most) if variant in ("", task.variant)]
    return out


def lines(outcomes: Sequence[Outcome]) -> list[Line]:
    """Rates against bounds, of the rows that were asked."""
    asked = dict.fromkeys(o.name.partition(".")[0] for o in outcomes)
    return [
        line
        for name in asked
        for line in get(name).lines([o for o in outcomes if o.name.startswith(f"{name}.")])
        if line.n
    ]


def run(task: Task, seed: int) -> list[Outcome]:
    """Make the sets of a task and judge what is said of them."""
    row, out = get(task.row), []
    for number, made in enumerate(_sets(row, task, seed)):
        begun = time.perf_counter()
        try:
            said, hits = row.judge(made)
        except FitError as error:
            said, hits = f"no fit: {error.args[0].splitlines()[0]}", {}
        out.append(Outcome(f"{task.name}#{number}", made.about, said, hits, time.perf_counter() - begun))
    return out


def replay(name: str, seed: int) -> Set:
    """One set by its name.

    Raises:
        InputError: no such set.
    """
    head, _, number = name.rpartition("#")
    kind, _, task = head.rpartition("/")
    row, _, variant = kind.partition(".")
    if not (number.isdigit() and task.isdigit()) or variant not in get(row).variants:
        raise InputError(f"'{name}' names no set", remedy="copy the name from a table, such as noise.white/7#2")
    found = get(row)
    wanted = Task(row, variant, int(task), found.per_task)
    for at, made in enumerate(_sets(found, wanted, seed)):
        if at == int(number):
            return made
    raise InputError(f"'{name}': that task makes no set of this number")


def _sets(row: Row, task: Task, seed: int) -> Iterator[Set]:
    yield from row.sets(task, task.generator(seed))
