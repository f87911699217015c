"""One cell of the benchmark: hide, measure, fit, diagnose; of `add` also refit, compensate and land in MuJoCo."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.commands import Commands
from bench.jobs.diagnosis_benchmark.cells import Cell
from bench.jobs.hidden import case as cases
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.case import Case
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.design import BAR, DESIGNS
from bench.jobs.hidden.grading import SLACK, Answer, Facts, Grade
from bench.jobs.hidden.stage import Stage
from pcalib import compensation, planning
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.diagnose import Diagnosis, diagnose
from pcalib.diagnosis.hypothesis import with_effects
from pcalib.errors import FitError
from pcalib.fitting import identification
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot

STREAM = 0xBE7C
TRIES = 20
CHECKED = 240
"""Rows held out where their RMS is judged: its own scatter is then 3 %."""
TARGETS = 150
"""TCP targets that a compensated robot is sent to."""


@dataclass(frozen=True)
class Trial:
    """One data set and what was made of it."""

    cell: Cell
    wanted: float
    """Size asked for."""
    grade: Grade
    source: str = ""
    """Where the noise level came from."""
    seconds: float = 0.0
    """Time of the diagnosis."""
    held_out: float = float("nan")
    """RMS position error of held-out rows after `add`, over the instrument's noise."""
    held_out_before: float = float("nan")
    """The same before."""
    floor: float = float("nan")
    """The same of the robot without the fault."""
    landed: float = float("nan")
    """RMS miss of the compensated robot in MuJoCo over that of the robot without the fault, each calibrated."""
    landed_alike: float = float("nan")
    """The same over the robot without the fault whose fit allows for the effect all the same: what is left of the
    ratio when both models have as much to find out."""

    def to_json(self) -> dict[str, Any]:
        """One record."""
        g = self.grade
        out: dict[str, Any] = {
            "cell": self.cell.number, "part": self.cell.part, "design": self.cell.design, "kind": g.facts.kind,
            "truth": list(g.facts.effects), "faults": list(g.facts.faults), "wanted": self.wanted, "s": g.facts.size,
            "s_outside": g.facts.distance, "verdict": g.answer.verdict, "established": list(g.answer.established),
            "adequate": [list(names) for names in g.answer.adequate], "grade": g.words, "noise": self.source,
            "seconds": round(self.seconds, 3),
        }  # fmt: skip
        if self.cell.part == "add":
            out |= {
                "held_out": self.held_out, "held_out_before": self.held_out_before, "floor": self.floor,
                "landed": self.landed, "landed_alike": self.landed_alike,
            }  # fmt: skip
        return out


def run(robot: Robot, seed: int, cell: Cell) -> list[Trial]:
    """All trials of a cell; seed and the cell's number fix them."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, cell.number)))
    design = DESIGNS[cell.design]
    if cell.part == "add":
        design = replace(design, check=CHECKED, interleaved=True)
        if any(CATALOGUE[name].bar for name in cell.what):
            design = replace(design, points=BAR)
    companion = any(CATALOGUE[name].companion for name in cell.what)
    if cell.named and "gear_ripple" in cell.what:
        robot = naming_its_gears(robot)
    stage = Stage.draw(design, robot, int(rng.integers(2**31)), companion)
    out = []
    for wanted, case in _cases(stage, cell, rng):
        for _ in range(cell.noises):
            noise = int(rng.integers(2**31))
            trial = _added if cell.part == "add" else _diagnosed
            out.append(trial(cell, wanted, case, noise))
    return out


def naming_its_gears(robot: Robot) -> Robot:
    """The robot with a file that says how often its gears ripple per turn."""
    cycles = CATALOGUE["gear_ripple"].typical["cycles_per_rev"]
    return robots.parse(f"{robot.text}\n[drive]\nripple_per_turn = [{cycles:g}]\n", f"{robot.name}.toml")


def _cases(stage: Stage, cell: Cell, rng: np.random.Generator) -> Iterator[tuple[float, Case]]:
    """One case per size; none for sizes that a fault cannot reach."""
    if cell.part == "none":
        yield 0.0, cases.nothing(stage)
        return
    if cell.part == "pair":
        for wanted in cell.sizes:
            if (case := _pair(stage, wanted, rng)) is not None:
                yield wanted, case
        return
    what = CATALOGUE[cell.what[0]]
    fault = what.draw(stage.robot, rng, cell.uneven)
    for wanted in cell.sizes:
        if cell.part == "outside":
            without = what.effect if cell.without else None
            case = cases.outside(stage, what, fault, wanted, without)
            reached = case.facts.distance
        else:
            case = cases.single(stage, what, fault, wanted)
            reached = case.facts.size
        if reached >= SLACK * wanted or cell.part == "add":
            yield wanted, case


def _pair(stage: Stage, wanted: float, rng: np.random.Generator) -> Case | None:
    names = [name for name in catalogue.LISTED if not CATALOGUE[name].companion]
    for _ in range(TRIES):
        both = [CATALOGUE[str(name)] for name in rng.choice(names, 2, replace=False)]
        drawn = [what.draw(stage.robot, rng, bool(rng.random() < 0.3)) for what in both]
        if both[0].effect != both[1].effect:
            case = cases.pair(stage, both, drawn, wanted)
            if case is not None:
                return case
    return None


def _fitted(stage: Stage, data: Measurements) -> Model:
    return identification.fit(data, stage.robot, "complete", effects=stage.effects).model


def _diagnosed(cell: Cell, wanted: float, case: Case, noise: int) -> Trial:
    data = case.measure(noise)
    try:
        model = _fitted(case.stage, data)
        begun = time.perf_counter()
        found = _diagnose(model, data, cell, case.facts)
    except FitError:
        return Trial(cell, wanted, Grade(case.facts, Answer("no_fit", (), ())))
    seconds = time.perf_counter() - begun
    return Trial(cell, wanted, Grade(case.facts, answer_of(found)), found.noise.source, seconds)


def _diagnose(model: Model, data: Measurements, cell: Cell, facts: Facts) -> Diagnosis:
    without = (str(CATALOGUE[facts.faults[0]].effect),) if cell.without else ()
    return diagnose(model, data, without=without) if without else diagnose(model, data)


def answer_of(found: Diagnosis) -> Answer:
    """What a diagnosis says, as it would stand in its JSON."""
    return Answer(found.verdict, tuple(sorted(found.established)), tuple(tuple(sorted(e.names)) for e in found.sets))


def _added(cell: Cell, wanted: float, case: Case, noise: int) -> Trial:
    """The whole way: diagnose, add what is named, refit, look at held-out rows, compensate and land."""
    stage, effect = case.stage, case.facts.effects[0]
    data = case.measure(noise)
    try:
        before = identification.fit(data, stage.robot, "complete", effects=stage.effects)
        begun = time.perf_counter()
        found = diagnose(before.model, data)
        seconds = time.perf_counter() - begun
        added = _start(found, effect)
        after = identification.fit(data, with_effects(before.model, (added,)), "complete")
        clean = cases.nothing(stage).measure(noise)
        bare = identification.fit(clean, stage.robot, "complete", effects=stage.effects)
        absent = replace(added, theta=0.0 * added.theta)
        alike = identification.fit(clean, with_effects(bare.model, (absent,)), "complete")
        models = after.model, bare.model, alike.model
    except FitError:
        return Trial(cell, wanted, Grade(case.facts, Answer("no_fit", (), ())))
    floor = np.sqrt(3.0) * stage.design.sigma_pos
    held = [fit.check.rms_pos / floor if fit.check else np.nan for fit in (after, before, bare)]
    nothing = cases.nothing(stage)
    ours, best, same = (miss(c, m, noise) for c, m in zip((case, nothing, nothing), models, strict=True))
    return Trial(
        cell, wanted, Grade(case.facts, answer_of(found)), found.noise.source, seconds,
        held_out=held[0], held_out_before=held[1], floor=held[2], landed=ours / best, landed_alike=ours / same,
    )  # fmt: skip


def _start(found: Diagnosis, effect: str) -> FittedEffect:
    """The effect in the variant that the diagnosis names, at the values it found; else as it ranks first by itself."""
    for explanation in found.sets:
        if explanation.names == (effect,):
            [chosen], [theta] = explanation.members, explanation.theta
            break
    else:
        best = next(f for f in found.findings if f.candidate.name == effect)
        chosen, theta = best.candidate.hypothesis, best.theta
    assert chosen.effect is not None
    low, high = ([getattr(p, end) for p in chosen.effect.parameters] for end in ("low", "high"))
    return FittedEffect(chosen.effect, np.clip(theta, low, high), chosen.spec)


def miss(case: Case, model: Model, seed: int) -> float:
    """[m] RMS distance between targets and where the compensated robot, with its faults in it, puts the TCP.

    Tools, payloads, temperatures, times and directions are those of measured rows, in random order.
    """
    stage, rng = case.stage, np.random.default_rng(seed)
    commands = stage.plan.commands
    row = rng.integers(0, len(commands), TARGETS)
    tool, payload = commands.tool[row], commands.payload[row]
    columns = {name: values[row] for name, values in commands.columns.items()}
    targets = planning.reachable(stage.robot, TARGETS, rng).pose.tcp(tool)
    asked = compensation.compensate(model, targets, conditions=Conditions(tool, payload, columns))
    ok = asked.status == "ok"
    there = Commands(asked.q[ok], tool[ok], payload[ok], {name: values[ok] for name, values in columns.items()})
    landing = stage.truth(case.hidden).machine().run(there)
    error = np.linalg.norm(landing.tcp - targets[ok], axis=1)[landing.ok]
    return float(np.sqrt(np.mean(error**2)))
