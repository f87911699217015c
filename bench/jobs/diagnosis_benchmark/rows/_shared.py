"""Robots, fits and answers that the rows share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

from bench.jobs.diagnosis_benchmark.rows import Set, Task
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.design import DESIGNS, Design
from bench.jobs.hidden.stage import Stage
from bench.kinds import MODELS
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.diagnose import Diagnosis
from pcalib.fitting.linearisation import residuals
from pcalib.model import Model
from pcalib.robot import Robot

KINDS = ("delta", "hexa", "delta", "h4", "delta", "linear_delta", "hexapod", "delta", "hexa321", "planar")
"""Robots of models/ whose turn it is, task by task: the Delta most often, every kind once in ten."""


@cache
def robot(name: str) -> Robot:
    """Return a robot of models/."""
    return robots.load(MODELS / f"{name}.toml")


def stage(design: Design, kind: str, rng: np.random.Generator) -> Stage:
    """Return a random robot of a kind with a random plan of measurements."""
    return Stage.draw(design, robot(kind), int(rng.integers(2**31)))


def nothing(task: Task, rng: np.random.Generator) -> Iterator[Set]:
    """Yield sets with nothing hidden, of a robot of the kind whose turn it is."""
    kind = KINDS[task.number % len(KINDS)]
    there = stage(DESIGNS["rich"], kind, rng)
    for _ in range(task.sets):
        yield Set(there.robot, there.measure((), there.reference, int(rng.integers(2**31))), f"{kind}, nothing")


def one_fault(
    names: Sequence[str], design: Design, sizes: tuple[float, float], rng: np.random.Generator
) -> Set:
    """Return a set of a random Delta with one fault of the catalogue, of a visible size in a range (log-uniform)."""
    there = stage(design, "delta", rng)
    usable = [CATALOGUE[name] for name in names if not CATALOGUE[name].companion and not CATALOGUE[name].bar]
    what = usable[rng.integers(len(usable))]
    fault = what.draw(there.robot, rng, uneven=bool(rng.random() < 0.3))
    sized = there.scaled(fault, float(np.exp(rng.uniform(*np.log(sizes)))), what.effect)
    data = there.measure([sized.fault], there.land([sized.fault]), int(rng.integers(2**31)))
    return Set(there.robot, data, f"{what.name}, s {sized.size:.1f}")


def held_out(model: Model, data: Measurements, sigma_pos: float, good: np.ndarray | None = None) -> float:
    """Return the RMS position error of the held-out rows over the true σ of the noise; NaN without such rows.

    Args:
        sigma_pos: [m] true 1σ per component.
        good: (N,) rows that are not grossly wrong.
    """
    rows = data.take(data.check if good is None else data.check & good)
    if not len(rows):
        return float("nan")
    error = residuals(model, rows)[0][:, :3]
    return float(np.sqrt(np.nanmean(error**2)) / sigma_pos)


def in_words(found: Diagnosis) -> str:
    """Return the verdict and the hypotheses in its adequate sets, in a few words."""
    sets = " | ".join("+".join(e.names) or "nothing" for e in found.sets[:3])
    cell = found.cells[0]
    hottest = f"{cell.channel} by {cell.variable}"
    return f"{found.verdict}: {', '.join(found.established) or sets or hottest}"
