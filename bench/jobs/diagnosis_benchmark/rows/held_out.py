"""Data whose held-out rows say that something is missing: "nothing is missing" must not be the answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from bench import faults
from bench import truth as truths
from bench.commands import Commands
from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import KINDS, held_out, in_words, one_fault, stage
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.stage import SIGMA_ANGLE, SIGMA_LENGTH, Stage
from pcalib.diagnosis.diagnose import diagnose

RICH = DESIGNS["rich"]
SIZES = (20.0, 80.0)
"""Range of visible sizes [noise units] of misfits."""
LOUD = 1.5
"""Times the noise from which held-out rows have to be heard."""
CONDITIONS = {
    "warm_check_rows": ("thermal_rods", {"expansion_ppm_K": 12.0}, ("temp_arms", "temp_rods", "temp_base"), 20.0, 32.0),
    "heavy_check_rows": ("drive_compliance", {"compliance_urad_Nm": 40.0}, ("payload",), 0.0, 2.0),
}
"""Variant → fault, its settings, the columns that only held-out rows change, and their values in rows to fit and to
check."""


def _stale(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    """Yield data of a robot with the model of another, or of the same before one part was replaced."""
    kind = KINDS[task.number % len(KINDS)]
    there = stage(RICH, kind, rng)
    model = Set(there.robot, there.measure((), there.reference, int(rng.integers(2**31))), kind).model
    for number in range(task.sets):
        errors = there.errors.copy()
        if number % 2:
            errors[rng.integers(len(errors))] += rng.choice([-1, 1]) * 3 * SIGMA_LENGTH
            about = f"{kind}, one parameter changed"
        else:
            errors = truths.draw_errors(there.robot, SIGMA_LENGTH, SIGMA_ANGLE, int(rng.integers(2**31)))
            about = f"{kind}, another robot"
        now = Stage(there.design, there.robot, errors, there.plan)
        yield Set(model, now.measure((), now.land(), int(rng.integers(2**31))), about, stale=True)


def _outliers(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    """Yield data of which one row in twenty-five is grossly wrong; the fit takes them all."""
    kind = KINDS[task.number % len(KINDS)]
    size = float(np.exp(rng.uniform(np.log(3e-4), np.log(5e-3))))
    there = stage(replace(RICH, instrument_settings={"outliers": 0.04, "outlier_size": size}), kind, rng)
    for _ in range(task.sets):
        made = there.measured((), there.reference, int(rng.integers(2**31)))
        good = ~np.isin(made.kept, made.outlier)
        yield Set(there.robot, made.measurements, f"{kind}, outliers of {size * 1e3:.1f} mm", {"good": good})


def _elsewhere(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    """Yield rows to fit under one condition, held-out rows under another, and a fault that only the change shows."""
    name, table, columns, fit, check = CONDITIONS[task.variant]
    kind = ("delta", "hexa", "h4", "delta")[task.number % 4]
    there = stage(RICH, kind, rng)
    commands, held = there.plan.commands, there.plan.check
    value = np.where(held, check, fit)
    payload = value if "payload" in columns else commands.payload
    changed = dict(commands.columns) | {c: value for c in columns if c != "payload"}
    there = replace(
        there, plan=replace(there.plan, commands=Commands(commands.q, commands.tool, payload, changed))
    )
    fault = catalogue.scaled(faults.make(there.robot, name, table), float(rng.uniform(0.5, 2.0)))
    landing = there.land([fault])
    for _ in range(task.sets):
        data = there.measure([fault], landing, int(rng.integers(2**31)))
        yield Set(there.robot, data, f"{kind}, {name}")


def _misfits(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    """Yield sets with listed and unlisted faults that can be seen."""
    for _ in range(task.sets):
        yield one_fault(list(CATALOGUE), RICH, SIZES, rng)


MAKERS: Mapping[str, Callable[[Task, np.random.Generator], Iterator[Set]]] = {
    "stale_model": _stale, "outliers": _outliers, "warm_check_rows": _elsewhere, "heavy_check_rows": _elsewhere,
    "misfits": _misfits,
}  # fmt: skip


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    yield from MAKERS[task.variant](task, rng)


def _judge(made: Set) -> Said:
    times = held_out(made.model, made.data, RICH.sigma_pos, made.truth.get("good"))
    if not times > LOUD:
        return Said(f"{times:.2f} × the noise", {})
    found = diagnose(made.model, made.data)
    return Said(f"{times:.2f} × the noise; {in_words(found)}", {"silent": found.verdict == "nothing_missing"})


ROW = Row(
    "held_out",
    dict.fromkeys(MAKERS, 130),
    {"silent": Bound("{}, held-out rows off by > 1.5 × the noise: verdict nothing missing", 0.0)},
    _sets,
    _judge,
)
