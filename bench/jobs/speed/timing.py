"""Measured times and memory, compared with their bounds."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pcalib.cli import frame


@dataclass(frozen=True)
class Cost:
    """One measured number and its bound."""

    name: str
    value: float
    unit: str
    bound: float | None = None
    at_least: bool = False
    """Whether the bound is the smallest value that is accepted, not the largest."""

    @property
    def holds(self) -> bool:
        """Whether the bound holds."""
        if self.bound is None:
            return True
        return self.value >= self.bound if self.at_least else self.value <= self.bound

    @property
    def promise(self) -> str:
        """The bound in words."""
        return "" if self.bound is None else f"{'≥' if self.at_least else '≤'} {self.bound:g} {self.unit}"


Part = Callable[[], Sequence[Cost]]


def gather(parts: Sequence[Part], title: str) -> list[Cost]:
    """Measure part after part and show the table."""
    found: list[Cost] = []
    with frame.progress("timing", len(parts)) as advance:
        for part in parts:
            found += part()
            advance()
    rows = [
        [c.name, f"{c.value:.3g} {c.unit}", c.promise, "" if c.bound is None else "ok" if c.holds else "missed"]
        for c in found
    ]
    frame.show_table(["what", "figure", "bound", ""], rows, title=title)
    return found


def as_json(costs: Sequence[Cost]) -> list[dict[str, Any]]:
    """The costs as JSON."""
    return [asdict(cost) | {"holds": cost.holds} for cost in costs]


def median(work: Callable[[], object], runs: int, clock: Callable[[], float] = time.process_time) -> float:
    """Seconds that some work takes: processor time of this process, unless the clock is that on the wall."""
    taken = []
    for _ in range(runs):
        begun = clock()
        work()
        taken.append(clock() - begun)
    return float(np.median(taken))
