"""The whole way: diagnose, add what is named, refit, look at held-out rows, compensate, and land in MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bench.commands import Commands
from bench.jobs.diagnosis_benchmark.rows import Outcome, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import in_words, robot
from bench.jobs.diagnosis_benchmark.rows.hidden import answer_of
from bench.jobs.hidden import case as cases
from bench.jobs.hidden.case import Case
from bench.jobs.hidden.catalogue import CATALOGUE, LISTED
from bench.jobs.hidden.design import BAR, DESIGNS
from bench.jobs.hidden.grading import Grade, Line
from bench.jobs.hidden.stage import Stage
from pcalib import compensation, planning
from pcalib import robot as robots
from pcalib.diagnosis.diagnose import Diagnosis, diagnose
from pcalib.diagnosis.hypothesis import with_effects
from pcalib.fitting import identification
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions

LARGE = 20.0
"""s at which an effect is added and the robot compensated."""
CHECKED = 240
"""Rows held out where their RMS is judged: its own scatter is then 3 %."""
TARGETS = 150
"""TCP targets that a compensated robot is sent to."""
NOISE_FLOOR = 1.1
"""Held-out RMS over the noise floor that an effect may leave once it is added."""
LANDED = 1.5
"""Miss of the compensated robot with the fault over that of the robot without it."""
WHAT = [name for name in LISTED if name != "tracker_drift"]
"""Effects that are added; to the library a drift of the tracker is base drift."""


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    what = CATALOGUE[WHAT[task.number % len(WHAT)]]
    design = replace(DESIGNS["rich"], check=CHECKED, interleaved=True)
    if what.bar:
        design = replace(design, points=BAR)
    nominal = robots.parse(task.robot, "robot") if task.robot else robot("delta")
    there = Stage.draw(design, nominal, int(rng.integers(2**31)), what.companion)
    case = cases.single(there, what, what.draw(nominal, rng), LARGE)
    noise = int(rng.integers(2**31))
    yield Set(there.start, case.measure(noise), f"{what.name}, s {case.facts.size:.1f}", {"case": case, "noise": noise})


def _judge(made: Set) -> Said:
    case, noise = made.truth["case"], made.truth["noise"]
    there, effect = case.stage, case.facts.effects[0]
    nothing = cases.nothing(there)
    before = identification.fit(made.data, made.start)
    found = diagnose(before.model, made.data)
    added = _start(found, effect)
    after = identification.fit(made.data, with_effects(before.model, (added,)))
    clean = nothing.measure(noise)
    bare = identification.fit(clean, made.start)
    absent = replace(added, theta=0.0 * added.theta)
    alike = identification.fit(clean, with_effects(bare.model, (absent,)))
    floor = np.sqrt(3.0) * there.design.sigma_pos
    held = [fit.check.rms_pos / floor if fit.check else np.nan for fit in (before, after, bare)]
    models = after.model, bare.model, alike.model
    ours, best, same = (miss(c, m, noise) for c, m in zip((case, nothing, nothing), models, strict=True))
    figures = dict(zip(("held_out_before", "held_out", "floor"), held, strict=True))
    # The robot without the fault whose fit allows for the effect all the same has as much to find out.
    figures |= {"landed": ours / best, "landed_alike": ours / same}
    return Said(in_words(found), {}, Grade(case.facts, answer_of(found)), figures)


def _start(found: Diagnosis, effect: str) -> FittedEffect:
    """Return the effect in the variant that the diagnosis names, at the values it found; else as it ranks first by
    itself."""
    for explanation in found.sets:
        if explanation.names == (effect,):
            [chosen], [theta] = explanation.members, explanation.theta
            break
    else:
        best = next(f for f in found.findings if f.candidate.name == effect)
        chosen, theta = best.candidate.hypothesis, best.theta
    assert chosen.effect is not None
    low, high = np.array([(p.low, p.high) for p in chosen.effect.parameters]).T
    return FittedEffect(chosen.effect, np.clip(theta, low, high), chosen.spec)


def miss(case: Case, model: Model, seed: int) -> float:
    """Return the RMS distance [m] between targets and where the compensated robot, with its faults in it, puts the TCP.

    Tools, payloads, temperatures, times and directions are those of measured rows, in random order.
    """
    there, rng = case.stage, np.random.default_rng(seed)
    commands = there.plan.commands
    like = commands.take(rng.integers(0, len(commands), TARGETS))
    targets = planning.reachable(there.robot, TARGETS, rng).pose.tcp(like.tool)
    asked = compensation.compensate(model, targets, conditions=Conditions(like.tool, like.payload, like.columns))
    ok = asked.status == "ok"
    some = like.take(ok)
    landing = there.truth(case.hidden).machine().run(Commands(asked.q[ok], some.tool, some.payload, some.columns))
    error = np.linalg.norm(landing.tcp - targets[ok], axis=1)[landing.ok]
    return float(np.sqrt(np.mean(error**2)))


def means(outcomes: Sequence[Outcome]) -> dict[str, dict[str, float]]:
    """Return mean figures by effect, with the size that was hidden and the number of robots."""
    out: dict[str, dict[str, float]] = {}
    graded = [(o.said.grade, o.said.figures) for o in outcomes if o.said.grade is not None]
    for effect in sorted({g.facts.effects[0] for g, _ in graded}):
        mine = [dict(f) | {"s": g.facts.size} for g, f in graded if g.facts.effects == (effect,)]
        out[effect] = {key: float(np.mean([f[key] for f in mine])) for key in mine[0]} | {"robots": len(mine)}
    return out


def _lines(outcomes: Sequence[Outcome]) -> list[Line]:
    found = means(outcomes).values()
    quiet = [f["held_out"] <= NOISE_FLOOR for f in found]
    lands = [f["landed"] <= LANDED for f in found]
    held = f"effects whose held-out RMS, once added at s = {LARGE:g}, is within 10 % of the noise"
    return [
        Line("added.held_out", held, 1.0, False, sum(quiet), len(quiet)),
        Line("added.landed", "effects whose compensated robot lands within 1.5× the miss without the fault", 1.0,
             False, sum(lands), len(lands)),
    ]  # fmt: skip


ROW = Row("added", {"rich": 2 * len(WHAT)}, {}, _sets, _judge, per_task=1, further=_lines)
