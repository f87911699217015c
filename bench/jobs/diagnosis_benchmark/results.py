"""What the outcomes add up to: rates against bounds, the power curve, and which effect is taken for which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.jobs.diagnosis_benchmark import rows
from bench.jobs.diagnosis_benchmark.rows import Outcome, added
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.grading import CLEAR, Grade, Line

OTHER = ("two effects", "unexplained", "nothing")
"""Answers beside single effects, in the confusion matrix."""
CURVES = {"rich": "white", "rich_position": "white_positions", "plain": "plain", "plain_position": "plain_positions"}
"""Design of the power curve → variant of the row `noise` that is its point at s = 0."""


@dataclass(frozen=True, eq=False)
class Results:
    """All outcomes of a run."""

    outcomes: tuple[Outcome, ...]
    seed: int
    seconds: float = 0.0

    def of(self, row: str, *parts: str) -> list[tuple[Outcome, Grade]]:
        """Return the graded outcomes of a row, of the variants that begin with one of some parts."""
        mine = [o for o in self.outcomes if o.task.row == row and o.task.variant.startswith(parts or "")]
        return [(o, o.said.grade) for o in mine if o.said.grade is not None]

    @property
    def lines(self) -> list[Line]:
        """Every bound that was asked, with the rate that was found."""
        return rows.lines(self.outcomes)

    @property
    def wanted(self) -> list[float]:
        """Sizes of the power curve that were asked, ascending."""
        return sorted({o.said.figures["wanted"] for o, _ in self.of("hidden", "single")})

    def power(self, designs: Sequence[str], effect: str | None = None) -> list[tuple[float, float, float, int]]:
        """Return (s, share with something found, share with the truth named, data sets) for each size of the curve.

        Args:
            designs: of CURVES, or of single effects at misstated noise.
            effect: one effect of the library; all of them where absent.
        """
        out = []
        none = [CURVES.get(design) for design in designs]
        alarms = [o.said.hits["alarm"] for o in self.outcomes if o.task.row == "noise" and o.task.variant in none]
        if alarms and effect is None:
            out.append((0.0, float(np.mean(alarms)), 0.0, len(alarms)))
        for size in self.wanted:
            here = [
                g
                for o, g in self.of("hidden", "single")
                if o.task.variant.removeprefix("single_") in designs
                and o.said.figures["wanted"] == size
                and effect in (None, *g.facts.effects)
            ]
            if here:
                alarm, found = np.mean([[g.alarm, g.found] for g in here], axis=0)
                out.append((size, float(alarm), float(found), len(here)))
        return out

    def designs(self) -> list[str]:
        """Return designs in which single effects were hidden."""
        return list(dict.fromkeys(o.task.variant.removeprefix("single_") for o, _ in self.of("hidden", "single")))

    def confusion(self, low: float = CLEAR, high: float = 12.0) -> Confusion:
        """Return what is answered to each effect and to each fault that no library lists, at sizes from low to high."""
        listed = sorted({str(CATALOGUE[name].effect) for name in catalogue.LISTED})
        names = [*listed, *catalogue.UNLISTED]
        columns = [*listed, *OTHER]
        share = np.zeros((len(names), len(columns)))
        count = np.zeros(len(names), int)
        for o, g in self.of("hidden", "single", "outside"):
            if "taken_out" in o.said.hits or not low * 0.95 <= o.said.figures["wanted"] <= high:
                continue
            row = names.index(g.facts.effects[0] if g.facts.effects else g.facts.faults[0])
            count[row] += 1
            for column, weight in _answers(g.answer.verdict, g.answer.adequate).items():
                share[row, columns.index(column)] += weight
        share = share / np.maximum(count, 1)[:, None]
        return Confusion(tuple(names), tuple(columns), share, count)

    def to_json(self) -> dict[str, Any]:
        """`pcbench.diagnosis_benchmark/1`."""
        c = self.confusion()
        return {
            "schema": "pcbench.diagnosis_benchmark/1",
            "seed": self.seed,
            "seconds": round(self.seconds, 1),
            "data_sets": len(self.outcomes),
            "bounds": [line.to_json() for line in self.lines],
            "power": {
                design: [
                    {"s": s, "something_found": a, "truth_named": f, "n": n} for s, a, f, n in self.power([design])
                ]
                for design in self.designs()
            },
            "confusion": {
                "truth": list(c.rows), "answer": list(c.columns), "share": c.share.round(4).tolist(),
                "n": c.count.tolist(),
            },
            "added": added.means([o for o in self.outcomes if o.task.row == "added"]),
            "sets": [o.to_json() for o in self.outcomes],
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
