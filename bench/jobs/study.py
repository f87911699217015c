"""Monte-Carlo studies: many trials, each a pure function of the study's source and the trial's number.

    study.py    what a study is, and its trials as Parquet         (this file)
    store.py    the folder of a study: parts written whole, resume, results.parquet
    running.py  where trials run: this process, processes of this machine, or a dask cluster
    methods.py  the ways to calibrate that studies compare

A study of a new kind is a class that derives from :class:`Study`; campaigns (`bench.jobs.campaign`) and the repetition
of the paper's study (`bench.jobs.savoure2006`) are two of them. Results depend on the source and on the versions of the
packages, and on nothing else: not on the number of workers, on the order in which they finish, or on interruptions.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import bench
from pcalib.errors import PcalibError

PACKAGES = ("pcalib", "numpy", "scipy", "mujoco", "pyarrow")
TRIALS = b"pcbench.trials"
"""Key of a part's metadata: the study's fingerprint, and the part's first and last trial."""
Row = Mapping[str, Any]
Task = tuple["type[Study]", str, range]
"""Kind and source of a study, and some of its trials: what travels to workers."""


class Study(ABC):
    """Many trials. What a worker needs to know about a study is its class and its `source`."""

    SCHEMA: ClassVar[str]
    """Name and version of the results, such as 'pcbench.campaign/1'."""
    name: str
    source: str
    """Everything that results depend on, as canonical JSON."""

    @classmethod
    @abstractmethod
    def parse(cls, source: str) -> Self:
        """The study of a source."""

    @property
    @abstractmethod
    def n_trials(self) -> int:
        """The number of trials."""

    @property
    @abstractmethod
    def part_trials(self) -> int:
        """The number of trials per part, which is the most that a kill can cost."""

    @abstractmethod
    def columns(self) -> Sequence[tuple[str, pa.DataType]]:
        """Names and types of the columns of the results."""

    @abstractmethod
    def rows(self, number: int) -> Sequence[Row]:
        """The rows of one trial; a column that a row lacks is null."""

    def given_up(self, number: int, reason: str) -> Sequence[Row]:
        """The rows of a trial whose process dies each time.

        Raises:
            PcalibError: a study of this kind cannot go on without the trial.
        """
        raise PcalibError(f"trial {number} of {self.name} could not be done: {reason}")

    def about(self) -> Mapping[str, Any]:
        """What the metadata of the results say beside schema, source and versions."""
        return {}

    @property
    def n_parts(self) -> int:
        """The number of parts."""
        return -(-self.n_trials // self.part_trials)

    def part(self, number: int) -> range:
        """The trials of a part."""
        first = number * self.part_trials
        return range(first, min(first + self.part_trials, self.n_trials))

    @property
    def key(self) -> bytes:
        """The key of the results' metadata: the schema's name."""
        return self.SCHEMA.partition("/")[0].encode()

    def schema(self) -> pa.Schema:
        """Columns and metadata of the results."""
        about = {
            "schema": self.SCHEMA, "name": self.name, **self.about(), "versions": dict(versions()),
            "spec": json.loads(self.source),
        }  # fmt: skip
        return pa.schema(list(self.columns()), metadata={self.key: json.dumps(about)})

    def mark(self, trials: range) -> bytes:
        """The metadata of a part: the study that it belongs to, and the trials that it holds."""
        digest = hashlib.sha256(f"{self.SCHEMA}\n{self.source}\n{json.dumps(dict(versions()))}".encode())
        return f"{digest.hexdigest()[:32]} {trials.start}-{trials.stop - 1}".encode()


def seed(study_seed: int, trial: int, purpose: int) -> int:
    """A seed of the stream of random numbers for one purpose in one trial."""
    return int(_sequence(study_seed, trial, purpose).generate_state(1, np.uint64)[0])


def stream(study_seed: int, trial: int, purpose: int) -> np.random.Generator:
    """The stream itself."""
    return np.random.Generator(np.random.PCG64(_sequence(study_seed, trial, purpose)))


def _sequence(study_seed: int, trial: int, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(study_seed, spawn_key=(purpose, trial))


def rows(study: Study, trials: Iterable[int]) -> list[Row]:
    """The rows of some trials, by one thread of linear algebra: more of them would change the rounding."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # about poses out of reach, which have a status
        return [row for number in trials for row in study.rows(number)]


def perform(task: Task) -> bytes:
    """Some trials of a study as a Parquet file: the work of a worker."""
    kind, source, trials = task
    study = kind.parse(source)
    return encode(study, trials, rows(study, trials))


def encode(study: Study, trials: range, found: Sequence[Row]) -> bytes:
    """Rows as a Parquet file, which says what it holds."""
    shape = pa.schema(list(study.columns()), metadata={TRIALS: study.mark(trials)})
    arrays = {field.name: pa.array([row.get(field.name) for row in found], field.type) for field in shape}
    out = io.BytesIO()
    pq.write_table(pa.table(arrays, schema=shape), out, compression="zstd")
    return out.getvalue()


@lru_cache(maxsize=1)
def versions() -> Mapping[str, str]:
    """The versions of python, of the packages that results depend on, and of this project's own code."""
    out = {"python": platform.python_version(), "machine": platform.machine(), "code": _code()}
    for name in PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out


def _code() -> str:
    """A digest of the project's programs and models, since the version number does not change with every edit."""
    root = Path(bench.__file__).parents[1]
    digest = hashlib.sha256()
    for folder, pattern in (("pcalib", "*.py"), ("bench", "*.py"), ("models", "*.xml")):
        for path in sorted((root / folder).rglob(pattern)):
            digest.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]
