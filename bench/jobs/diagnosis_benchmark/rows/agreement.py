"""`diagnose`, `explain` and `add` on the same data: whether one says what another denies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import in_words, nothing, one_fault
from bench.jobs.hidden.catalogue import LISTED
from bench.jobs.hidden.design import DESIGNS
from pcalib.diagnosis import steps
from pcalib.diagnosis.diagnose import diagnose
from pcalib.diagnosis.evidence import evidence
from pcalib.errors import EffectError

SIZES = (4.0, 20.0)
"""Range of visible sizes [noise units]."""


def _hidden(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    """Yield sets with a listed fault of some size."""
    for _ in range(task.sets):
        yield one_fault(LISTED, DESIGNS["rich" if rng.random() < 0.6 else "rich-position"], SIZES, rng)


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    yield from (_hidden if task.variant == "hidden" else nothing)(task, rng)


def contradictions(made: Set) -> tuple[str, list[str]]:
    """Return what is said, and each statement of one command that another denies."""
    found = diagnose(made.model, made.data)
    named = found.sets[0].specs if found.verdict == "established" and len(found.sets[0].specs) == 1 else ()
    asked = named or [f.candidate.spec for f in found.findings if f.why is None][:1]
    out = []
    for spec in asked:
        explained = evidence(made.model, made.data, spec)
        if explained.diagnosis.verdict != found.verdict:
            out.append(f"explain {spec} begins from '{explained.diagnosis.verdict}'")
        try:
            fell = steps.add(made.model, made.data, spec).fell
        except EffectError:
            fell = None
            if spec in named:
                out.append(f"add {spec} refuses what diagnose establishes")
        held = explained.held_out
        if spec in named:
            if fell is False:
                out.append(f"add {spec}: no difference beyond chance in held-out rows")
            if not explained.in_range or not explained.finding.adequate:
                out.append(f"explain {spec}: out of range or not adequate")
            if held is not None and held.after >= held.before:
                out.append(f"explain {spec}: held-out errors rise")
        elif found.verdict == "nothing_missing" and fell and held is not None and held.after < 0.81 * held.before:
            out.append(f"add {spec}: held-out errors fall by a tenth or more, where nothing is missing")
    return in_words(found), out


def _judge(made: Set) -> Said:
    said, against = contradictions(made)
    return Said("; ".join([said, *against]), {"contradiction": bool(against)})


ROW = Row(
    "agreement",
    {"hidden": 220, "nothing": 80},
    {"contradiction": Bound("diagnose, explain and add, {}: one denies what another says", 0.0)},
    _sets,
    _judge,
    per_task=4,
)
