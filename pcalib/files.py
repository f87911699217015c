"""Reading files: text, TOML and JSON, with messages that name file, line and key. Writing is in `pcalib.outputs`."""

from __future__ import annotations

import json
import math
import re
import stat
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from pcalib.errors import InputError
from pcalib.outputs import atomic as atomic
from pcalib.outputs import atomic_folder as atomic_folder
from pcalib.outputs import check_folder as check_folder
from pcalib.outputs import check_places as check_places
from pcalib.outputs import keeping_inputs as keeping_inputs
from pcalib.outputs import may_rewrite as may_rewrite
from pcalib.outputs import note_read, reason
from pcalib.outputs import write_text as write_text

LARGEST_TEXT = 50_000_000
"""Characters of a TOML file: a spec that lists 1e5 robots of 60 errors each has as many."""
DEEPEST = 64
"""Levels of nesting and parts of a dotted key; the project's own files have at most 4."""
_PART = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DOTTED = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}")
"""A dotted key of too many parts."""


def read_bytes(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        InputError: the file is absent, a directory, a device or unreadable.
    """
    try:
        if stat.S_ISCHR(path.stat().st_mode):
            raise InputError("is a device, not a file", file=path, remedy="name a file")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="check the path") from None
    except IsADirectoryError:
        raise InputError("is a directory, not a file", file=path, remedy="name a file in it") from None
    except (OSError, ValueError) as error:
        remedy = "check its name and its rights"
        raise InputError(f"cannot be read: {reason(error)}", file=path, remedy=remedy) from None
    note_read(path)
    return data


def read_text(path: str | Path) -> str:
    """The text of a UTF-8 file.

    Raises:
        InputError: the file is absent, a directory, unreadable, empty or not UTF-8.
    """
    path = Path(path)
    data = read_bytes(path)
    if not data.strip():
        raise InputError("the file is empty", file=path, remedy="check that it was saved, and that it is the right one")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise InputError("not UTF-8 text", file=path, line=line, remedy="save the file as UTF-8") from None


def parse_toml(text: str, source: str | Path, remedy: str) -> dict[str, Any]:
    """The table of a TOML text; `source` names the file in messages, and `remedy` says where its form is described.

    Raises:
        InputError: the text is not TOML, or beyond the limits of this module; the message has the line.
    """
    dotted = _DOTTED.search(text)  # tomllib takes 2 GB for a key of 20,000 parts
    if dotted or len(text) > LARGEST_TEXT:
        problem = f"a key has more than {DEEPEST} parts" if dotted else f"more than {LARGEST_TEXT} characters"
        line = text.count("\n", 0, dotted.end()) + 1 if dotted else None
        raise InputError(f"not usable TOML: {problem}", file=source, line=line, remedy=remedy)
    try:
        table = tomllib.loads(text)
    except RecursionError:  # brackets nested thousandfold
        raise InputError("not valid TOML: nested too deep", file=source, remedy=remedy) from None
    except tomllib.TOMLDecodeError as error:
        problem, _, place = str(error).partition(" (at line ")  # before Python 3.14 the line stands in the text only
        line = int(number) if (number := place.partition(",")[0]).isdigit() else text.count("\n") + 1
        raise InputError(f"not valid TOML: {problem:.200}", file=source, line=line, remedy=remedy) from None
    except ValueError:  # of int(), beyond 4300 digits
        raise _too_long(text, "=").but(file=source, remedy=remedy) from None
    with locating(text, source, remedy):
        _check_tree(table)
    return table


def parse_json(text: str, source: str | Path, remedy: str) -> dict[str, Any]:
    """The object of a JSON text; `source` names the file in messages.

    Raises:
        InputError: the text is not JSON, with the line; or it is no object, or beyond the limits of this module.
    """
    try:
        content = json.loads(text)
    except RecursionError:  # brackets nested thousandfold
        raise InputError("not valid JSON: nested too deep", file=source, remedy=remedy) from None
    except json.JSONDecodeError as error:
        raise InputError(f"not valid JSON: {error.msg}", file=source, line=error.lineno, remedy=remedy) from None
    except ValueError:  # of int(), beyond 4300 digits
        raise _too_long(text, ":").but(file=source, remedy=remedy) from None
    if not isinstance(content, dict):
        raise InputError("not a JSON object", file=source, remedy=remedy)
    with locating("", source, remedy):
        _check_tree(content)
    return content


def require_shape(value: Any, shape: Any, source: str | Path, remedy: str, where: str = "") -> None:
    """Check the content of a JSON file.

    Args:
        shape: `str` or `float` (a finite number); a list of one shape, that of each item; a dict of the shapes of
            required keys, or {"*": shape} for a dict with any keys; None beside a number is allowed by (float, None).

    Raises:
        InputError: the value, or a part of it, is of another shape; the message names the part.
    """
    def refuse(words: str) -> NoReturn:
        name = f"'{where}'" if where else "the file"
        raise InputError(f"{name} must be {words}, not {value!r:.40}", file=source, remedy=remedy)

    if isinstance(shape, tuple):
        if value is not None:
            require_shape(value, shape[0], source, remedy, where)
    elif isinstance(shape, list):
        if not isinstance(value, list):
            refuse("a list")
        for i, item in enumerate(value):
            require_shape(item, shape[0], source, remedy, f"{where}[{i}]")
    elif isinstance(shape, dict):
        if not isinstance(value, dict):
            refuse("an object")
        prefix = f"{where}." if where else ""
        for key in [key for key in shape if key != "*" and key not in value][:1]:
            raise InputError(f"'{prefix}{key}' is missing", file=source, remedy=remedy)
        for key in value if "*" in shape else shape:
            require_shape(value[key], shape.get(key, shape.get("*")), source, remedy, f"{prefix}{key}")
    elif shape is float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            refuse("a finite number")
    elif not isinstance(value, shape):
        refuse("text")


def _too_long(text: str, equals: str) -> InputError:
    """An error about the first whole number of thousands of digits, with its line and its key."""
    digits = re.search(r"\d(?:_?\d){4300}", text)
    line = text.count("\n", 0, digits.start()) + 1 if digits else 1
    key = text.splitlines()[line - 1].partition(equals)[0].strip(' "')
    return InputError(f"'{key:.80}' is a number of thousands of digits", line=line)


def _check_tree(table: dict[str, Any]) -> None:
    """Refuse what later steps cannot hold: whole numbers beyond 64 bits, and tables nested too deep."""
    left: list[tuple[tuple[str, ...], Any]] = [((), table)]
    while left:
        path, value = left.pop()
        if isinstance(value, (dict, list)):
            if len(path) > DEEPEST:
                raise InputError(f"nested more than {DEEPEST} deep", key=path[0])
            items = value.items() if isinstance(value, dict) else ((path[-1], item) for item in value)
            left += [((*path, str(key)), item) for key, item in items]
        elif isinstance(value, int) and abs(value) >= 2**63:
            section = ".".join(dict.fromkeys(path[:-1]))
            problem = f"[{section:.80}] '{path[-1]:.80}' must be a number of at most 64 bits"
            raise InputError(problem, key=path[-1], section=section)


@contextmanager
def locating(text: str, source: str | Path, remedy: str) -> Iterator[None]:
    """Give errors raised inside that name no file this file, and the line of the key that they name.

    Args:
        text: the file's text.
        remedy: the next step, where the error has none of its own.
    """
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        line = line_of(text, error.section, error.key or error.column)
        raise error.but(file=source, line=line, column=None, remedy=error.remedy or remedy) from None


@contextmanager
def named_by(source: str | Path, named: str | Path, key: str) -> Iterator[None]:
    """Read a file that another file names; what is wrong in it is told only where it lies beside that other file.

    Otherwise a file from somebody else could bring the content of any file of this machine into a message.
    """
    try:
        yield
    except InputError as error:
        if error.file is None or Path(named).resolve().is_relative_to(Path(source).resolve().parent):
            raise
        problem, remedy = f"'{key}' names a file that cannot be used", "name a file of the right kind"
        raise InputError(problem, key=key, remedy=remedy) from None


def line_of(text: str, section: str | None, key: str | None) -> int | None:
    """The line on which a TOML key is written; that of its section where the key is absent, None where both are.

    Args:
        section: dotted, as in its header; items of an array of tables are counted from 1, as in 'method[2]'.
        key: with its unit or without.
    """
    wanted = ".".join(part for part in (section, key) if part)
    best, found = 0, None
    for number, path in _paths(text):
        if path in (wanted, f"{wanted}[1]"):
            return number
        if path.startswith(f"{wanted}_"):
            fit = len(wanted) + 2
        elif section is None and path.endswith(f".{wanted}"):
            fit = len(wanted) + 1
        elif path == key:  # a key of the file itself, which messages call a section of the file's name
            fit = 1
        else:  # the nearest table above it
            fit = len(path) if path and wanted.startswith((f"{path}.", f"{path}[")) else 0
        if fit > best:
            best, found = fit, number
    return found


def _paths(text: str) -> Iterator[tuple[int, str]]:
    """The number of each line of a TOML text, and the dotted path of the section or key that it begins with."""
    header = ""
    arrays: Counter[str] = Counter()
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip().replace('"', "")
        if not bare.startswith("["):
            yield number, f"{header}.{bare.partition('=')[0].strip()}".strip(".")
            continue
        header = bare.strip("[").partition("]")[0].strip()
        if bare.startswith("[["):
            arrays[header] += 1
            header += f"[{arrays[header]}]"
        yield number, header
