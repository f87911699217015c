"""Faults hidden by MuJoCo at known visible sizes: one effect, two effects, or something that no library lists."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from bench.jobs.diagnosis_benchmark.rows import Bound, Row, Said, Set, Task
from bench.jobs.diagnosis_benchmark.rows._shared import in_words, robot
from bench.jobs.hidden import case as cases
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.case import Case
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import CLEAR, SLACK, Answer, Grade
from bench.jobs.hidden.grading import FAR as APART
from bench.jobs.hidden.stage import Stage, suits
from pcalib import robot as robots
from pcalib.diagnosis.diagnose import Diagnosis, diagnose
from pcalib.errors import FitError
from pcalib.laws.verdict import with_laws
from pcalib.robot import Robot

CURVE = (6.0, 3.0, 4.0, 5.0, 8.0, 12.0, 20.0)
"""Sizes s of the power curve, that of the bound first."""
FAR = (8.0, 12.0, 20.0)
"""Sizes s⊥ of pairs and of faults that no library lists."""
NEAR = (0.95, 1.1)
"""s over the wanted 6 that counts as 6."""
PLAUSIBLE = 3.0
"""Usual sizes up to which a fault is one that robots have."""
TRIES = 20
"""Pairs that are drawn until one is no single effect's."""
ROBOTS = {"rich": 4, "rich-position": 3, "plain": 2, "plain-position": 2, "ballbar": 1, "tracker": 1}
"""Design → robots in which each listed effect is hidden at all sizes of the curve."""
MISSTATED = ("rich-understated", "rich-overstated")
PAIRS = {"rich": 100, "rich-position": 40, "rich-overstated": 20}


@dataclass(frozen=True)
class Cell:
    """One robot with one thing to find."""

    part: str
    """'single', 'pair' or 'outside'."""
    design: str
    what: str = ""
    """Name of the catalogue; empty for a pair, which is drawn."""
    sizes: tuple[float, ...] = ()
    uneven: bool = False
    """Whether arms differ."""
    named: bool = False
    """Whether the robot file names the cycles per turn of its gears; else a ripple has to be searched for."""
    without: bool = False
    """Whether the truth is taken out of the library, which makes it something that no library lists."""

    @property
    def variant(self) -> str:
        """Part and design."""
        return f"{self.part}_{self.design.replace('-', '_')}"


@cache
def cells() -> dict[str, list[Cell]]:
    """Return the cells of every variant, in a fixed order."""

    def suited(design: str) -> list[str]:
        return [name for name in catalogue.LISTED if suits(CATALOGUE[name], DESIGNS[design], robot("delta"))]

    made: list[Cell] = []
    for design, count in ROBOTS.items():
        for name in suited(design):
            made += [Cell("single", design, name, CURVE, i % 3 == 2, i % 2 == 0) for i in range(count)]
    made += [Cell("single", design, name, (6.0, 12.0)) for design in MISSTATED for name in suited(design)]
    for design, count in PAIRS.items():
        made += [Cell("pair", design, sizes=(FAR[i % 2],)) for i in range(count)]
    for design in ("rich", "rich-position"):
        made += [Cell("outside", design, name, FAR) for name in catalogue.UNLISTED for _ in range(4)]
        taken = [n for n in suited(design) if not CATALOGUE[n].companion and n != "tracker_drift"]
        made += [Cell("outside", design, name, FAR, without=True) for name in taken]
    out: dict[str, list[Cell]] = {}
    for cell in made:
        out.setdefault(cell.variant, []).append(cell)
    return out


def naming_its_gears(nominal: Robot) -> Robot:
    """Return the robot with a file that says how often its gears ripple per turn."""
    cycles = CATALOGUE["gear_ripple"].typical["cycles_per_rev"]
    return robots.parse(f"{nominal.text}\n[drive]\nripple_per_turn = [{cycles:g}]\n", f"{nominal.name}.toml")


def _sets(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    cell = cells()[task.variant][task.number]
    nominal = robots.parse(task.robot, "robot") if task.robot else robot("delta")
    if cell.named and cell.what == "gear_ripple":
        nominal = naming_its_gears(nominal)
    companion = bool(cell.what) and CATALOGUE[cell.what].companion
    there = Stage.draw(DESIGNS[cell.design], nominal, int(rng.integers(2**31)), companion)
    for wanted, case in _cases(there, cell, cell.sizes[: task.sets], rng):
        about = f"{' + '.join(case.facts.faults)}, s {case.facts.size:.1f}, s⊥ {case.facts.distance:.1f}"
        truth = {"case": case, "wanted": wanted, "cell": cell}
        yield Set(there.start, case.measure(int(rng.integers(2**31))), about, truth)


def _cases(
    there: Stage, cell: Cell, sizes: Sequence[float], rng: np.random.Generator
) -> Iterator[tuple[float, Case]]:
    """Yield one case per size; none for sizes that a fault cannot reach."""
    if cell.part == "pair":
        for wanted in sizes:
            if (case := _pair(there, wanted, rng)) is not None:
                yield wanted, case
        return
    what = CATALOGUE[cell.what]
    fault = what.draw(there.robot, rng, cell.uneven)
    for wanted in sizes:
        if cell.part == "outside":
            case = cases.outside(there, what, fault, wanted, what.effect if cell.without else None)
            reached = case.facts.distance
        else:
            case = cases.single(there, what, fault, wanted)
            reached = case.facts.size
        if reached >= SLACK * wanted:
            yield wanted, case


def _pair(there: Stage, wanted: float, rng: np.random.Generator) -> Case | None:
    names = [name for name in catalogue.LISTED if not CATALOGUE[name].companion]
    for _ in range(TRIES):
        both = [CATALOGUE[str(name)] for name in rng.choice(names, 2, replace=False)]
        drawn = [what.draw(there.robot, rng, bool(rng.random() < 0.3)) for what in both]
        if both[0].effect != both[1].effect:
            case = cases.pair(there, both, drawn, wanted)
            if case is not None:
                return case
    return None


def answer_of(found: Diagnosis) -> Answer:
    """Return what a diagnosis says, as it would stand in its JSON."""
    return Answer(found.verdict, tuple(sorted(found.established)), tuple(tuple(sorted(e.names)) for e in found.sets))


def _judge(made: Set) -> Said:
    cell, case = made.truth["cell"], made.truth["case"]
    try:
        without = (str(CATALOGUE[cell.what].effect),) if cell.without else ()
        found = with_laws(diagnose(made.model, made.data, without=without))
        grade, words = Grade(case.facts, answer_of(found)), in_words(found)
    except FitError:
        grade, words = Grade(case.facts, Answer("no_fit", (), ())), "no fit"
    facts = case.facts
    hits = {"false_established": bool(grade.wrong)}
    if cell.part == "single":
        if grade.alarm and facts.size >= SLACK * CLEAR:
            hits["inside"] = grade.inside
        if NEAR[0] * CLEAR <= facts.size <= NEAR[1] * CLEAR:
            hits["found_at_6"] = grade.found
            hits["found_at_6_usual" if case.usual <= PLAUSIBLE else "found_at_6_large"] = grade.found
    elif facts.distance >= SLACK * APART:
        if cell.part == "pair":
            hits["pairs"] = grade.inside
        else:
            hits["taken_out" if cell.without else "outside"] = grade.unexplained
    return Said(words, hits, grade, {"wanted": made.truth["wanted"], "usual_sizes": case.usual})


def _bound(what: str, bound: float = float("nan"), at_most: bool = False) -> Bound:
    return Bound(what, bound, at_most, each=False)


ROW = Row(
    "hidden",
    {variant: sum(len(cell.sizes) for cell in some) for variant, some in cells().items()},
    {
        "inside": _bound("single effect, s ≥ 6, something found: truth among the adequate sets", 0.93),
        "found_at_6": _bound("single effect at s = 6: established, or fairly A or B", 0.90),
        "found_at_6_usual": _bound(f"the same, where 6 noise units are {PLAUSIBLE:g} usual sizes or less"),
        "found_at_6_large": _bound("the same, where they are more"),
        "false_established": _bound("an effect called established that is not there", 0.02, at_most=True),
        "pairs": _bound("two effects that no single one explains (s⊥ ≥ 8): both in an adequate set", 0.90),
        "outside": _bound("in no library: called unexplained where s⊥ ≥ 8", 0.95),
        "taken_out": _bound("taken out of the library: called unexplained where s⊥ ≥ 8", 0.95),
    },
    _sets,
    _judge,
    per_task=lambda variant, number: len(cells()[variant][number].sizes),
)
