"""The outermost guard of every program: streams that can be written, and an exit code for every way to end."""

from __future__ import annotations

import io
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TextIO

from pcalib.cli import _printing
from pcalib.errors import PcalibError

OK, NOT_HELD, BAD_INPUT, UNFORESEEN, INTERRUPTED, PIPE_CLOSED, TERMINATED = 0, 1, 2, 3, 130, 141, 143
"""Exit codes: fine; a check that was asked for did not hold; bad input or usage; a fault of the program; Ctrl-C; the
reader went away; asked to end."""


def fail(message: str) -> int:
    """Say what is wrong on stderr; the exit code for bad input."""
    with suppress(OSError, ValueError):  # stderr may be closed
        print(_printing.bounded(_printing.shown(f"error: {message}")), file=sys.stderr, flush=True)
    return BAD_INPUT


def guarded(program: Callable[[], int | None], argv: Sequence[str]) -> int:
    """Run a program and return its exit code, whatever happens: no exception leaves it but SystemExit of help pages."""
    try:
        with _streams(), _ending():
            result = program()
            sys.stdout.flush()
            return OK if result is None else int(result)
    except PcalibError as error:
        return fail(str(error))
    except KeyboardInterrupt:
        with suppress(OSError, ValueError):
            print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        _leave_stdout()
        return PIPE_CLOSED
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):  # how rich tells that the reader went away
            return PIPE_CLOSED
        raise
    except OSError as error:
        _leave_stdout()
        where = f"{error.filename}: " if error.filename else ""
        return fail(f"{where}{error.strerror or error}")
    except MemoryError:
        return fail("this needs more memory than there is\n  use fewer rows, or a machine with more memory")
    except Exception as error:
        return _unforeseen(error, argv)


def _leave_stdout() -> None:
    """Send what is left in the buffer of standard output nowhere, if it cannot be written."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):  # or the interpreter complains at its end
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _unforeseen(error: Exception, argv: Sequence[str]) -> int:
    """Write what developers need to correct an error of the program to a file, and name the file."""
    import platform
    import traceback

    lines = [f"command: {' '.join(argv)}", f"python {platform.python_version()} on {platform.platform()}"]
    with suppress(Exception):
        from importlib import metadata

        lines += [f"{name} {metadata.version(name)}" for name in ("pcalib", "numpy", "scipy")]
    with suppress(RecursionError):
        lines += ["", *traceback.format_exception(error, limit=-60)]
    where = "the details could not be written"
    with suppress(OSError):
        handle, path = tempfile.mkstemp(prefix="pcalib-fault-", suffix=".txt")
        with open(handle, "w", encoding="utf-8", errors="backslashreplace") as out:
            out.write("\n".join(lines))
        where = f"please send {path} to the authors, with the files that the command reads"
    fail(f"an unforeseen {type(error).__name__}: this is a fault of the program, not of the input\n  {where}")
    return UNFORESEEN


@contextmanager
def _streams() -> Iterator[None]:
    """Standard streams that exist and take every character."""
    for name in ("stdout", "stderr"):
        stream: TextIO | None = getattr(sys, name)
        if stream is None:  # closed by the caller: its number is taken, or a file that is opened next would get it
            while (number := os.open(os.devnull, os.O_RDWR)) < 2:
                pass
            setattr(sys, name, open(number, "w", encoding="utf-8"))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="pcalib.degrade")
    _printing.believe_width()
    yield


@contextmanager
def _ending() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the program as Ctrl-C does, so that nothing half-written and no child is left."""

    def end(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = {}
    for number in (signal.SIGTERM, signal.SIGHUP):
        with suppress(ValueError):  # not in the main thread
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def quiet() -> None:
    """Keep notices of libraries off the terminal, unless the caller has asked Python for warnings."""
    import logging
    import warnings

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # "Matplotlib is building the font cache"
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ.setdefault("PYTHONWARNINGS", "ignore")  # for processes that share the work
