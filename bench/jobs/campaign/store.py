"""The folder of a campaign: parts that are written whole or not at all, and the results they make up.

    DIR/campaign.json      the spec with all it names, and versions: what a resumed run must agree with
    DIR/parts/000012.parquet   rows of 10 robots or so, each written under another name and then renamed
    DIR/results.parquet    all rows in order, once every part is there; the parts go then

Nothing in these files depends on when, where or in which order they were written, and no file holds a time.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import platform
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

import bench
from bench.jobs.campaign.spec import SCHEMA, Campaign
from bench.jobs.campaign.sweep import label
from pcalib import files
from pcalib.errors import InputError

KEY = b"pcbench.campaign"
"""Metadata of every Parquet file: JSON with spec, seed and versions."""
TRIALS = b"pcbench.trials"
"""Metadata of a part: its first and last trial."""
PACKAGES = ("pcalib", "numpy", "scipy", "mujoco", "pyarrow")
CLAIM, RESULTS = "campaign.json", "results.parquet"
GROUP_ROWS = 60_000
"""Rows per row group of the results: what has to be in memory at once."""
_FIXED = [
    ("cell", pa.int32()),
    ("robot", pa.int32()),
]
_FIGURES = [
    ("method", pa.string()),
    ("tool", pa.string()),
    ("tool_length_mm", pa.float64()),
    ("status", pa.string()),
    ("reason", pa.string()),
    ("measured", pa.int32()),
    ("targets", pa.int32()),
    ("reached", pa.int32()),
    ("rms_um", pa.float64()),
    ("p95_um", pa.float64()),
    ("max_um", pa.float64()),
    ("tilt_urad", pa.float64()),
    ("fit_rms_um", pa.float64()),
    ("fit_chi2_dof", pa.float64()),
    ("identified", pa.int32()),
    ("iterations", pa.int32()),
    ("prior_scale", pa.float64()),
    ("error_um", pa.list_(pa.float32())),
]


@lru_cache(maxsize=1)
def versions() -> Mapping[str, str]:
    """Of python, the packages that results depend on, and this project's own code."""
    out = {"python": platform.python_version(), "machine": platform.machine(), "code": _code()}
    for name in PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out


def _code() -> str:
    """A digest of the project's programs and models: a version number does not change with every edit."""
    root = Path(bench.__file__).parents[1]
    digest = hashlib.sha256()
    for folder, pattern in (("pcalib", "*.py"), ("bench", "*.py"), ("models", "*.xml")):
        for path in sorted((root / folder).rglob(pattern)):
            digest.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def schema(campaign: Campaign) -> pa.Schema:
    """Columns of the results, swept values among them, with the metadata."""
    swept = [(column(path), _type([label(p[path]) for p in campaign.points])) for path in campaign.paths]
    about = {
        "schema": SCHEMA,
        "name": campaign.name,
        "seed": campaign.seed,
        "robots": campaign.robots,
        "cells": [{path: label(value) for path, value in point.items()} for point in campaign.points],
        "versions": dict(versions()),
        "spec": json.loads(campaign.source),
    }
    return pa.schema([*_FIXED, *swept, *_FIGURES], metadata={KEY: json.dumps(about)})


def column(path: str) -> str:
    """The column of a swept key."""
    return "robot.name" if path == "robot" else path


def _type(values: list[Any]) -> pa.DataType:
    if all(isinstance(v, bool) for v in values):
        return pa.bool_()
    if any(isinstance(v, (str, bool)) for v in values):
        return pa.string()
    return pa.int64() if all(isinstance(v, int) for v in values) else pa.float64()


def encode(campaign: Campaign, part: int, rows: Iterable[Mapping[str, Any]]) -> bytes:
    """The rows of a part as a Parquet file."""
    shape = schema(campaign)
    about = {**(shape.metadata or {}), TRIALS: _trials(campaign, part)}
    ready = []
    for row in rows:
        point = {column(path): label(value) for path, value in row["point"].items()}
        mixed = {name: str(v) for name, v in point.items() if shape.field(name).type == pa.string()}
        ready.append({**row, **point, **mixed})
    arrays = {field.name: pa.array([row.get(field.name) for row in ready], field.type) for field in shape}
    out = io.BytesIO()
    pq.write_table(pa.table(arrays, schema=shape.with_metadata(about)), out, compression="zstd")
    return out.getvalue()


def _trials(campaign: Campaign, part: int) -> bytes:
    """Which trials a part holds: another version may cut a campaign up in another way."""
    trials = campaign.parts()[part]
    return f"{trials.start}-{trials.stop - 1}".encode()


class Store:
    """The folder of one campaign, held by one process at a time; use :func:`opened`."""

    def __init__(self, campaign: Campaign, folder: Path):
        self.campaign, self.folder = campaign, folder
        self.results = folder / RESULTS
        self._parts = folder / "parts"
        self._key = (schema(campaign).metadata or {})[KEY]

    def part(self, number: int) -> Path:
        """Where a part is kept."""
        return self._parts / f"{number:06d}.parquet"

    def missing(self) -> list[int]:
        """Numbers of the parts that are still to be done."""
        if self.finished():
            return []
        self._parts.mkdir(exist_ok=True)
        for litter in self._parts.glob(".*"):  # of a run that was killed while writing
            litter.unlink()
        return [number for number in range(len(self.campaign.parts())) if not self._done(number)]

    def finished(self) -> bool:
        """Whether all results are there."""
        return _metadata(self.results).get(KEY) == self._key

    def _done(self, number: int) -> bool:
        about = _metadata(self.part(number))
        return about.get(KEY) == self._key and about.get(TRIALS) == _trials(self.campaign, number)

    def write(self, number: int, content: bytes) -> None:
        """Keep a part.

        Raises:
            InputError: it cannot be written, because the disk is full for one.
        """
        with _explained(self.folder), files.atomic(self.part(number)) as temporary:
            temporary.write_bytes(content)

    def finish(self) -> None:
        """Make the results of the parts, and let the parts go."""
        if not self.finished():
            with _explained(self.folder), files.atomic(self.results) as temporary, temporary.open("wb") as stream:
                shape = schema(self.campaign)
                with pq.ParquetWriter(stream, shape, compression="zstd") as writer:
                    waiting: list[pa.Table] = []
                    for number in range(len(self.campaign.parts())):
                        waiting.append(pq.read_table(self.part(number)).cast(shape))
                        if sum(map(len, waiting)) >= GROUP_ROWS:
                            writer.write_table(pa.concat_tables(waiting))
                            waiting = []
                    if waiting:
                        writer.write_table(pa.concat_tables(waiting))
        if self._parts.is_dir():
            for path in self._parts.iterdir():
                path.unlink()
            self._parts.rmdir()


def _metadata(path: Path) -> Mapping[bytes, bytes]:
    """Of a Parquet file; empty where there is none or it is not complete: the metadata stand at its end."""
    try:
        return pq.read_schema(path).metadata or {}
    except (FileNotFoundError, pa.ArrowException, OSError):
        return {}


@contextmanager
def opened(campaign: Campaign, folder: Path) -> Iterator[Store]:
    """The store in a folder, which is made where it does not exist, and claimed for this spec.

    Raises:
        InputError: the folder cannot be used, belongs to another spec or other versions, or is in use.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", file=folder, remedy="name a folder") from None
    with _lock(folder):
        for name in (CLAIM, RESULTS):
            for litter in folder.glob(f".{name}.*"):  # of a run that was killed while writing
                litter.unlink()
        _claim(campaign, folder)
        yield Store(campaign, folder)


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    try:
        stream = (folder / ".lock").open("a")
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", file=folder, remedy="name a writable folder") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                "another campaign is writing to this folder", file=folder, remedy="wait for it, or use another folder"
            ) from None
        yield  # the lock goes with the stream, or with the process


def _claim(campaign: Campaign, folder: Path) -> None:
    path = folder / CLAIM
    ours = {"schema": SCHEMA, "versions": dict(versions()), "spec": json.loads(campaign.source)}
    if not path.exists():
        strangers = [p.name for p in folder.iterdir() if not p.name.startswith(".")]
        if strangers:
            raise InputError(
                f"the folder holds other things ({', '.join(sorted(strangers)[:3])}) and no campaign", file=folder,
                remedy="use a folder of its own",
            )  # fmt: skip
        with _explained(folder):
            files.write_text(path, json.dumps(ours, indent=2, ensure_ascii=False) + "\n")
        return
    theirs = files.parse_json(files.read_text(path), path, "use another folder")
    for what, remedy in (
        ("spec", "use another folder for the changed spec, or the spec as it was to go on"),
        ("versions", "go on with the versions it was begun with, or use another folder"),
    ):
        changed = list(differences(theirs.get(what, {}), ours[what]))
        if not changed and json.dumps(theirs.get(what)) != json.dumps(ours[what]):
            changed = ["the order of its keys"]
        if changed:
            more = f" and {len(changed) - 4} more" if len(changed) > 4 else ""
            differ = "differs" if what == "spec" else "differ"
            raise InputError(
                f"the folder belongs to another campaign, its {what} {differ}: {'; '.join(changed[:4])}{more}",
                file=folder, remedy=remedy,
            )  # fmt: skip


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
    return text if len(text) <= 40 else text[:37] + "…"


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    """Say of a write that failed that nothing is lost."""
    try:
        yield
    except InputError as error:
        raise InputError(
            error.problem, file=folder,
            remedy="finished parts are kept: make room, and run the same command again to go on",
        ) from None  # fmt: skip
