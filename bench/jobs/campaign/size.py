"""The size of a campaign, printed before it begins: a spec of a few lines may need years of computing."""

from __future__ import annotations

import os
import time

from bench.jobs import study
from bench.jobs.campaign.spec import Spec
from bench.jobs.campaign.study import Campaign
from pcalib.errors import InputError

ASK_FROM = 20_000
"""Robots that are begun without asking: half an hour at the 12 robots per second of docs/scale.md on one core."""


def require_agreement(spec: Spec, workers: int | None, scheduler: str | None) -> None:
    """Refuse a large campaign without the user's agreement, and say how long it takes.

    Raises:
        InputError: the campaign has more than ASK_FROM robots.
    """
    if spec.n_trials <= ASK_FROM:
        return
    begun = time.perf_counter()
    study.rows(Campaign(spec), [0])  # compiles the model
    once = time.perf_counter()
    study.rows(Campaign(spec), [0])
    seconds = min(once - begun, time.perf_counter() - once) * spec.n_trials
    cores = workers or len(os.sched_getaffinity(0))
    where = "of processor time on the cluster" if scheduler else f"on {cores} process{'es' * (cores > 1)}"
    raise InputError(
        f"{spec.n_cells:,} combinations × {spec.robots:,} robots = {spec.n_trials:,} robots: about "
        f"{duration(seconds if scheduler else seconds / cores)} {where}, by the time that the first robot takes",
        remedy="add --yes to begin, or sweep fewer values",
    )


def duration(seconds: float) -> str:
    """A time in the unit that suits it: '12 hours'."""
    for size, unit in ((365.25 * 86400, "years"), (86400, "days"), (3600, "hours"), (60, "minutes")):
        if seconds >= 2 * size:
            return f"{seconds / size:,.0f} {unit}"
    return f"{seconds:.0f} seconds"
