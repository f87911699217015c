"""Data sets of known truth: nothing hidden, one effect, two effects, or something that no library lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.commands import Landing
from bench.faults import Fault
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.catalogue import Hidden
from bench.jobs.hidden.grading import SLACK, Facts
from bench.jobs.hidden.stage import Stage
from pcalib.data.measurement import Measurements

STRETCH = 5.0
"""Factor by which each of two effects may exceed the wanted size, so that no single effect explains both."""


@dataclass(frozen=True, eq=False)
class Case:
    """A robot with its faults, and the facts about them."""

    stage: Stage
    hidden: tuple[Fault, ...]
    facts: Facts
    sizes: tuple[float, ...] = ()
    """s of each fault by itself."""
    nearest: tuple[str, ...] = ()
    """The library's effects that come nearest, of pairs and of what no library lists."""
    usual: float = 1.0
    """How many usual sizes a single fault has: what is poorly visible has to be large to be seen at all."""

    @cached_property
    def landing(self) -> Landing:
        """Where MuJoCo puts this robot."""
        return self.stage.land(self.hidden)

    def measure(self, seed: int) -> Measurements:
        """Return data with noise of the given seed."""
        return self.stage.measure(self.hidden, self.landing, seed)


def nothing(stage: Stage) -> Case:
    """Return a case with nothing hidden."""
    return Case(stage, (), Facts((), ()))


def single(stage: Stage, what: Hidden, fault: Fault, size: float) -> Case:
    """Return a case with one listed fault, of visible size `size`, or of the size that it can reach."""
    assert what.effect is not None
    found = stage.scaled(fault, size, what.effect)
    size = _short(found.size)
    return Case(stage, (found.fault,), Facts((what.effect,), (what.name,), size), (size,), usual=found.factor)


def pair(stage: Stage, what: Sequence[Hidden], drawn: Sequence[Fault], size: float) -> Case | None:
    """Return a case with two listed faults, each of visible size `size` or more, so large that no single effect comes
    closer to them than `size`.

    None where they cannot: one alone stays too small, or some single effect all but explains both.
    """
    found = [stage.scaled(fault, size, w.effect) for w, fault in zip(what, drawn, strict=True)]
    if any(f.capped for f in found):
        return None
    hidden, factor = tuple(f.fault for f in found), 1.0
    for _ in range(3):
        signal = stage.signal(hidden)
        distance, nearest = stage.nearest(signal)
        if distance >= SLACK * size:
            effects = tuple(sorted({str(w.effect) for w in what}))
            facts = Facts(effects, tuple(w.name for w in what), _short(np.linalg.norm(signal)), _short(distance))
            each = tuple(_short(np.linalg.norm(stage.signal([fault]))) for fault in hidden)
            return Case(stage, hidden, facts, each, nearest)
        factor = float(f"{1.02 * factor * size / max(distance, 1e-9):.4g}")
        room = min(stage.room(f.fault, stage.change([f.fault]), w.effect) for f, w in zip(found, what, strict=True))
        if factor > min(STRETCH, room):
            return None
        hidden = tuple(catalogue.scaled(f.fault, factor) for f in found)
    return None


def outside(stage: Stage, what: Hidden, fault: Fault, distance: float, without: str | None = None) -> Case:
    """Return a case with an unlisted fault, so large that no two effects of the library come closer to it than
    `distance`, or as large as it can be.

    Args:
        without: an effect that is taken out of the library, so that a fault it describes counts as unlisted.
    """
    change = stage.change([fault])
    most, factor, out = stage.room(fault, change, without), 1.0, fault
    signal = stage.visible(change)
    far, nearest = stage.nearest(signal, together=2, without=without)
    for _ in range(3):
        if abs(far / distance - 1) < 0.03 or factor >= 0.999 * most:
            break
        factor = float(f"{min(factor * distance / max(far, 1e-9), most):.4g}")
        out = catalogue.scaled(fault, factor)
        signal = stage.signal([out])
        far, nearest = stage.nearest(signal, together=2, without=without)
    size = _short(np.linalg.norm(signal))
    return Case(stage, (out,), Facts((), (what.name,), size, _short(far)), (size,), nearest)


def _short(value: float | np.floating) -> float:
    return float(f"{value:.4g}")
