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
`command` returns the exit code, None for 0. A parameter of type `Path` is a file that is read; one with
:class:`~pcalib.cli._places.Writes` in its annotation, as the options below have it, is written. The file is imported
only when its command runs, and should itself import what is heavy inside `command`. Files that start with `_`, and
this one, are no commands.
"""

from __future__ import annotations

import ast
import inspect
import json
import math
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError, MissingArgumentError, UnknownCommandError, UnusedCliTokensError
from cyclopts.validators import Number

from pcalib.cli import _guard
from pcalib.cli._guard import BAD_INPUT, INTERRUPTED, NOT_HELD, OK, PIPE_CLOSED, UNFORESEEN, fail
from pcalib.cli._places import (
    BesideOption,
    JsonOption,
    OutputFolder,
    OutputOption,
    Reads,
    RequiredOutput,
    RewriteOption,
    Writes,
    check,
)  # fmt: skip
from pcalib.cli._printing import progress, say, show_table
from pcalib.errors import unknown

__all__ = [
    "BAD_INPUT", "INTERRUPTED", "NOT_HELD", "OK", "PIPE_CLOSED", "UNFORESEEN", "BesideOption", "JsonOption",
    "OutputFolder", "OutputOption", "Reads", "RequiredOutput", "RewriteOption", "SeedOption", "WorkersOption",
    "Writes", "app", "count", "fail", "plain", "progress", "quantity", "run", "say", "script", "show_table",
    "write_json",
]  # fmt: skip

# Matrices here are small: a second BLAS thread costs more than it brings. Read when NumPy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SeedOption = Annotated[int, Parameter(validator=Number(gte=0, lt=2**63))]
WorkersOption = Annotated[int, Parameter(validator=Number(gte=1, lte=1024))]

MOST_ROWS = 10_000_000
"""Rows that a command makes at most: what a day of computing gives. More is a slip of the keyboard."""


def count(most: int = MOST_ROWS, least: int = 1) -> Parameter:
    """An option that says how many."""
    return Parameter(validator=Number(gte=least, lte=most))


_PLAIN = Parameter(negative=(), show_default=lambda value: None if value in (None, "", ()) else str(value))
"""What holds for every option: there is no --no-…, and an empty default is not shown."""


def app(
    name: str, package: str, path: Iterable[str], description: str, examples: str = "", argv: Sequence[str] | None = ()
) -> App:
    """A program whose commands are the files of `package`, which lies at `path`; none of them is imported.

    Where `argv` (that of the process where None) begins with a command, only the file of this command is read.
    """
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
    commands = sorted(module for module in files if not module.startswith("_") and module != "frame")
    first = [word.replace("-", "_") for word in _tokens(argv)[:1]]
    for module in first if first and first[0] in commands else commands:
        text, examples = _help(files[module])
        program.command(
            f"{package}.{module}:command", name=module.replace("_", "-"), help=text, help_epilogue=examples,
            validator=partial(_check_places, partial(_command_of, f"{package}.{module}")),
        )  # fmt: skip
    return program


def script(name: str, command: Callable[..., int | None], argv: Sequence[str] | None = None) -> int:
    """Run a program of one command; returns the exit code."""
    program = App(
        name=name, help_format="plaintext", version_flags=[], result_action="return_value",
        default_parameter=_PLAIN, suppress_keyboard_interrupt=False,
    )  # fmt: skip
    program.default(command, validator=partial(_check_places, lambda: command))
    return run(program, argv)


def run(program: App, argv: Sequence[str] | None = None) -> int:
    """Run a program and return its exit code; every error is one message on stderr."""
    from pcalib import files

    if argv is None:
        _guard.quiet()
    tokens = _tokens(argv)

    def work() -> int | None:
        try:
            with files.keeping_inputs():
                return program(tokens, exit_on_error=False, print_error=False)
        except CycloptsError as error:
            return fail(_usage(program, error))

    return _guard.guarded(work, tokens)


def _tokens(argv: Sequence[str] | None) -> list[str]:
    return sys.argv[1:] if argv is None else list(argv)


def _command_of(module: str) -> Callable[..., Any]:
    return import_module(module).command


def _check_places(command: Callable[[], Callable[..., Any]], /, **given: Any) -> None:
    """Check the files of a command before its work begins."""
    from pcalib import files

    files.may_rewrite(check(command(), given))


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

    text = json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    files.write_text(path, text, errors="backslashreplace")  # names that are not UTF-8 are escaped as JSON does


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


def _version() -> str:
    from importlib import metadata

    from pcalib.mechanics import extension

    try:
        return f"{metadata.version('pcalib')} ({extension.about()})"
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
    elif isinstance(error, MissingArgumentError) and error.argument is not None:
        message = f"{error.argument.name} is missing, or has no value"
    else:
        message = str(error).strip()  # not for the above: cyclopts would import every command to write it
    name = f"{program.name[0]} {chain}".strip()
    return f"{message}\n  see {name} --help"
