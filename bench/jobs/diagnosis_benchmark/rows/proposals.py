"""`pcalib propose` on laws that no one has listed: whether the right one comes first, and what it is good for."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench import faults
from bench.faults.random_law import RandomLaw
from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._peers import NAMING, Columns, process
from bench.jobs.diagnosis_benchmark.rows._shared import held_out, nothing, stage
from bench.jobs.diagnosis_benchmark.rows.added import LANDED, NOISE_FLOOR, miss
from bench.jobs.hidden import case as cases
from bench.jobs.hidden.case import Case
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import Facts
from pcalib.diagnosis import steps
from pcalib.diagnosis.problem import problem
from pcalib.effects import user
from pcalib.errors import EffectError
from pcalib.laws import telling
from pcalib.laws.proposal import ALIKE, Family, Proposals
from pcalib.laws.search import propose

SIZES = (10.0, 40.0)
"""Visible sizes, noise units, log-uniform."""
DESIGN = replace(DESIGNS["rich"], check=120, interleaved=True)
"""As many rows held out as fitted: the RMS of their errors then scatters by 4 %."""
FIRST, NEAR = 5, 1.25
SEED = 11
"""Of the noise of the robot without the law, and of the targets."""
CHANNELS = {
    "motor": "actuator", "rod": "rod", "pair": "pair", "elbow": "elbow", "plate_anchor": "plate", "tool_point": "tool",
    "tool_turn": "tool", "base_shift": "base", "base_turn": "base",
}  # fmt: skip
"""Channel of a random law → that of a proposal."""
VARIABLES = {"neighbour": {"q"}, "direction": {"dir"}, "load": {"torque", "tension"}, "tool": {"tool_length"}}
"""Variable of a random law → names in a proposal, where they differ."""


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    if task.variant == "nothing":
        yield from nothing(task, rng)
        return
    there = stage(DESIGN, "delta", rng)
    plain = task.variant == "plain_laws"
    for _ in range(task.sets):
        settings = {"scale": 1.0, "seed": int(rng.integers(2**31)), "plain": plain}
        fault = faults.make(there.robot, "random_law", settings)
        sized = there.scaled(fault, float(np.exp(rng.uniform(*np.log(SIZES)))))
        if sized.capped:
            continue
        data = there.measure([sized.fault], there.land([sized.fault]), int(rng.integers(2**31)))
        assert isinstance(sized.fault, RandomLaw)
        about = f"{sized.fault.words}; s {sized.size:.0f}"
        case = Case(there, (sized.fault,), Facts((), ("random_law",), sized.size))
        yield Set(there.robot, data, about, {"case": case, "laws": sized.fault.laws, "plain": plain})


def _right(made: Set, channel: str, variables: Collection[str]) -> bool:
    """Return whether that is the true channel, and the true variable among those named."""
    [law] = made.truth["laws"]
    [term] = law.terms
    wanted = VARIABLES.get(term.variable, {term.variable})
    return channel == CHANNELS[law.channel] and bool(wanted & set(variables))


def _holds(family: Family, made: Set) -> bool:
    """Return whether a class has a right member."""
    told = (law for member in family.members for law in member.laws)
    return any(_right(made, law.channel.name, [s.variable.name for s in law.term.variables]) for law in told)


def _peers(made: Set, columns: Columns) -> dict[str, bool]:
    """Return what other methods make of the same columns: the right law first; or, with nothing hidden, any law at
    all."""
    out = {}
    for name, method in NAMING.items():
        chosen = method(columns.values, columns.y)
        if not made.truth:
            out[f"{name}_proposed"] = len(chosen) > 0
        else:
            out[f"{name}_first"] = len(chosen) > 0 and _like_a_right_one(made, columns, int(chosen[0]))
    return out


def _like_a_right_one(made: Set, columns: Columns, first: int) -> bool:
    """Return whether the data cannot tell a column from a right one: peers are given the aliases that a class has."""
    named = zip(columns.channel, columns.variables, strict=True)
    right = np.array([_right(made, str(channel), variables) for channel, variables in named])
    chosen = columns.values[:, first]
    cosine = np.abs(columns.values[:, right].T @ chosen).max(initial=0.0)
    return bool(abs(chosen @ columns.y) * np.sqrt(max(2 - 2 * cosine, 0.0)) < ALIKE)


def _judged(made: Set, found: Proposals) -> tuple[float, float]:
    """Return what the first class is good for once it is in the model; NaN where it cannot be added.

    Returns:
        Held-out RMS over the noise; and, for a plain law, the miss of the compensated robot in MuJoCo, with the law in
        it, over that of the robot without it, each calibrated.
    """
    case = made.truth["case"]
    with tempfile.TemporaryDirectory() as folder:
        only = replace(found, families=found.families[:1])
        model = made.model
        try:
            for spec in telling.write(only, Path(folder), "data.csv"):
                effect = user.load(spec, model.robot)
                model = steps.add(model, made.data, spec, [effect]).after.model
        except EffectError:
            return float("nan"), float("nan")
        held = held_out(model, made.data, DESIGN.sigma_pos)
        if not made.truth["plain"]:
            return held, float("nan")
        without = cases.nothing(case.stage)
        best = Set(case.stage.robot, without.measure(SEED), "nothing").model
        return held, miss(case, model, SEED) / miss(without, best, SEED)


def _judge(made: Set) -> Said:
    asked = problem(made.model, made.data)
    found = propose(asked)
    if not made.truth:
        return Said(telling.sentence(found), {"proposed": bool(found.families)} | _peers(made, Columns.of(asked)))
    if made.truth["plain"]:
        others = _peers(made, Columns.of(asked))
    else:
        others = {"process_useful": process(made.model, made.data, DESIGN.sigma_pos) <= NEAR}
    if not found.families:
        missed = {"first": False, "five": False} if made.truth["plain"] else {"useful": True}
        return Said(telling.sentence(found), missed | others)
    after, landed = _judged(made, found)
    said = f"{found.families[0].first.words()}; held-out {after:.2f} × the noise"
    if not made.truth["plain"]:
        honest = not found.families[0].first.adequate  # the sentence then begins with "No law … explains all"
        return Said(said, {"useful": honest or after <= NEAR} | others)
    right = [_holds(family, made) for family in found.families[:FIRST]]
    useful = {"floor": after <= NOISE_FLOOR, "lands": landed <= LANDED}
    return Said(said, {"first": right[0], "five": any(right)} | useful | others)


ROW = Row(
    "proposals",
    {"plain_laws": 80, "random_laws": 60, "nothing": 60},
    {
        "proposed": Bound("{}: a law proposed", 0.05),
        "first": Bound("{}, s ≥ 10: true channel and variable in the first class", 0.80, at_most=False),
        "five": Bound("{}, s ≥ 10: true channel and variable among the first five classes", 0.95, at_most=False),
        "floor": Bound("{}: held-out rows within 10 % of the noise once the first is added", 0.85, at_most=False),
        "lands": Bound("{}: with it, the compensated robot lands within 1.5× the miss without it", 0.80, at_most=False),
        "useful": Bound("{}: no law said to explain all, or held-out within 25 % of the noise", 0.60, at_most=False),
        **{f"{name}_proposed": Bound(f"{{}}, {name}: a law proposed") for name in NAMING},
        **{f"{name}_first": Bound(f"{{}}, {name}: the right law first", at_most=False) for name in NAMING},
        "process_useful": Bound("{}, Gaussian process: held-out rows within 25 % of the noise", at_most=False),
    },
    _sets,
    _judge,
    per_task=4,
)
