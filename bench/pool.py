"""Processes that share work: a pool without threads, which leaves no process and no file behind however it ends.

    for item, answer in pool.unordered(work, items, workers=2): …

Each process has a pipe of its own to this one. When a process dies, its pipe closes, so it is known which item it was
at. When this process dies, its children see that their parent is gone and end themselves within `WATCH` seconds.
Ctrl-C reaches this process only; it ends the others.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from pcalib.errors import PcalibError

Item = TypeVar("Item")
Answer = TypeVar("Answer")
TRIES = 2
"""How often an item is tried whose process dies: another program may have taken all memory the first time."""
WATCH = 0.5
"""[s] between two looks of a process whether its parent is still there."""


class DiedError(PcalibError):
    """The process that worked at an item died each time: the item crashes it, or needs more memory than there is."""

    def __init__(self, code: int | None):
        super().__init__(
            f"a process that shared the work died twice (exit code {code}): a crash, or too little memory\n"
            "  run the same command with --workers 1, or with fewer other programs"
        )


def unordered(
    work: Callable[[Item], Answer], items: Iterable[Item], workers: int
) -> Generator[tuple[Item, Answer | DiedError], None, None]:
    """Yield each item with its answer, in the order in which answers arrive.

    Args:
        work: a function of a module; what it raises is raised here.
        workers: number of processes; one means this process, which then is not protected against a crash of `work`.
    """
    if workers == 1:
        yield from ((item, work(item)) for item in items)
        return
    waiting = iter(items)
    busy: dict[connection.Connection, tuple[BaseProcess, Item, int]] = {}
    try:
        for _, item in zip(range(workers), waiting, strict=False):
            _begin(busy, work, item, 1)
        while busy:
            for pipe in connection.wait(list(busy)):
                assert isinstance(pipe, connection.Connection)
                process, item, tries = busy[pipe]
                try:
                    fine, answer = pipe.recv()
                except (EOFError, ConnectionResetError):
                    del busy[pipe]
                    process.join()
                    if tries < TRIES:
                        _begin(busy, work, item, tries + 1)
                        continue
                    for following in waiting:
                        _begin(busy, work, following, 1)
                        break
                    yield item, DiedError(process.exitcode)
                    continue
                if not fine:
                    raise answer
                for following in waiting:  # before the answer is used, so that the process does not wait for that
                    busy[pipe] = process, following, 1
                    pipe.send(following)
                    break
                else:
                    del busy[pipe]
                    pipe.close()
                    process.join()
                yield item, answer
    finally:
        for process, *_ in busy.values():
            process.kill()
        for process, *_ in busy.values():
            process.join()


def ordered(work: Callable[[Item], Answer], items: Iterable[Item], workers: int) -> Iterator[Answer]:
    """Yield the answers in the order of the items.

    Raises:
        DiedError: the process that worked at an item died.
    """
    waiting: dict[int, Answer | DiedError] = {}
    following = 0
    for (number, _), answer in unordered(_Numbered(work), enumerate(items), workers):
        waiting[number] = answer
        while following in waiting:
            found = waiting.pop(following)
            if isinstance(found, DiedError):
                raise found
            yield found
            following += 1


class _Numbered:
    """A function of an item that is given with its number."""

    def __init__(self, work: Callable[[Any], Any]):
        self.work = work

    def __call__(self, numbered: tuple[int, Any]) -> Any:
        return self.work(numbered[1])


def _begin(busy: dict[Any, Any], work: Callable[[Any], Any], item: Any, tries: int) -> None:
    """Start a process and give it an item."""
    context = multiprocessing.get_context("spawn")  # a fork would copy the locks of MuJoCo's and NumPy's threads
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(work, there, os.getpid()), daemon=True)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited: Ctrl-C never reaches the child
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    there.close()
    busy[here] = process, item, tries
    here.send(item)


def _serve(work: Callable[[Any], Any], pipe: connection.Connection, parent: int) -> None:
    """Answer items until the pipe closes: what a process of the pool does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    while True:
        try:
            item = pipe.recv()
        except EOFError:
            return
        try:
            answer = True, work(item)
        except Exception as error:
            answer = False, error
        try:
            pipe.send(answer)
        except BrokenPipeError:
            return
