"""Running a campaign: what is done already is kept, what is missing is done, whatever happens on the way."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bench.jobs.campaign import store, workers
from bench.jobs.campaign.spec import Campaign
from pcalib.errors import InputError


@dataclass(frozen=True)
class Outcome:
    """What a run did."""

    results: Path
    trials: int
    """Robots done in this run; the others were there before."""
    seconds: float
    workers: int

    @property
    def rate(self) -> float:
        """Robots per second, starting and ending of workers included."""
        return self.trials / self.seconds if self.seconds else 0.0


def run(
    campaign: Campaign,
    folder: Path,
    n_workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
    *,
    inside: bool = False,
) -> Outcome:
    """Bring a campaign to its end, from wherever it stands.

    Args:
        folder: for this campaign alone.
        n_workers: processes on this machine; one per core when absent.
        scheduler: address of a dask scheduler, instead.
        progress: called with the number of robots just done, those of earlier runs first.
        inside: do all in this process: it starts at once, but a robot that kills its process ends the run.

    Raises:
        InputError: the folder belongs to another spec or cannot be written, or there is no such scheduler.
    """
    n_workers = len(os.sched_getaffinity(0)) if n_workers is None else n_workers
    if n_workers < 1:
        raise InputError(f"--workers {n_workers}: at least one process has to do the work")
    parts = campaign.parts()
    with store.opened(campaign, folder) as kept:
        todo = kept.missing()
        progress(campaign.n_trials - sum(len(parts[number]) for number in todo))
        begun, done = time.perf_counter(), 0
        for number, content in workers.stream(campaign, todo, n_workers, scheduler, inside):
            kept.write(number, content)
            done += len(parts[number])
            progress(len(parts[number]))
        seconds = time.perf_counter() - begun
        kept.finish()
        return Outcome(kept.results, done, seconds, n_workers)
