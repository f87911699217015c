"""Processes that share work: every answer arrives, a death is found out, and nothing is left behind."""

import math
import operator
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench import pool

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("workers", [1, 2])
def test_answers_come_in_the_order_of_the_items(workers):
    assert list(pool.ordered(math.factorial, range(5), workers)) == [1, 1, 2, 6, 24]


def test_what_the_work_raises_is_raised_here():
    with pytest.raises(ValueError, match=r"negative|not defined"):
        list(pool.ordered(math.factorial, [1, -1, 2, 3], 2))


def test_a_process_that_dies_costs_its_own_item_only():
    found = dict(pool.unordered(operator.methodcaller("__call__"), [Dead(), Alive(1), Alive(2), Alive(3)], 2))
    died = [answer for answer in found.values() if isinstance(answer, pool.DiedError)]
    assert len(died) == 1 and "exit code 7" in str(died[0])
    assert sorted(answer for answer in found.values() if not isinstance(answer, pool.DiedError)) == [1, 2, 3]


class Alive:
    """An item that gives its number."""

    def __init__(self, number: int):
        self.number = number

    def __call__(self) -> int:
        return self.number


class Dead:
    """An item that ends the process that works at it."""

    def __call__(self) -> int:
        os._exit(7)


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_process_and_no_file_outlives_this_one(end):
    """The whole group for SIGINT, as a terminal does; this process alone for the others."""
    before = set(os.listdir("/dev/shm"))
    code = (
        "import time\nfrom bench import pool\n"
        "for item, _ in pool.unordered(time.sleep, [0, 0, 600, 600], 2): print(item, flush=True)"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )
    assert started.stdout is not None and started.stderr is not None
    assert [started.stdout.readline() for _ in range(2)] == [b"0\n", b"0\n"]
    (os.killpg if end == signal.SIGINT else os.kill)(started.pid, end)
    started.wait()
    for _ in range(600):
        try:
            os.killpg(started.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("a process was left behind")
    assert set(os.listdir("/dev/shm")) <= before | {name for name in os.listdir("/dev/shm") if "loky" in name}
    assert started.stderr.read().count(b"Traceback") == (end == signal.SIGINT)  # its own
