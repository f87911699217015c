"""Reading and writing files: text with clear messages, and writes that are whole or not at all."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcalib.errors import InputError


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
    """The table of a TOML text; `source` names it in messages, and `remedy` says where its form is described.

    Raises:
        InputError: not TOML, with the line.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:  # brackets nested thousandfold
        raise InputError("not valid TOML: nested too deep", file=source, remedy=remedy) from None
    except tomllib.TOMLDecodeError as error:
        problem, _, place = str(error).partition(" (at ")
        line = re.match(r"line (\d+)", place)
        number = int(line.group(1)) if line else text.count("\n") + 1
        raise InputError(f"not valid TOML: {problem}", file=source, line=number, remedy=remedy) from None


def parse_json(text: str, source: str | Path, remedy: str) -> dict[str, Any]:
    """The object of a JSON text; `source` names it in messages.

    Raises:
        InputError: not JSON, with the line, or no object.
    """
    try:
        content = json.loads(text)
    except RecursionError:  # brackets nested thousandfold
        raise InputError("not valid JSON: nested too deep", file=source, remedy=remedy) from None
    except json.JSONDecodeError as error:
        raise InputError(f"not valid JSON: {error.msg}", file=source, line=error.lineno, remedy=remedy) from None
    if not isinstance(content, dict):
        raise InputError("not a JSON object", file=source, remedy=remedy)
    return content


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
