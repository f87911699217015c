"""Writing files: the one way by which every result gets to where it was asked for.

A regular file is written whole or not at all, through symlinks, and keeps the mode and the owner that it had. Devices
and FIFOs are written into. While a command runs, a file that it has read is not overwritten.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import stat
import sys
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from pcalib.errors import InputError

_HOST = f"{zlib.crc32(socket.gethostname().encode(errors='replace')):08x}"
_OURS = re.compile(r"\.pcalib-([0-9a-f]{8})-(\d+)-")
"""Names of temporary files and folders: host and process that write them, so that what a killed one left is known."""


@dataclass
class _Run:
    """What a command has read so far, and what it may overwrite nevertheless."""

    rewritten: set[str] = field(default_factory=set)
    read: set[tuple[int, int]] = field(default_factory=set)


_run: _Run | None = None


@contextmanager
def keeping_inputs() -> Iterator[None]:
    """Inside, no file that has been read is overwritten, except those that `may_rewrite` names."""
    global _run
    before, _run = _run, _Run()
    try:
        yield
    finally:
        _run = before


def may_rewrite(paths: Iterable[Path]) -> None:
    """Allow a command to overwrite these files though it reads them."""
    if _run is not None:
        _run.rewritten |= {os.path.realpath(path) for path in paths}


def note_read(path: Path) -> None:
    """Remember that a file has been read."""
    if _run is not None:
        with suppress(OSError, ValueError):
            there = path.stat()
            _run.read.add((there.st_dev, there.st_ino))


@dataclass(frozen=True)
class _Place:
    """Where a result goes."""

    path: Path
    """As it was given."""
    target: Path
    """Behind symlinks."""
    there: os.stat_result | None
    """What is there already."""

    @property
    def stream(self) -> bool:
        """Whether it is written into, not replaced: a device, a FIFO, or what standard output goes to."""
        if self.there is None:
            return False
        return not stat.S_ISREG(self.there.st_mode) or self.standard is not None

    @property
    def standard(self) -> int | None:
        """1 or 2 where it is the file of standard output or standard error."""
        for number in (1, 2):
            with suppress(OSError):
                if self.there is not None and os.path.samestat(self.there, os.fstat(number)):
                    return number
        return None


def _place(path: str | Path) -> _Place:
    """Where a result goes.

    Raises:
        InputError: nothing can be written there, or a file is there that is read or read-only.
    """
    path = Path(path)

    def refused(what: str, remedy: str = "name a folder that exists and is writable") -> InputError:
        return InputError(f"cannot write: {what}", file=path, remedy=remedy)

    there = None
    try:
        with suppress(FileNotFoundError):
            there = path.stat()
        target = Path(os.path.realpath(path))
    except (OSError, ValueError) as error:
        raise refused(reason(error)) from None
    if there is not None and stat.S_ISDIR(there.st_mode):
        raise refused("it is a directory", "name a file")
    place = _Place(path, target, there)
    if place.stream:
        return place
    if not (target.parent.is_dir() and os.access(target.parent, os.W_OK)):
        raise refused("permission denied" if target.parent.is_dir() else "no such folder")
    if there is not None:
        if not (there.st_mode & 0o222 and os.access(target, os.W_OK)):
            raise refused("the file is read-only", "write to another file, or change its rights")
        if _run and (there.st_dev, there.st_ino) in _run.read and str(target) not in _run.rewritten:
            raise InputError("this file is read, and would be overwritten", file=path, remedy="write to another file")
    return place


def check_places(*paths: str | Path | None) -> None:
    """Say before long work, not after it, that a result has no place to go; None is no result.

    Raises:
        InputError: a path is a directory or read-only, or its folder is absent or cannot be written.
    """
    for path in paths:
        if path is not None:
            place = _place(path)
            if not place.stream:
                _sweep(place.target.parent)


def check_folder(path: str | Path | None) -> None:
    """Check that a folder of results, which need not be there yet, can be written.

    Raises:
        InputError: it is a file, or cannot be made or written.
    """
    if path is None:
        return
    try:
        there = _nearest(Path(path).absolute())
    except (OSError, ValueError) as error:
        raise InputError(f"cannot make this folder: {reason(error)}", file=path, remedy="name another folder") from None
    if not (there.is_dir() and os.access(there, os.W_OK)):
        what = "permission denied" if there.is_dir() else f"{there.name} is a file"
        raise InputError(f"cannot make this folder: {what}", file=path, remedy="name a folder that can be made")
    _sweep(there)


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """A temporary path whose content gets to `path` when the block ends well, and vanishes when it does not.

    Raises:
        InputError: the place cannot be written, or the disk is full.
    """
    place = _place(path)
    folder = Path(tempfile.gettempdir()) if place.stream else place.target.parent
    try:
        handle, name = tempfile.mkstemp(prefix=_prefix(place.target), suffix=place.target.suffix[:20], dir=folder)
    except OSError as error:
        remedy = "name a folder that exists and is writable"
        raise InputError(f"cannot write: {reason(error)}", file=path, remedy=remedy) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        _put(temporary, place)
    except OSError as error:
        remedy = "make room, or name another folder"
        raise InputError(f"cannot write: {reason(error)}", file=path, remedy=remedy) from None
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """A temporary folder whose content appears at `path` when the block ends well, and not when it does not.

    Raises:
        InputError: the folder cannot be made or written, the disk is full, or a file in it is read or read-only.
    """
    path = Path(path)
    remedy = "name a folder that can be made, and make room"
    check_folder(path)
    try:  # in the nearest folder that exists: those above `path` are made at the end only
        temporary = Path(tempfile.mkdtemp(prefix=_prefix(path), dir=_nearest(path.absolute().parent)))
    except OSError as error:
        raise InputError(f"cannot write: {reason(error)}", file=path, remedy=remedy) from None
    try:
        yield temporary
        if not path.exists():
            path.absolute().parent.mkdir(parents=True, exist_ok=True)
            temporary.chmod(0o777 & ~_umask())
            temporary.rename(path)
            return
        for item in temporary.iterdir():
            if item.is_dir() and (path / item.name).exists():
                there = f"there is a folder '{item.name}' in it already"
                raise InputError(there, file=path, remedy="name a new folder")
        places = [(item, _place(path / item.name)) for item in temporary.iterdir()]
        for item, place in places:
            _put(item, place)
    except OSError as error:
        raise InputError(f"cannot write: {reason(error)}", file=path, remedy=remedy) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: str | Path, text: str, errors: str = "replace") -> None:
    """Write a text file as UTF-8; what is no character, as in a file name of another encoding, becomes '?'."""
    with atomic(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", errors))


def _put(temporary: Path, place: _Place) -> None:
    """Bring what was written to its place."""
    if place.stream:
        _pour(temporary, place)
        return
    if place.there is None:
        temporary.chmod((0o777 if temporary.is_dir() else 0o666) & ~_umask())
    else:
        try:
            if (place.there.st_uid, place.there.st_gid) != (os.geteuid(), os.getegid()):
                os.chown(temporary, place.there.st_uid, place.there.st_gid)
        except PermissionError:  # a file of somebody else's keeps its owner only if it is not replaced
            shutil.copyfile(temporary, place.target)
            return
        temporary.chmod(stat.S_IMODE(place.there.st_mode))
    temporary.replace(place.target)


def _pour(temporary: Path, place: _Place) -> None:
    """Write into a device, a FIFO or standard output."""
    number = place.standard
    if number is not None:  # at its own position in the file, after what has been printed
        stream = (sys.stdout, sys.stderr)[number - 1]
        if stream is not None:
            stream.flush()
    to = os.dup(number) if number is not None else os.open(place.path, os.O_WRONLY)
    with open(to, "wb") as out, temporary.open("rb") as written:
        shutil.copyfileobj(written, out)


def _prefix(path: Path) -> str:
    return f".{path.name[:40]}.pcalib-{_HOST}-{os.getpid()}-"


def _sweep(folder: Path) -> None:
    """Remove from a folder what a killed process of this machine was writing."""
    with suppress(OSError):
        for item in os.scandir(folder):
            ours = _OURS.search(item.name)
            if ours and item.name.startswith(".") and ours.group(1) == _HOST and not _runs(int(ours.group(2))):
                if item.is_dir(follow_symlinks=False):
                    shutil.rmtree(item.path, ignore_errors=True)
                else:
                    os.unlink(item.path)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass
    return True


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _nearest(folder: Path) -> Path:
    """A path, or the nearest above it that exists."""
    return folder if folder.exists() else next(p for p in folder.parents if p.exists())


def reason(error: BaseException) -> str:
    """Why a file cannot be used, as the system says it."""
    return error.strerror if isinstance(error, OSError) and error.strerror else str(error)
