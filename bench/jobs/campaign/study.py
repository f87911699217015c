"""A campaign as a study: what its trials give, by column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from bench.jobs.campaign import spec as specs
from bench.jobs.campaign import trial
from bench.jobs.campaign.spec import Spec
from bench.jobs.campaign.sweep import label
from bench.jobs.study import Row, Study

_FIXED = (("cell", pa.int32()), ("robot", pa.int32()))
_FIGURES = (
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
)


class Campaign(Study):
    """A spec, to be run."""

    SCHEMA = specs.SCHEMA

    def __init__(self, spec: Spec):
        self.spec, self.name, self.source = spec, spec.name, spec.source
        self._types = {path: _type([label(step[path]) for step in axis]) for axis in spec.axes for path in axis[0]}

    @classmethod
    def parse(cls, source: str) -> Campaign:
        """The campaign of a spec's source."""
        return cls(specs.parse(source))

    @property
    def n_trials(self) -> int:
        """Robots in all; they are numbered cell after cell."""
        return self.spec.n_trials

    @property
    def part_trials(self) -> int:
        """Robots per part."""
        return self.spec.output.part_robots

    def columns(self) -> Sequence[tuple[str, pa.DataType]]:
        """Cell, robot, swept values, and figures of each method and tool."""
        swept = [(_column(path), kind) for path, kind in self._types.items()]
        return [*_FIXED, *swept, *_FIGURES]

    def about(self) -> Mapping[str, Any]:
        """Seed and robots per cell."""
        return {"seed": self.spec.seed, "robots": self.spec.robots}

    def rows(self, number: int) -> Sequence[Row]:
        """One row per method and tool."""
        return [{**self._head(number), **row} for row in trial.run(self.spec, number)]

    def given_up(self, number: int, reason: str) -> Sequence[Row]:
        """The rows of a robot that kills its process."""
        return [{**self._head(number), **row} for row in trial.given_up(self.spec, number, reason)]

    def _head(self, number: int) -> Row:
        cell, robot = divmod(number, self.spec.robots)
        point = {path: label(value) for path, value in self.spec.point(cell).items()}
        told = {_column(p): str(v) if self._types[p] == pa.string() else v for p, v in point.items()}
        return {"cell": cell, "robot": robot, **told}


def _column(path: str) -> str:
    """The column of a swept key."""
    return "robot.name" if path == "robot" else path


def _type(values: list[Any]) -> pa.DataType:
    if all(isinstance(v, bool) for v in values):
        return pa.bool_()
    if any(isinstance(v, (str, bool)) for v in values):
        return pa.string()
    return pa.int64() if all(isinstance(v, int) for v in values) else pa.float64()
