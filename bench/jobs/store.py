"""The folder of a study: parts that are written whole or not at all, and the results they make up.

    DIR/study.json                         source and versions: what a resumed run must agree with
    DIR/parts/000000120-000000129.parquet  the rows of trials 120 to 129
    DIR/results.parquet                    all rows in order, once every part is there; the parts are removed then
    DIR/damaged/                           files that could not be read any more, set aside

Nothing in these files depends on when, where or in which order they were written.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from bench.jobs.study import TRIALS, Study, versions
from pcalib import files
from pcalib.errors import InputError
from pcalib.wording import short

RESULTS = "results.parquet"
GROUP_ROWS = 60_000
"""Rows per row group of the results, which bounds what is in memory at once."""
MAGIC = b"PAR1"
"""The first and the last bytes of a Parquet file."""


class Store:
    """The folder of one study, held by one process at a time; use :func:`opened`."""

    def __init__(self, study: Study, folder: Path, say: Callable[[str], None] = lambda text: None):
        self.study, self.folder, self.say = study, folder, say
        self.results = folder / RESULTS
        self.parts = folder / "parts"

    def part(self, trials: range) -> Path:
        """Where the part with these trials is kept."""
        return self.parts / f"{trials.start:09d}-{trials.stop - 1:09d}.parquet"

    def missing(self) -> list[range]:
        """The parts that are still to be done. The cost is one look at each part that is there."""
        if self.finished():
            return []
        with _explained(self.folder):
            self.parts.mkdir(exist_ok=True)
        there = set()
        for path in self.parts.iterdir():
            if path.name.startswith("."):  # of a run that was killed while writing
                path.unlink()
            elif _complete(path):
                there.add(path.name)
        parts = (self.study.part(number) for number in range(self.study.n_parts))
        return [trials for trials in parts if self.part(trials).name not in there]

    def kept(self) -> int:
        """The number of trials that are on disk."""
        if self.results.exists():
            return self.study.n_trials
        there = {path.name for path in self.parts.iterdir()} if self.parts.is_dir() else set()
        parts = (self.study.part(number) for number in range(self.study.n_parts))
        return sum(len(trials) for trials in parts if self.part(trials).name in there)

    def finished(self) -> bool:
        """Whether all results are there and can be read; results that cannot be read are set aside."""
        if not self.results.exists():
            return False
        try:
            file = pq.ParquetFile(self.results)
            if file.schema_arrow.metadata != self.study.schema().metadata:
                raise pa.ArrowInvalid("it belongs to another study")
            for number in range(file.num_row_groups):
                file.read_row_group(number)
        except (pa.ArrowException, OSError) as error:
            self._set_aside(self.results, error)
            return False
        return True

    def write(self, trials: range, content: bytes) -> None:
        """Keep a part.

        Raises:
            InputError: it cannot be written, for example because the disk is full.
        """
        with _explained(self.folder), files.atomic(self.part(trials)) as temporary:
            temporary.write_bytes(content)

    def finish(self) -> list[range]:
        """Make the results of the parts and remove the parts.

        Returns:
            The parts that turned out to be damaged and were set aside: they have to be done again first.
        """
        damaged: list[range] = []
        if not self.results.exists():
            with _explained(self.folder), _Given() as given, files.atomic(self.results) as temporary:
                with temporary.open("wb") as stream:
                    self._merge(stream, damaged)
                if damaged:
                    given.up()
        if not damaged and self.parts.is_dir():
            for path in self.parts.iterdir():
                path.unlink()
            self.parts.rmdir()
        return damaged

    def _merge(self, stream: Any, damaged: list[range]) -> None:
        shape = self.study.schema()
        with pq.ParquetWriter(stream, shape, compression="zstd") as writer:
            waiting: list[pa.Table] = []
            for number in range(self.study.n_parts):
                trials = self.study.part(number)
                try:
                    table = pq.read_table(self.part(trials))
                    if (table.schema.metadata or {}).get(TRIALS) != self.study.mark(trials):
                        raise pa.ArrowInvalid("it belongs to another study or holds other trials")
                    waiting.append(table.cast(shape))
                except (pa.ArrowException, OSError) as error:
                    self._set_aside(self.part(trials), error)
                    damaged.append(trials)
                if sum(map(len, waiting)) >= GROUP_ROWS:
                    writer.write_table(pa.concat_tables(waiting))
                    waiting = []
            if waiting:
                writer.write_table(pa.concat_tables(waiting))

    def _set_aside(self, path: Path, error: Exception) -> None:
        """Move a file that cannot be read out of the way, and say so."""
        why = (str(error).splitlines() or [""])[0]
        place = self.folder / "damaged" / path.name
        with _explained(self.folder):
            place.parent.mkdir(exist_ok=True)
            if path.exists():
                path.replace(place)
        self.say(f"{path} is damaged ({why}): it was moved to {place.parent}, and its trials are done again")


class _Given:
    """Leaves a block without its result, quietly."""

    def __enter__(self) -> _Given:
        return self

    def up(self) -> None:
        raise _GivenUpError

    def __exit__(self, kind: Any, error: Any, trace: Any) -> bool:
        return isinstance(error, _GivenUpError)


class _GivenUpError(Exception):
    pass


def _complete(path: Path) -> bool:
    """Whether a Parquet file has its beginning and its end."""
    try:
        with path.open("rb") as stream:
            if stream.read(4) != MAGIC:
                return False
            stream.seek(-4, 2)
            return stream.read(4) == MAGIC
    except OSError:
        return False


@contextmanager
def opened(
    study: Study, folder: Path, say: Callable[[str], None] = lambda text: None, *, renew: bool = False
) -> Iterator[Store]:
    """The store in a folder, which is made where it does not exist, and is claimed for this study.

    Args:
        say: called with what the user should know, such as damaged files.
        renew: whether results of another source or version that lie in the folder are deleted, not refused.

    Raises:
        InputError: the folder cannot be used, belongs to another study or other versions, or is in use.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("a")
    except OSError as error:
        problem = f"cannot write here: {error.strerror}"
        raise InputError(problem, file=folder, remedy="name a folder that can be made and written") from None
    with lock:  # the lock goes with the stream, or with the process
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                "another run is writing to this folder", file=folder, remedy="wait for it, or use another folder"
            ) from None
        for name in (claim_name(study), RESULTS):
            for litter in folder.glob(f".{name}.*"):  # of a run that was killed while writing
                litter.unlink()
        _claim(study, folder, renew)
        yield Store(study, folder, say)


def claim_name(study: Study) -> str:
    """The file that says whose folder it is: campaign.json for campaigns."""
    return study.key.decode().rpartition(".")[2] + ".json"


def _claim(study: Study, folder: Path, renew: bool) -> None:
    path = folder / claim_name(study)
    ours = {"schema": study.SCHEMA, "versions": dict(versions()), "spec": json.loads(study.source)}
    if path.exists():
        theirs = files.parse_json(files.read_text(path), path, "use another folder")
        differing = _differing(theirs, ours)
        if differing is None:
            return
        if not renew:
            raise InputError(differing[0], file=folder, remedy=differing[1])
        for old in [folder / RESULTS, *(folder / "parts").glob("*")]:
            old.unlink(missing_ok=True)
    else:
        strangers = [p.name for p in folder.iterdir() if not p.name.startswith(".")]
        if strangers:
            raise InputError(
                f"the folder holds other things ({', '.join(sorted(strangers)[:3])}) and no {path.name}", file=folder,
                remedy="use a folder of its own",
            )  # fmt: skip
    with _explained(folder):
        files.write_text(path, json.dumps(ours, indent=2, ensure_ascii=False) + "\n")


def _differing(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> tuple[str, str] | None:
    """The difference between two claims, and what to do about it; None where they agree."""
    for what, differ, remedy in (
        ("spec", "differs", "use another folder for the changed spec, or go on with the spec as it was"),
        ("versions", "differ", "go on with the versions it was begun with, or use another folder"),
    ):
        changed = list(differences(theirs.get(what, {}), ours[what]))
        if not changed and json.dumps(theirs.get(what)) != json.dumps(ours[what]):
            changed = ["the order of its keys"]
        if changed:
            more = f" and {len(changed) - 4} more" if len(changed) > 4 else ""
            told = "; ".join(changed[:4])
            return f"the folder belongs to another campaign, its {what} {differ}: {told}{more}", remedy
    return None


def differences(old: Any, new: Any, path: str = "") -> Iterator[str]:
    """Where two nested tables differ, in words: 'plan.poses: 40 → 60'."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted({*old, *new}):
            yield from differences(old.get(key), new.get(key), f"{path}.{key}" if path else key)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (a, b) in enumerate(zip(old, new, strict=True), 1):
            yield from differences(a, b, f"{path}[{i}]")
    elif old != new:
        yield f"{path}: {_short(old)} → {_short(new)}"


def _short(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return short(text, 40)


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Say of a write that failed that finished work is not lost."""
    try:
        yield
    except (InputError, OSError) as error:
        problem = error.problem if isinstance(error, InputError) else f"cannot write: {error.strerror}"
        raise InputError(
            problem, file=folder, remedy="finished parts are kept: make room, and run the same command again to go on"
        ) from None
