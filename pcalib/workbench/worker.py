"""Commands run one after the other in processes of their own, so that the page never waits and any may be cancelled."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from pcalib.errors import PcalibError
from pcalib.workbench.actions import Task

PROGRAM = (sys.executable, "-m", "pcalib.workbench.child")
SHOWN = 20_000
"""Characters of what a command printed that are kept for the page."""


@dataclass(frozen=True)
class Job:
    """A command that waits, runs or has ended."""

    number: int
    task: Task
    state: str = "waits"
    """'waits', 'runs', 'done', 'failed' or 'cancelled'."""
    started: float = 0.0
    seconds: float = 0.0
    said: str = ""
    """What the command printed."""


class Worker:
    """Runs the tasks of a session in its folder.

    Args:
        folder: where commands run.
        done: called after each command that ended well, before the next one begins.
        changed: called whenever a command has been added or has ended, well or not.
    """

    def __init__(self, folder: Path, done: Callable[[Task], None], changed: Callable[[], None] = lambda: None) -> None:
        self._folder, self._done, self._changed = folder, done, changed
        self._jobs: deque[Job] = deque(maxlen=200)
        self._waiting: deque[int] = deque()
        self._process: subprocess.Popen[str] | None = None
        self._change = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def jobs(self) -> list[Job]:
        """All jobs, oldest first; those that run with the time so far."""
        with self._change:
            now = time.monotonic()
            return [replace(j, seconds=now - j.started) if j.state == "runs" else j for j in self._jobs]

    def pending(self) -> list[Task]:
        """What runs and what waits."""
        return [job.task for job in self.jobs() if job.state in ("runs", "waits")]

    def add(self, *tasks: Task) -> None:
        """Put tasks at the end of the queue."""
        with self._change:
            for task in tasks:
                number = self._jobs[-1].number + 1 if self._jobs else 1
                self._jobs.append(Job(number, task))
                self._waiting.append(number)
            self._change.notify_all()
        self._changed()

    def cancel(self) -> None:
        """End the command that runs, and forget those that wait."""
        self._end()
        self._changed()

    def _end(self) -> None:
        with self._change:
            for number in self._waiting:
                self._put(number, state="cancelled")
            self._waiting.clear()
            if self._process is not None:
                running = next((j for j in self._jobs if j.state == "runs"), None)
                if running is not None:
                    self._put(running.number, state="cancelled")
                self._process.terminate()

    def close(self) -> None:
        """End all commands. The record keeps those that wait, so that the session goes on with them."""
        with self._change:
            self._closed = True
            self._change.notify_all()
        self._end()

    def _put(self, number: int, **changed: object) -> None:
        for i, job in enumerate(self._jobs):
            if job.number == number:
                self._jobs[i] = replace(job, **changed)  # pyright: ignore[reportArgumentType]

    def _run(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                number = self._waiting.popleft()
                job = next(j for j in self._jobs if j.number == number)
                self._put(number, state="runs", started=time.monotonic())
                process = self._process = self._start(job.task)
            assert process.stdout is not None
            said = process.stdout.read()
            process.wait()
            self._ended(number, job.task, process.returncode, said[-SHOWN:])
            if process.stdin is not None:
                process.stdin.close()

    def _start(self, task: Task) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*PROGRAM, *task.words], cwd=self._folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, encoding="utf-8", errors="replace",
            env={**os.environ, "COLUMNS": "100", "PYTHONIOENCODING": "utf-8"},
        )  # fmt: skip

    def _ended(self, number: int, task: Task, code: int, said: str) -> None:
        with self._change:
            self._process = None
            job = next(j for j in self._jobs if j.number == number)
            if self._closed:
                return
        state = job.state
        if state != "cancelled":
            state = "failed" if code else "done"
        if state == "done":
            try:
                self._done(task)
            except PcalibError as error:
                state, said = "failed", str(error)
        with self._change:
            self._put(number, state=state, seconds=time.monotonic() - job.started, said=said)
            if state == "failed":  # those that wait were asked for on top of it
                for waiting in self._waiting:
                    self._put(waiting, state="cancelled")
                self._waiting.clear()
        self._changed()
