"""The time of a campaign in MuJoCo, in LAPACK and in Python, and the memory that it takes.

    scripts/campaign_profile
    scripts/campaign_profile bench/specs/quick.toml --robots 20

The functions that enter MuJoCo and LAPACK are wrapped with clocks: a profiler that traces every call would make
Python look slower than it is.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcalib.cli import frame
from pcalib.errors import InputError

SPEC = Path(__file__).parents[2] / "specs" / "thousand.toml"
QUICK = 10
MUJOCO = "MuJoCo"
LAPACK = "LAPACK"


@contextmanager
def clocks() -> Iterator[dict[str, dict[str, float]]]:
    """Processor seconds in every function that enters MuJoCo or LAPACK, by group and name, while the block runs."""
    import mujoco.batch
    import numpy as np
    import scipy.linalg
    from scipy.linalg import lapack

    from bench import closing

    seconds: dict[str, dict[str, float]] = {MUJOCO: {}, LAPACK: {}}
    depth = 0
    undo: list[Callable[[], None]] = []

    def wrap(owner: Any, name: str, group: str) -> None:
        inner = getattr(owner, name)
        seconds[group][name] = 0.0

        def timed(*args: Any, **more: Any) -> Any:
            nonlocal depth
            depth += 1
            begun = time.process_time()
            try:
                return inner(*args, **more)
            finally:
                depth -= 1
                if not depth:  # np.linalg functions call each other
                    seconds[group][name] += time.process_time() - begun

        setattr(owner, name, timed)
        undo.append(lambda: setattr(owner, name, inner))

    wrap(mujoco.batch.Batch, "forward", MUJOCO)
    wrap(closing.Loops, "evaluate", MUJOCO)
    for name in ("solve", "svd", "qr", "inv", "det", "cholesky", "pinv", "cond", "eigh"):
        wrap(np.linalg, name, LAPACK)
    for name in ("qr", "solve_triangular"):
        wrap(scipy.linalg, name, LAPACK)
    for name in ("dgeqrf", "dtrtrs", "dtrtri"):
        wrap(lapack, name, LAPACK)
    try:
        yield seconds
    finally:
        for put_back in undo:
            put_back()


def memory() -> float:
    """[MiB] Peak memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def command(spec: Path = SPEC, /, *, robots: int = 100, quick: bool = False) -> None:
    """Where the time of a campaign goes, on one core.

    Args:
        spec: Campaign file (TOML).
        robots: How many to run.
        quick: 10 robots, to see that everything runs.
    """
    from bench.jobs import study
    from bench.jobs.campaign import spec as specs
    from bench.jobs.campaign.study import Campaign

    if robots < 1:
        raise InputError(f"--robots {robots}: there is nothing to time", remedy="use at least one robot")
    robots = QUICK if quick else robots
    campaign = Campaign(specs.load(spec))
    robots = min(robots, campaign.n_trials)
    study.rows(campaign, range(min(5, robots)))  # compiles the model, makes the plan
    first = memory()
    begun, busy = time.perf_counter(), time.process_time()
    with clocks() as seconds:
        study.rows(campaign, range(robots))
    wall, total = time.perf_counter() - begun, time.process_time() - busy
    rows = []
    for group, names in seconds.items():
        rows.append((f"inside {group}", f"{sum(names.values()):.2f}", f"{100 * sum(names.values()) / total:.0f} %"))
        for name, value in sorted(names.items(), key=lambda item: -item[1]):
            if value > 0.002 * total:
                rows.append((f"  {name}", f"{value:.2f}", f"{100 * value / total:.1f} %"))
    rest = total - sum(sum(names.values()) for names in seconds.values())
    rows.append(("array arithmetic and Python", f"{rest:.2f}", f"{100 * rest / total:.0f} %"))
    frame.say(
        f"{robots} robots of {campaign.name} on one core: {1e3 * total / robots:.1f} ms of processor time each, "
        f"{robots / total:.1f} robots per second of it; on the clock {robots / wall:.1f} robots/s"
    )
    frame.show_table(("where", "processor s", "share"), rows)
    frame.say(f"memory: {first:.0f} MiB after 5 robots, {memory():.0f} MiB after {robots}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return frame.script("campaign_profile", command, argv)


if __name__ == "__main__":
    sys.exit(main())
