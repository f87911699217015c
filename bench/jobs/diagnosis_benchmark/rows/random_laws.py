"""Laws drawn at random, as far from every pair of listed effects as asked: none of these may be called established."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench import faults
from bench.faults.random_law import RandomLaw
from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import in_words, stage
from bench.jobs.hidden import case as cases
from bench.jobs.hidden.catalogue import Hidden
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import SLACK
from pcalib.diagnosis.diagnose import diagnose
from pcalib.laws.verdict import with_laws

FAR = (8.0, 12.0, 20.0)
"""Distances s⊥ from the nearest pair of listed effects [noise units]."""
TRIES = 12
"""Laws that are tried until one reaches its distance while the tool moves by less than a millimetre."""
LAW = Hidden("random_law", {}, None)


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    there = stage(DESIGNS[task.variant.replace("_", "-")], "delta", rng)
    for number in range(task.sets):
        wanted = FAR[(task.number + number) % len(FAR)]
        for _ in range(TRIES):
            fault = faults.make(there.robot, "random_law", {"scale": 1.0, "seed": int(rng.integers(2**31))})
            case = cases.outside(there, LAW, fault, wanted)
            if case.facts.distance >= SLACK * wanted:
                data = case.measure(int(rng.integers(2**31)))
                [law] = case.hidden
                assert isinstance(law, RandomLaw)
                size = f"s {case.facts.size:.0f}, s⊥ {case.facts.distance:.0f} from {'+'.join(case.nearest)}"
                yield Set(there.robot, data, f"{law.words}; {size}")
                break


def _judge(made: Set) -> Said:
    found = with_laws(diagnose(made.model, made.data))
    hits = {"wrong": bool(found.established), "silent": found.verdict == "nothing_missing"}
    return Said(in_words(found), hits)


ROW = Row(
    "random_laws",
    {"rich": 300, "rich_position": 100},
    {
        "wrong": Bound("random laws, {}, s⊥ ≥ 8: an effect called established", 0.01),
        "silent": Bound("random laws, {}, s⊥ ≥ 8: nothing missing", 0.05),
    },
    _sets,
    _judge,
    per_task=4,
)
