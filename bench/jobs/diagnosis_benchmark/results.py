"""What the trials add up to: rates against bounds, the power curve, and which effect is taken for which."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.jobs.diagnosis_benchmark.cells import CURVE, LARGE, MISSTATED
from bench.jobs.diagnosis_benchmark.trial import Trial
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.grading import CLEAR, Line, lines

NOISE_FLOOR = 1.1
"""Held-out RMS over the noise floor that an effect may leave once it is added."""
LANDED = 1.5
"""Miss of the compensated robot with the fault over that of the robot without it."""
NEAR = (0.95, 1.1)
"""s over the wanted 6 that counts as 6."""
OTHER = ("two effects", "unexplained", "nothing")
"""Answers beside single effects, in the confusion matrix."""


@dataclass(frozen=True, eq=False)
class Results:
    """All trials of a run."""

    trials: tuple[Trial, ...]
    seed: int
    seconds: float = 0.0

    def of(self, *parts: str) -> list[Trial]:
        """The trials of some parts."""
        return [t for t in self.trials if t.cell.part in parts]

    @property
    def lines(self) -> list[Line]:
        """Every bound, with the rate that was found."""
        asked = [t.grade for t in self.of("none", "single", "pair", "outside")]
        base = {line.name: line for line in lines(asked)}
        none, single, outside = self.of("none"), self.of("single"), self.of("outside")
        wrong = [t for t in none if t.cell.design in MISSTATED]
        right = [t for t in none if t.cell.design not in MISSTATED]
        at_six = [t for t in single if NEAR[0] * CLEAR <= t.grade.facts.size <= NEAR[1] * CLEAR]
        taken = [t for t in outside if t.cell.without]
        unlisted = [t for t in outside if not t.cell.without]
        added = [t for t in self.of("add") if t.grade.facts.effects]
        effects = sorted({t.grade.facts.effects[0] for t in added})

        def mean(effect: str, figure: Callable[[Trial], float]) -> float:
            return float(np.mean([figure(t) for t in added if t.grade.facts.effects == (effect,)]))

        quiet = [mean(e, lambda t: t.held_out) <= NOISE_FLOOR for e in effects]
        lands = [mean(e, lambda t: t.landed) <= LANDED for e in effects]
        far = "called unexplained where s⊥ ≥ 8"
        return [
            _line("false_alarms", "nothing hidden, σ right: something found", 0.05, True,
                  right, lambda t: t.grade.alarm),
            _line("false_alarms_misstated", "nothing hidden, σ misstated, replicates: something found", 0.05, True,
                  wrong, lambda t: t.grade.alarm),
            base["inside"],
            _line("found_at_6", "single effect at s = 6: established, or fairly A or B", 0.90, False, at_six,
                  lambda t: t.grade.found),
            base["false_established"],
            base["pairs"],
            _line("outside", f"in no library: {far}", 0.95, False, _far(unlisted), lambda t: t.grade.unexplained),
            _line("taken_out", f"taken out of the library: {far}", 0.95, False, _far(taken),
                  lambda t: t.grade.unexplained),
            Line("held_out", f"effects whose held-out RMS, once added at s = {LARGE:g}, is within 10 % of the noise",
                 1.0, False, sum(quiet), len(quiet)),
            Line("landed", "effects whose compensated robot lands within 1.5× the miss without the fault", 1.0, False,
                 sum(lands), len(lands)),
        ]  # fmt: skip

    # -- power ---------------------------------------------------------------------------------------------------

    def power(self, designs: Sequence[str], effect: str | None = None) -> list[tuple[float, float, float, int]]:
        """(s, share with something found, share with the truth named, data sets) for each size of the curve.

        Args:
            effect: one effect of the library; all of them where absent.
        """
        out = []
        none = [t for t in self.of("none") if t.cell.design in designs]
        if none and effect is None:
            out.append((0.0, float(np.mean([t.grade.alarm for t in none])), 0.0, len(none)))
        for size in CURVE:
            here = [
                t.grade
                for t in self.of("single")
                if t.cell.design in designs and t.wanted == size and effect in (None, *t.grade.facts.effects)
            ]
            if here:
                alarm, found = np.mean([[g.alarm, g.found] for g in here], axis=0)
                out.append((size, float(alarm), float(found), len(here)))
        return out

    # -- confusion -----------------------------------------------------------------------------------------------

    def confusion(self, low: float = CLEAR, high: float = 12.0) -> Confusion:
        """What is answered to each effect and to each fault that no library lists, at sizes from low to high."""
        listed = sorted({str(CATALOGUE[name].effect) for name in catalogue.LISTED})
        rows = [*listed, *catalogue.UNLISTED]
        columns = [*listed, *OTHER]
        share = np.zeros((len(rows), len(columns)))
        count = np.zeros(len(rows), int)
        for t in self.of("single", "outside"):
            g = t.grade
            if t.cell.without or not low * 0.95 <= t.wanted <= high:
                continue
            row = rows.index(g.facts.effects[0] if g.facts.effects else g.facts.faults[0])
            count[row] += 1
            for column, weight in _answers(g.answer.verdict, g.answer.adequate).items():
                share[row, columns.index(column)] += weight
        share = share / np.maximum(count, 1)[:, None]
        return Confusion(tuple(rows), tuple(columns), share, count)

    def mistakes(self) -> list[Trial]:
        """Trials in which an effect is called established that is not there."""
        return [t for t in self.trials if t.grade.wrong]

    def to_json(self) -> dict[str, Any]:
        """`pcbench.diagnosis_benchmark/1`."""
        c = self.confusion()
        added: dict[str, Mapping[str, Any]] = {}
        for effect in sorted({t.grade.facts.effects[0] for t in self.of("add")}):
            mine = [t for t in self.of("add") if t.grade.facts.effects == (effect,)]
            added[effect] = {
                key: float(np.mean([getattr(t, key) for t in mine]))
                for key in ("held_out_before", "held_out", "floor", "landed", "landed_alike")
            } | {"s": float(np.mean([t.grade.facts.size for t in mine])), "robots": len(mine)}
        return {
            "schema": "pcbench.diagnosis_benchmark/1",
            "seed": self.seed,
            "seconds": round(self.seconds, 1),
            "data_sets": len(self.trials),
            "bounds": [line.to_json() for line in self.lines],
            "power": {
                design: [
                    {"s": s, "something_found": a, "truth_named": f, "n": n} for s, a, f, n in self.power([design])
                ]
                for design in dict.fromkeys(t.cell.design for t in self.of("single"))
            },
            "confusion": {
                "truth": list(c.rows), "answer": list(c.columns), "share": c.share.round(4).tolist(),
                "n": c.count.tolist(),
            },
            "added": added,
            "trials": [t.to_json() for t in self.trials],
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Confusion:
    """Answers by truth; an answer with rivals counts in equal parts for each."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    share: np.ndarray
    """(rows, columns)."""
    count: np.ndarray
    """(rows,) data sets."""


def _answers(verdict: str, adequate: Sequence[Sequence[str]]) -> dict[str, float]:
    if verdict == "nothing_missing":
        return {"nothing": 1.0}
    if verdict not in ("established", "ambiguous") or not adequate:
        return {"unexplained": 1.0}
    out: dict[str, float] = {}
    for names in adequate:
        column = names[0] if len(names) == 1 else "two effects"
        out[column] = out.get(column, 0.0) + 1.0 / len(adequate)
    return out


def _far(trials: Sequence[Trial]) -> list[Trial]:
    from bench.jobs.hidden.grading import FAR, SLACK

    return [t for t in trials if t.grade.facts.distance >= SLACK * FAR]


def _line(
    name: str, what: str, bound: float, at_most: bool, trials: Sequence[Trial], hit: Callable[[Trial], bool]
) -> Line:
    return Line(name, what, bound, at_most, sum(hit(t) for t in trials), len(trials))
