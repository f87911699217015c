"""Running studies: what is on disk is kept, what is missing is done, whatever happens on the way.

Trials run in this process, in processes of this machine or on a dask cluster, with the same results. A worker that
dies costs the part that it was at, which is done again; a trial that kills its process is recorded as failed.
"""

from __future__ import annotations

import concurrent.futures as futures
import os
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from bench import pool
from bench.jobs import store, study
from bench.jobs.study import Study
from pcalib.errors import InputError

DIED = "its process died, twice: a crash, or too little memory"
CONNECT = 10.0
"""[s] to reach a scheduler."""


@dataclass(frozen=True)
class Run:
    """What a run did."""

    results: Path
    trials: int
    """Trials done in this run; the others were there before."""
    seconds: float
    workers: int

    @property
    def rate(self) -> float:
        """Trials per second, starting and ending of workers included."""
        return self.trials / self.seconds if self.seconds else 0.0


class Interrupted(KeyboardInterrupt):
    """Ctrl-C; `kept` is the number of trials that are on disk."""

    def __init__(self, kept: int):
        super().__init__()
        self.kept = kept


def run(
    of: Study,
    folder: Path,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda done: None,
    say: Callable[[str], None] = lambda text: None,
    *,
    renew: bool = False,
) -> Run:
    """Run the trials of a study that are not on disk yet.

    Args:
        folder: for this study alone.
        workers: processes on this machine, one per core when absent. One means this process: it starts at once, but a
            trial that kills its process ends the run.
        scheduler: address of a dask scheduler, whose workers are used instead.
        progress: called with the number of trials just done, those of earlier runs first.
        say: called with what the user should know, such as damaged files.
        renew: whether results of another source or version that lie in the folder are deleted, not refused.

    Raises:
        InputError: the folder belongs to another study or cannot be written, or there is no such scheduler.
        Interrupted: Ctrl-C.
    """
    workers = len(os.sched_getaffinity(0)) if workers is None else workers
    if workers < 1:
        raise InputError(f"--workers {workers}: at least one process has to do the work")
    with store.opened(of, folder, say, renew=renew) as kept:
        begun, done = time.perf_counter(), 0
        again: set[range] = set()
        try:
            todo = kept.missing()
            progress(of.n_trials - sum(map(len, todo)))
            begun = time.perf_counter()
            while True:
                with closing(stream(of, todo, workers, scheduler)) as finished:
                    for trials, content in finished:
                        _require_ours(of, trials, content)
                        kept.write(trials, content)
                        done += len(trials)
                        progress(len(trials))
                seconds = time.perf_counter() - begun
                todo = kept.finish()
                if not todo:
                    break
                if not again.isdisjoint(todo):
                    raise InputError("parts are damaged again and again", file=folder, remedy="check the disk")
                again.update(todo)
                progress(-sum(map(len, todo)))
        except KeyboardInterrupt:
            raise Interrupted(kept.kept()) from None
        return Run(kept.results, done, seconds, workers)


def _require_ours(of: Study, trials: range, content: bytes) -> None:
    """Refuse results of a worker that runs other versions of programs."""
    if (pq.read_schema(pa.BufferReader(content)).metadata or {}).get(study.TRIALS) != of.mark(trials):
        raise InputError(
            "the project's code was changed while the study ran, and its processes do not agree any more",
            remedy="run the same command again",
        )


def table(of: Study, workers: int = 1, progress: Callable[[int], None] = lambda done: None) -> pa.Table:
    """The results of a small study, kept nowhere."""
    parts: dict[int, pa.Table] = {}
    for trials, content in stream(of, [of.part(number) for number in range(of.n_parts)], workers):
        parts[trials.start] = pq.read_table(pa.BufferReader(content)).cast(of.schema())
        progress(len(trials))
    return pa.concat_tables([parts[first] for first in sorted(parts)])


def stream(
    of: Study, todo: list[range], workers: int, scheduler: str | None = None
) -> Generator[tuple[range, bytes], None, None]:
    """Yield trials and their rows as Parquet, in the order in which they are done.

    Raises:
        InputError: no such scheduler, or a cluster with other versions.
    """
    tasks = [(type(of), of.source, trials) for trials in todo]
    answers = pool.unordered(study.perform, tasks, workers) if scheduler is None else _on_cluster(tasks, scheduler)
    with closing(answers):
        for (_, _, trials), content in answers:
            yield trials, _one_by_one(of, trials, workers) if isinstance(content, pool.DiedError) else content


def _one_by_one(of: Study, trials: range, workers: int) -> bytes:
    """A part whose process dies: each trial in a process of its own; those that kill it are recorded as failed."""
    found: dict[int, list[study.Row]] = {}
    singles = [(type(of), of.source, range(number, number + 1)) for number in trials]
    for (_, _, (number,)), rows in pool.unordered(_alone, singles, max(workers, 2)):
        found[number] = list(of.given_up(number, DIED)) if isinstance(rows, pool.DiedError) else rows
    return study.encode(of, trials, [row for number in trials for row in found[number]])


def _alone(task: study.Task) -> list[study.Row]:
    kind, source, trials = task
    return study.rows(kind.parse(source), trials)


def _on_cluster(
    tasks: list[study.Task], scheduler: str
) -> Generator[tuple[study.Task, bytes | pool.DiedError], None, None]:
    """Hand out tasks to a cluster, a few per core at a time, so that a study of any size waits here."""
    with _cluster(scheduler) as (executor, window):
        waiting = iter(tasks)
        running = {executor.submit(study.perform, task): task for task in islice(waiting, window)}
        while running:
            done, _ = futures.wait(running, return_when=futures.FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                for following in islice(waiting, 1):
                    running[executor.submit(study.perform, following)] = following
                try:
                    yield task, future.result()
                except Exception as error:
                    if type(error).__name__ != "KilledWorker":  # dask gives up where workers die again and again
                        raise
                    yield task, pool.DiedError(None)


@contextmanager
def _cluster(scheduler: str) -> Iterator[tuple[futures.Executor, int]]:
    """An executor, and how many tasks to hand out at a time."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler needs the package 'distributed', which is not installed",
            remedy="pip install 'pcalib[cluster]'",
        ) from None
    try:
        client = Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"no dask scheduler at {scheduler}: {error}", remedy="write tcp://HOST:PORT, as 'dask scheduler' prints it"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT)
        except TimeoutError:
            problem = f"the scheduler at {scheduler} has no workers"
            raise InputError(problem, remedy="start some with 'dask worker'") from None
        theirs: Any = client.run(study.versions)
        ours = study.versions()
        for address, found in theirs.items():
            differ = [f"{name} {found.get(name)}, here {ours[name]}" for name in ours if found.get(name) != ours[name]]
            if differ:
                raise InputError(
                    f"worker {address} has {'; '.join(differ)}",
                    remedy="install the same versions there: results depend on them",
                )
        cores: Any = client.nthreads()
        executor = client.get_executor(pure=False)
        try:
            yield executor, 2 * sum(cores.values())
        finally:
            executor.shutdown(wait=False)


def describe(workers: int, scheduler: str | None) -> str:
    """Where trials run, in words."""
    if scheduler:
        return f"the cluster at {scheduler}"
    return "1 process" if workers == 1 else f"{workers} processes"
