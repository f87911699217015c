"""Where trials run: in processes on this machine, on an existing dask cluster, or in this process where asked.

All three give the same results. A worker that dies takes nothing with it but the parts it was at, which are done anew.
"""

from __future__ import annotations

import concurrent.futures as futures
import os
import signal
import threading
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from bench.jobs.campaign import spec, store, trial
from pcalib.errors import InputError

DEATHS = 3
"""How often workers may die without a part being finished in between, before robots are tried one by one."""
DIED = "its process died, twice: a crash, or too little memory"
WATCH = 0.5
"""[s] between looks whether the campaign is still there."""
CONNECT = 10.0
"""[s] to reach a scheduler."""


def perform(source: str, part: int) -> bytes:
    """One part of a campaign, as a Parquet file: what a worker does."""
    campaign = spec.parse(source)
    return store.encode(campaign, part, rows(campaign, campaign.parts()[part]))


def rows(campaign: spec.Campaign, trials: Iterable[int]) -> list[dict[str, Any]]:
    """The rows of some trials, with one thread for linear algebra, as everywhere: more would change rounding."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of poses that cannot be reached; their status tells
        return [row for number in trials for row in trial.run(campaign, number)]


def stream(
    campaign: spec.Campaign, parts: list[int], workers: int, scheduler: str | None, inside: bool = False
) -> Iterator[tuple[int, bytes]]:
    """(number, content) of parts, in the order in which they get done.

    Args:
        inside: do them in this process, which a robot may kill; a single worker does so anyway.

    Raises:
        InputError: no such scheduler, or a cluster with other versions.
    """
    if inside or (workers == 1 and scheduler is None):
        yield from ((part, perform(campaign.source, part)) for part in parts)
        return
    todo, deaths = list(parts), 0
    while todo:
        try:
            with _pool(min(workers, len(todo)), scheduler) as (pool, window):
                for part, content in _windowed(pool, window, campaign.source, todo):
                    todo.remove(part)
                    deaths = 0
                    yield part, content
        except Exception as error:
            if not _death(error):
                raise
            deaths += 1
            if deaths >= DEATHS:
                yield todo[0], _one_by_one(campaign, todo[0])
                todo.pop(0)


def _windowed(
    pool: futures.Executor, window: int, source: str, parts: list[int]
) -> Iterator[tuple[int, bytes]]:
    """Hand out parts, no more than `window` at a time, so that a campaign of any size waits here and not in queues."""
    waiting = iter(list(parts))
    running: dict[futures.Future[bytes], int] = {}
    while True:
        for part in waiting:
            running[pool.submit(perform, source, part)] = part
            if len(running) >= window:
                break
        if not running:
            return
        done, _ = futures.wait(running, return_when=futures.FIRST_COMPLETED)
        for future in done:
            yield running.pop(future), future.result()


@contextmanager
def _pool(workers: int, scheduler: str | None) -> Iterator[tuple[futures.Executor, int]]:
    """An executor, and how many parts to hand out at a time."""
    if scheduler is not None:
        with _cluster(scheduler) as found:
            yield found
        return
    from joblib.externals.loky import ProcessPoolExecutor

    pool = ProcessPoolExecutor(max_workers=workers, initializer=_settle_in, initargs=(os.getpid(),))
    try:
        yield pool, 2 * workers
    except BaseException:  # Ctrl-C above all: do not wait for parts that nobody will keep
        # Its manager may be handing out a part just now, and would print a traceback about the queue that closes.
        said, threading.excepthook = threading.excepthook, lambda _: None
        try:
            pool.shutdown(wait=True, kill_workers=True)
        finally:
            threading.excepthook = said
        raise
    pool.shutdown(wait=True)


@contextmanager
def _cluster(scheduler: str) -> Iterator[tuple[futures.Executor, int]]:
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
        theirs: Any = client.run(store.versions)
        ours = store.versions()
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


def _one_by_one(campaign: spec.Campaign, part: int) -> bytes:
    """A part whose workers keep dying: each robot in a process of its own; one that kills it is recorded as failed."""
    out: list[dict[str, Any]] = []
    for number in campaign.parts()[part]:
        for _ in range(2):
            try:
                with _pool(1, None) as (pool, _):
                    out += pool.submit(_alone, campaign.source, number).result()
                break
            except Exception as error:
                if not _death(error):
                    raise
        else:
            out += trial.given_up(campaign, number, DIED)
    return store.encode(campaign, part, out)


def _alone(source: str, number: int) -> list[dict[str, Any]]:
    return rows(spec.parse(source), [number])


def _death(error: BaseException) -> bool:
    """Whether an error means that a worker died, of whatever kind of pool."""
    return isinstance(error, futures.BrokenExecutor) or type(error).__name__ in ("KilledWorker", "CommClosedError")


def _settle_in(parent: int) -> None:
    """What a process does first: leave Ctrl-C to the campaign, which ends its workers, and never outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def describe(workers: int, scheduler: str | None) -> str:
    """In words, for messages."""
    if scheduler:
        return f"the cluster at {scheduler}"
    return "1 process" if workers == 1 else f"{workers} processes"

