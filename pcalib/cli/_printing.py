"""What commands print: paragraphs, tables, progress; on any terminal, in any encoding, with any name in it."""

from __future__ import annotations

import codecs
import os
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

PROGRESS_AFTER = 2.0
"""[s] work that takes longer shows a progress bar, on a terminal."""
NARROWEST = 20
"""Columns: a terminal that says it has fewer is not believed."""
LONGEST_LINE, MOST_LINES = 500, 20
"""Bounds of a message: beyond them it hides what it says."""
_CONTROL = re.compile("[\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u202a-\\u202e\\u2066-\\u2069]")
"""Characters by which a name could move the cursor, clear the screen or turn the direction of writing."""
_PLAIN = str.maketrans({
    "µ": "u", "μ": "u", "σ": "sigma", "χ": "chi", "β": "beta", "δ": "delta", "°": "deg", "²": "2", "×": "x", "·": ".",
    "≤": "<=", "≥": ">=", "±": "+-", "−": "-", "–": "-", "—": "-", "─": "-", "…": "...", "„": '"', "“": '"', "”": '"',
    "’": "'", "→": "->",
})  # fmt: skip


def _degrade(error: UnicodeError) -> tuple[str, int]:
    """Stand-ins for characters that an encoding does not have."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(_PLAIN)
    return "".join(c if c.isascii() else "?" for c in text), error.end


codecs.register_error("pcalib.degrade", _degrade)


def shown(text: str) -> str:
    """A text without characters that would act on the terminal: they are written out."""
    return _CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", text)


def bounded(message: str) -> str:
    """A message of sensible length: long lines lose their middle, many lines their end."""
    lines = [
        f"{line[: LONGEST_LINE - 100]} … {line[-80:]}" if len(line) > LONGEST_LINE else line
        for line in message.split("\n")
    ]
    more = len(lines) - MOST_LINES
    return "\n".join([*lines[:MOST_LINES], f"  … {more} lines more"] if more > 0 else lines)


def say(text: str = "") -> None:
    """Print a paragraph, wrapped on a terminal and in one piece elsewhere."""
    for paragraph in shown(text).split("\n"):
        indent = " " * (len(paragraph) - len(paragraph.lstrip()) + (2 if paragraph.lstrip().startswith("- ") else 0))
        print(textwrap.fill(paragraph, _width(), subsequent_indent=indent, break_long_words=False) if paragraph else "")


def show_table(header: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = "") -> None:
    """Print a table; columns of numbers stand to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    cells = [["" if cell is None else shown(str(cell)) for cell in row] for row in rows]
    out = Table(box=box.SIMPLE_HEAD, show_header=any(header), pad_edge=False)
    for i, name in enumerate(header):
        right = bool(cells) and all(row[i][:1] in "+-−0123456789.–" for row in cells)  # '' is in any string
        out.add_column(Text(shown(name)), justify="right" if right else "left", no_wrap=i == 0, overflow="fold")
    for row in cells:
        out.add_row(*(Text(cell) for cell in row))
    if title:
        say(title)
    width = Console(width=10_000).measure(out).maximum
    cell = max((len(cell) for row in cells for cell in row[1:]), default=0)
    word = max((len(word) for row in cells for cell in row[1:] for word in cell.split()), default=0)
    if width > _width() and len(header) > COLUMNS and (cell > LONG_CELL or word > LONG_WORD):
        _show_blocks(header, cells)
    else:
        Console(highlight=False, width=_width()).print(out)


COLUMNS, LONG_CELL, LONG_WORD = 3, 24, 12
"""A table of more columns than that, with a cell or a word of more characters, is shown row by row where it is too
wide: names that the next command needs are not to be broken."""


def _show_blocks(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table row by row: the first cell whole, and below it the others with the names of their columns."""
    print()
    for first, *rest in rows:
        pairs = zip(header[1:], rest, strict=True)
        said = "; ".join(f"{name} {cell}".strip() for name, cell in pairs if cell)
        print(f" {header[0]} {first}" if first.isdigit() else f" {first}")
        print(textwrap.fill(said, _width(), initial_indent="   ", subsequent_indent="   ", break_long_words=False))
    print()


@contextmanager
def progress(what: str, total: int | None = None, unit: str = "") -> Iterator[Callable[..., None]]:
    """A progress bar on stderr, shown only on a terminal and only for work that takes a while.

    With a `unit`, such as 'robots', it shows how many there are and how many per second.

    Yields a function ``advance(n=1)`` to call after every step.
    """
    bar: Any = None
    task: Any = None
    begun, done = time.monotonic(), 0

    def advance(n: int = 1) -> None:
        nonlocal bar, task, done
        done += n
        if bar is None and sys.stderr.isatty() and time.monotonic() - begun > PROGRESS_AFTER:
            from rich.console import Console
            from rich.progress import Progress

            columns = Progress.get_default_columns() + ((_rate(unit),) if unit else ())
            bar = Progress(*columns, console=Console(stderr=True), transient=True)
            task = bar.add_task(shown(what).replace("[", "\\["), total=total)
            bar.start()
        if bar is not None:
            bar.update(task, completed=done)

    try:
        yield advance
    finally:
        if bar is not None:
            bar.stop()


def _rate(unit: str) -> Any:
    """A column of the progress bar: how many of how many, and how fast."""
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = f" · {task.speed:.1f} {unit}/s" if task.speed else ""
            return Text(f"{task.completed:,.0f} of {task.total or 0:,.0f} {unit}{speed}")

    return Rate()


def _width() -> int:
    """Width of the terminal in columns; 1000 for a pipe or file, so that lines stay whole."""
    return max(NARROWEST, shutil.get_terminal_size().columns) if sys.stdout.isatty() else 1000


def believe_width() -> None:
    """Correct a COLUMNS that no terminal can have, which other libraries would believe."""
    columns = os.environ.get("COLUMNS", "")
    if columns and not (columns.isascii() and columns.isdigit() and NARROWEST <= int(columns[:9]) <= 10_000):
        os.environ.pop("COLUMNS")
