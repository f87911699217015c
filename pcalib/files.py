"""Reading and writing files: text with clear messages, and writes that are whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
        raise InputError("is a directory, not a file", file=path) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    if not data.strip():
        raise InputError("the file is empty", file=path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise InputError("not UTF-8 text", file=path, line=line, remedy="save the file as UTF-8") from None


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
        raise InputError(f"cannot write: {error.strerror}", file=path) from None
    finally:
        temporary.unlink(missing_ok=True)


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


def write_text(path: str | Path, text: str) -> None:
    """Write a text file atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
