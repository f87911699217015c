"""Measuring and diagnosing again, round after round: how often ten rounds find something where nothing is, and how many
more rows it takes to name an effect than if every round had the limit of the first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bench.jobs.diagnosis_benchmark.rows import Bound, Outcome, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import KINDS, stage
from bench.jobs.hidden.catalogue import CATALOGUE, LISTED
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import Line
from bench.jobs.hidden.stage import Stage
from pcalib.data.joining import join
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.diagnose import diagnose
from pcalib.fitting import identification
from pcalib.laws.verdict import with_laws

ROUNDS = 10
FIRST = replace(DESIGNS["rich"], rows=80, check=20)
LATER = replace(DESIGNS["rich"], rows=24, check=6)
"""Rows of the first round, and of each later one."""
SIZE = (3.0, 6.0)
"""Range of visible sizes [noise units] in the first round; ten rounds have twice as much."""


def _parts(there: Stage, fault: Sequence, rng: np.random.Generator) -> tuple[Measurements, ...]:
    """Return the files of all rounds: the first of `there`, then further poses of the same robot."""
    out, clock = [], 0.0
    for number in range(ROUNDS):
        at = there
        if number:
            plan = Stage.draw(LATER, there.robot, int(rng.integers(2**31))).plan
            at = Stage(LATER, there.robot, there.errors, plan)
        data = at.measure(fault, at.land(fault), int(rng.integers(2**31)))
        time = np.asarray(data.columns["time"], float) + clock
        clock = float(time.max()) + 10.0
        out.append(replace(data, columns={**data.columns, "time": time}))
    return tuple(out)


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    hidden = task.variant == "hidden"
    kind = "delta" if hidden else KINDS[task.number % len(KINDS)]
    there = stage(FIRST, kind, rng)
    fault, name = (), "nothing"
    if hidden:
        usable = [CATALOGUE[n] for n in LISTED if not CATALOGUE[n].companion and not CATALOGUE[n].bar]
        what = usable[rng.integers(len(usable))]
        size = float(np.exp(rng.uniform(*np.log(SIZE))))
        sized = there.scaled(what.draw(there.robot, rng), size, what.effect)
        fault, name = (sized.fault,), str(what.effect)
    parts = _parts(there, fault, rng)
    yield Set(there.robot, parts[0], f"{kind}, {name}", {"parts": parts, "effect": name if hidden else ""})


def _judge(made: Set) -> Said:
    parts, effect = made.truth["parts"], made.truth["effect"]
    if effect:
        spent, unspent = (_rows_until(made, parts, effect, counted) for counted in (True, False))
        words = f"{effect} named after {spent} rows, {unspent} if every round were the first"
        return Said(words, {}, figures={"rows": spent, "rows_unspent": unspent})
    alarms = [_alarm(made, joined) for joined in (join(parts[: n + 1]) for n in range(ROUNDS))]
    return Said(f"{sum(alarms)} of {ROUNDS} rounds find something", {"first": alarms[0], "any": any(alarms)})


def _alarm(made: Set, data: Measurements) -> bool:
    found = with_laws(diagnose(identification.fit(data, made.start).model, data))
    return found.verdict != "nothing_missing"


def _rows_until(made: Set, parts: Sequence[Measurements], effect: str, counted: bool) -> int:
    """Return the rows after which the effect is named, alone or beside rivals; all of them where it never is."""
    data = parts[0]
    for n in range(ROUNDS):
        data = join(parts[: n + 1])
        asked = data if counted else replace(data, rounds=1)
        found = diagnose(identification.fit(asked, made.start).model, asked)
        if any(effect in e.names for e in found.sets):
            break
    return len(data)


def _effort(outcomes: Sequence[Outcome]) -> list[Line]:
    figures = [o.said.figures for o in outcomes if o.task.variant == "hidden"]
    rows, unspent = (int(sum(f[key] for f in figures)) for key in ("rows", "rows_unspent"))
    words = "more rows until an effect is named, because later rounds have stricter limits than the first"
    return [Line("rounds.effort", words, 0.10, True, max(rows - unspent, 0), unspent)] if figures else []


ROW = Row(
    "rounds",
    {"nothing": 100, "hidden": 60},
    {
        "first": Bound("nothing hidden, the first of ten rounds: something found", 0.05, each=False),
        "any": Bound("nothing hidden, ten rounds: something found in any", 0.05, each=False),
    },
    _sets,
    _judge,
    per_task=1,
    further=_effort,
)
