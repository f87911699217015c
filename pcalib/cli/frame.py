"""What all command lines of the project share: finding commands, running them, printing, JSON and progress.

A command is one file in the folder of its program (`pcalib/cli/`, `bench/cli/`); nothing else has to be told of it::

    '''One line for the list of commands.

        pcalib mycommand data.csv --json out.json
    '''

    def command(data: Path, /, *, robot: Path | None = None, json: JsonOption = None) -> int | None:
        '''One line, the same or another.

        What it does, for the page of --help.

        Args:
            data: What this argument is.
            robot: What this option is.
        '''

The file's name is the command's (`_` becomes `-`), its docstring is the line in the list followed by examples, and
`command` returns the exit code, None for 0. The file is imported only when its command runs, and should itself
import what is heavy inside `command`. Files that start with `_`, and this one, are no commands.
"""

from __future__ import annotations

import ast
import inspect
import json
import math
import os
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError, UnknownCommandError, UnusedCliTokensError
from cyclopts.validators import Number

from pcalib.errors import PcalibError, unknown

# Matrices here are small: a second BLAS thread costs more than it brings. Read when NumPy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

OK, NOT_HELD, BAD_INPUT, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 130, 141
"""Exit codes: fine; a check that was asked for did not hold; bad input or usage; Ctrl-C; the reader went away."""


OUTPUTS = ("output", "robot_output", "json", "report", "rrd", "plot", "save")
"""How parameters for files to write are called."""
REWRITE = ("add", "drop", "log")
"""Commands that may write the model they read anew: it keeps every step."""


def keep_inputs(rewrites: bool, **given: Any) -> None:
    """Refuse an output that would take the place of a file the command reads, or of another output."""
    from pcalib.errors import InputError

    taken = [(name, Path(p)) for name, value in given.items() for p in (value if isinstance(value, tuple) else (value,))
             if isinstance(p, Path) or (name == "plan" and isinstance(p, str))]  # fmt: skip
    for name, path in taken:
        for other, file in taken:
            if name not in OUTPUTS or name == other or (rewrites and (name, other) == ("output", "model")):
                continue
            if path == file or (path.exists() and file.exists() and path.samefile(file)):
                what = "is named for two results" if other in OUTPUTS else "this file is read, and would be overwritten"
                raise InputError(what, file=path, remedy="write to another file")


def place(_: Any, path: Path | None) -> None:
    """Refuse before long work, not after it, a file that cannot be written."""
    from pcalib import files

    files.check_places(path)


def folder_place(_: Any, path: Path | None) -> None:
    """The same for a folder of results."""
    from pcalib import files

    files.check_folder(path)


JsonOption = Annotated[
    Path | None, Parameter(name="--json", validator=place, help="Also write the result to this file, as JSON.")
]
OutputOption = Annotated[Path | None, Parameter(name=["--output", "-o"], validator=place)]
RequiredOutput = Annotated[Path, Parameter(name=["--output", "-o"], validator=place)]
OutputFolder = Annotated[Path, Parameter(name=["--output", "-o"], validator=folder_place)]
SeedOption = Annotated[int, Parameter(validator=Number(gte=0))]
BesideOption = Annotated[Path | None, Parameter(validator=place)]
"""A file that is written beside what a command prints."""

_PLAIN = Parameter(negative=(), show_default=lambda value: None if value in (None, "", ()) else str(value))
"""Of every option: no --no-…, and no default where it is nothing."""

PROGRESS_AFTER = 2.0
"""[s] work that takes longer shows a progress bar, on a terminal."""


def app(name: str, package: str, path: Iterable[str], description: str, examples: str = "") -> App:
    """A program whose commands are the files of `package`, which lies at `path`; none of them is imported."""
    program = App(
        name=name,
        help=description,
        help_epilogue=_examples(examples),
        help_format="plaintext",
        version=_version,
        version_flags=["--version"],
        default_parameter=_PLAIN,
        result_action="return_value",
        suppress_keyboard_interrupt=False,
    )
    files = {file.stem: file for folder in path for file in Path(folder).glob("*.py")}
    for module in sorted(files):
        if module.startswith("_") or module == "frame":
            continue
        text, examples = _help(files[module])
        program.command(
            f"{package}.{module}:command", name=module.replace("_", "-"), help=text, help_epilogue=examples,
            validator=partial(keep_inputs, module in REWRITE),
        )  # fmt: skip
    return program


def script(name: str, command: Callable[..., int | None], argv: Sequence[str] | None = None) -> int:
    """Run a program of one command; returns the exit code."""
    program = App(
        name=name, help_format="plaintext", version_flags=[], result_action="return_value",
        default_parameter=_PLAIN, suppress_keyboard_interrupt=False,
    )  # fmt: skip
    program.default(command)
    return run(program, argv)


def run(program: App, argv: Sequence[str] | None = None) -> int:
    """Run a program and return its exit code; every error that was raised on purpose is one message on stderr."""
    try:
        result = program(sys.argv[1:] if argv is None else list(argv), exit_on_error=False, print_error=False)
        sys.stdout.flush()
    except PcalibError as error:
        return fail(str(error))
    except CycloptsError as error:
        return fail(_usage(program, error))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter complains at its end
        return PIPE_CLOSED
    except SystemExit as error:  # how rich tells that the reader went away
        if isinstance(error.__context__, BrokenPipeError):
            return PIPE_CLOSED
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return fail(f"{where}{error.strerror or error}")
    return OK if result is None else int(result)


def fail(message: str) -> int:
    """Say what is wrong on stderr; the exit code for bad input."""
    print(f"error: {message}", file=sys.stderr)
    return BAD_INPUT


def quantity(dimension: str, size: int = 1) -> Parameter:
    """An option that carries its unit, as in ``--tool 0,0,-300mm``; the command gets an array (size,) in SI.

    Used as ``tool: Annotated[np.ndarray | None, quantity("length", 3)] = None``. An option whose own name ends with a
    unit, ``--max-rms-um 5``, may leave it out of its value.
    """

    def convert(_: type, tokens: Sequence[Any]) -> Any:
        from pcalib import units
        from pcalib.errors import InputError

        option, text = tokens[0].keyword or "value", tokens[0].value
        named = units.split(option.replace("-", "_"))[1]
        if named is not None and text[-1:].isdigit():
            text += named.suffix
        values = units.parse_quantity(text, dimension, option=option)
        if len(values) != size:
            raise InputError(f"{option} '{text}' needs {size} number{'s' * (size > 1)}, not {len(values)}")
        return values

    shape = ",".join("N" * size) + "<unit>"
    return Parameter(converter=convert, n_tokens=1, allow_leading_hyphen=True, accepts_keys=False, metavar=shape)


def write_json(path: Path | None, content: Mapping[str, Any]) -> None:
    """Write JSON atomically, arrays as lists and what is not finite as null; nothing where `path` is None."""
    if path is None:
        return
    from pcalib import files

    files.write_text(path, json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def plain(value: Any) -> Any:
    """A value as JSON can hold it."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy
        value = value.tolist()
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def say(text: str = "") -> None:
    """Print a paragraph, wrapped on a terminal and in one piece elsewhere."""
    width = _console().width
    for paragraph in text.split("\n"):
        indent = " " * (len(paragraph) - len(paragraph.lstrip()) + (2 if paragraph.lstrip().startswith("- ") else 0))
        print(textwrap.fill(paragraph, width, subsequent_indent=indent, break_long_words=False) if paragraph else "")


def show_table(header: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = "") -> None:
    """Print a table; columns of numbers stand to the right."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    cells = [["" if cell is None else str(cell) for cell in row] for row in rows]
    out = Table(box=box.SIMPLE_HEAD, show_header=any(header), pad_edge=False)
    for i, name in enumerate(header):
        right = bool(cells) and all(row[i][:1] in "+-−0123456789.–" for row in cells)  # '' is in any string
        out.add_column(Text(name), justify="right" if right else "left")
    for row in cells:
        out.add_row(*(Text(cell) for cell in row))
    if title:
        print(title)
    _console().print(out)


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
            task = bar.add_task(what, total=total)
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


def _console() -> Any:
    from rich.console import Console

    # A pipe or file gets whole lines: nothing is cut or wrapped to a width that nobody has.
    return Console(highlight=False, width=None if sys.stdout.isatty() else 1000)


def _version() -> str:
    from importlib import metadata

    try:
        return metadata.version("pcalib")
    except metadata.PackageNotFoundError:
        return "not installed"


def _help(source: Path) -> tuple[str, str]:
    """Help text and examples of a command, from its docstrings, without importing it."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    summary, _, examples = (ast.get_docstring(tree) or "").partition("\n\n")
    function = next((n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "command"), None)
    described = (ast.get_docstring(function) if function else None) or ""
    about = described.partition("\n\n")[2]
    for section in ("Args:", "Returns:", "Raises:"):
        about = about.partition(section)[0]
    # Paragraphs are wrapped to the terminal, not to the source.
    paragraphs = [summary, *(textwrap.dedent(about).split("\n\n"))]
    text = "\n\n".join(" ".join(part.split()) for part in paragraphs if part.strip())
    return text, _examples(examples)


def _examples(lines: str) -> str:
    return f"Examples:\n{textwrap.indent(inspect.cleandoc(lines), '  ')}" if lines.strip() else ""


def _usage(program: App, error: CycloptsError) -> str:
    """One clear message for wrong usage, with the command to ask for help."""
    chain = " ".join(error.command_chain or ())
    if isinstance(error, UnusedCliTokensError):
        message = f"unexpected argument '{(error.unused_tokens or [''])[0]}'"
    elif isinstance(error, UnknownCommandError):
        names = [n for n in program if not n.startswith("-")]
        given = (error.unused_tokens or [""])[0]
        message = f"unknown option '{given}'" if given.startswith("-") else unknown("command", given, names)
    else:
        message = str(error).strip()  # not for the above: cyclopts would import every command to write it
    name = f"{program.name[0]} {chain}".strip()
    return f"{message}\n  see {name} --help"
