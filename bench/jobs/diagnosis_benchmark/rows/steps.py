"""Steps in the middle of a session: a tracker that is bumped, a motor whose zero slips."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench import faults
from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import KINDS, in_words, stage
from bench.jobs.hidden.design import DESIGNS
from pcalib.diagnosis.diagnose import Diagnosis, diagnose

SIZES = (6.0, 20.0)
"""Visible sizes, noise units, log-uniform."""
PLACES = (0.15, 0.85)
"""Share of the rows to fit that come before the step."""
NEAR = 1
"""Rows by which the row that is named may be wrong."""
CHANNELS = {"tracker_bump": "body", "motor_slip": "actuator"}
"""Fault → channel of the map that it belongs to."""


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    kind = KINDS[task.number % len(KINDS)]
    for _ in range(task.sets):
        there = stage(DESIGNS["rich"], kind, rng)
        rows = int((~there.plan.check).sum())
        row = int(rng.uniform(*PLACES) * rows)
        q = there.plan.commands.q
        while row + 1 < rows and (q[row] == q[row - 1]).all():
            row += 1  # not between two replicates, which would be told at once
        if task.variant == "tracker_bump":
            table = {
                "shift_um": list(50 * rng.standard_normal(3)), "turn_urad": list(50 * rng.standard_normal(3)),
                "row": row + 1,
            }  # fmt: skip
            motor = -1
        else:
            motor = int(rng.integers(q.shape[1]))
            unit, size = ("urad", 160.0) if there.robot.mechanism.actuator_dimension == "angle" else ("um", 40.0)
            slips = np.where(np.arange(q.shape[1]) == motor, size * rng.choice([-1, 1]), 0.0)
            table = {f"slip_{unit}": list(slips), "row": row + 1}
        fault = faults.make(there.robot, task.variant, table)
        wanted = float(np.exp(rng.uniform(*np.log(SIZES))))
        sized = there.scaled(fault, wanted)
        if sized.capped:
            continue
        made = there.measured([sized.fault], there.land([sized.fault]), int(rng.integers(2**31)))
        truth = {"fault": task.variant, "row": int(np.sum(made.kept < row)), "motor": motor}
        about = f"{kind}, row {row + 1}, s {sized.size:.1f}" + (f", motor {motor + 1}" if motor >= 0 else "")
        yield Set(there.robot, made.measurements, about, truth)


def told(found: Diagnosis) -> tuple[str, int, int | None]:
    """Return (channel, motor or −1, index of the first row after the step or None) that a diagnosis names."""
    cell = (*found.events, *found.cells)[0]
    if cell.found is None:
        return cell.channel, -1, None
    kept = np.setdiff1d(np.arange(len(found.problem.given)), found.problem.set_aside)
    return cell.channel, cell.found.member, int(kept[cell.found.row])


def _judge(made: Set) -> Said:
    found = diagnose(made.model, made.data)
    channel, motor, row = told(found)
    alarm = found.verdict != "nothing_missing"
    right = alarm and channel == CHANNELS[made.truth["fault"]] and motor in (-1, made.truth["motor"])
    near = row is not None and abs(row - made.truth["row"]) <= NEAR
    hits = {"channel": right, "row": near, "wrong": bool(found.established)}
    return Said(f"{in_words(found)}; {channel}, row {row}", hits)


ROW = Row(
    "steps",
    {"tracker_bump": 100, "motor_slip": 100},
    {
        "channel": Bound("{} of 6–20 noise units: the right channel named", 0.90, at_most=False),
        "row": Bound("{} of 6–20 noise units: its row named, give or take one", 0.85, at_most=False),
        "wrong": Bound("{}: an effect called established", 0.02),
    },
    _sets,
    _judge,
    per_task=2,
)
