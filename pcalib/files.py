"""Reading and writing files: text with clear messages, and writes that are whole or not at all."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcalib.errors import InputError

LARGEST_TEXT = 50_000_000
"""Characters of a TOML file: a spec that lists 1e5 robots of 60 errors each has as many."""
DEEPEST = 64
"""Levels of nesting and parts of a dotted key; the project's own files have at most 4."""
_PART = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DOTTED = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}")
"""A dotted key of too many parts."""


def read_text(path: str | Path) -> str:
    """The text of a UTF-8 file.

    Raises:
        InputError: the file is absent, a directory, unreadable, empty or not UTF-8.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="check the path") from None
    except IsADirectoryError:
        raise InputError("is a directory, not a file", file=path, remedy="name a file in it") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path, remedy="check its rights") from None
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
    except ValueError:  # a whole number of more than 4300 digits
        raise InputError("not valid TOML: a number of thousands of digits", file=source, remedy=remedy) from None
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
    except ValueError:  # a whole number of more than 4300 digits
        raise InputError("not valid JSON: a number of thousands of digits", file=source, remedy=remedy) from None
    if not isinstance(content, dict):
        raise InputError("not a JSON object", file=source, remedy=remedy)
    with locating("", source, remedy):
        _check_tree(content)
    return content


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


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends well, and vanishes when it does not.

    Raises:
        InputError: the folder is absent or cannot be written, or the disk is full.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError("cannot write: it is a directory", file=path, remedy="name a file")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        remedy = "name a folder that exists and is writable"
        raise InputError(f"cannot write: {error.strerror}", file=path, remedy=remedy) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except OSError as error:
        remedy = "make room, or name another folder"
        raise InputError(f"cannot write: {error.strerror}", file=path, remedy=remedy) from None
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """A temporary folder beside `path` whose content appears there when the block ends well, and not when it does not.

    Raises:
        InputError: the folder cannot be made or written, or the disk is full.
    """
    path = Path(path)
    remedy = "name a folder that can be made, and make room"
    check_folder(path)
    try:  # in the nearest folder that exists: those above `path` are made at the end only
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=_nearest(path.absolute().parent)))
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", file=path, remedy=remedy) from None
    try:
        yield temporary
        path.mkdir(parents=True, exist_ok=True)
        there = [item.name for item in temporary.iterdir() if (path / item.name).is_dir()]
        if there:
            raise InputError(f"there is a folder '{there[0]}' in it already", file=path, remedy="name a new folder")
        for item in temporary.iterdir():
            item.replace(path / item.name)
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", file=path, remedy=remedy) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_places(*paths: str | Path | None) -> None:
    """Say before long work, not after it, that a result has no place to go; None is no result.

    Raises:
        InputError: a path is a directory, or its folder is absent or cannot be written.
    """
    for path in (Path(p) for p in paths if p is not None):
        if path.is_dir():
            raise InputError("cannot write: it is a directory", file=path, remedy="name a file")
        folder = path.absolute().parent
        if not (folder.is_dir() and os.access(folder, os.W_OK)):
            what = "permission denied" if folder.is_dir() else "no such folder"
            raise InputError(f"cannot write: {what}", file=path, remedy="name a folder that exists and is writable")


def check_folder(path: str | Path | None) -> None:
    """The same for a folder of results, which need not be there yet.

    Raises:
        InputError: it is a file, or cannot be made or written.
    """
    if path is None:
        return
    there = _nearest(Path(path).absolute())
    if not (there.is_dir() and os.access(there, os.W_OK)):
        what = "permission denied" if there.is_dir() else f"{there.name} is a file"
        raise InputError(f"cannot make this folder: {what}", file=path, remedy="name a folder that can be made")


def _nearest(folder: Path) -> Path:
    """A path, or the nearest above it that exists."""
    return folder if folder.exists() else next(p for p in folder.parents if p.exists())


def write_text(path: str | Path, text: str) -> None:
    """Write a text file atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
