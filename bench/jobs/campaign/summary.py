"""What a campaign found, in figures per cell, method and tool."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.jobs.campaign import spec as specs
from bench.jobs.campaign.spec import Spec
from bench.jobs.campaign.study import Campaign
from bench.jobs.campaign.sweep import label, short
from pcalib.data import table as tables
from pcalib.errors import InputError
from pcalib.wording import size


@dataclass(frozen=True, eq=False)
class RobotGroup:
    """All robots of one cell, with one method and one tool."""

    cell: int
    point: Mapping[str, Any]
    """The swept values of the cell."""
    method: str
    tool: str
    tool_length: float
    """[m]"""
    robot: np.ndarray
    """(n,) numbers of the robots that gave figures."""
    rms: np.ndarray
    """(n,) [m] RMS TCP error of each robot over its targets."""
    largest: np.ndarray
    """(n,) [m] largest TCP error of each robot."""
    failed: int
    reached: float
    """Share of the targets that robots which gave figures reached."""

    @property
    def pooled(self) -> float:
        """[m] RMS over all robots and targets."""
        return float(np.sqrt(np.mean(self.rms**2))) if len(self.rms) else float("nan")

    def percentile(self, share: float) -> float:
        """[m] RMS error that this share of the robots (in percent) stays below."""
        return float(np.percentile(self.rms, share)) if len(self.rms) else float("nan")

    @property
    def worst(self) -> float:
        """[m] largest error of all."""
        return float(self.largest.max(initial=0.0)) if len(self.largest) else float("nan")

    @property
    def worst_robot(self) -> int | None:
        """Number of the robot with the largest RMS error."""
        return int(self.robot[np.argmax(self.rms)]) if len(self.rms) else None


@dataclass(frozen=True, eq=False)
class Summary:
    """A campaign's results in figures."""

    spec: Spec
    versions: Mapping[str, str]
    groups: tuple[RobotGroup, ...]
    reasons: Mapping[str, int]
    """Why rows have no figures, with their number, the most frequent first."""

    @property
    def points(self) -> dict[int, Mapping[str, Any]]:
        """The swept values of each cell that has rows."""
        return {g.cell: g.point for g in self.groups}

    @property
    def failed(self) -> int:
        """Rows without figures."""
        return sum(self.reasons.values())


Key = tuple[int, str, str, float]


def read(results: Path) -> Summary:
    """The summary of a results file, which is read a row group at a time.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        file = pq.ParquetFile(results)
        return of((file.read_row_group(i, columns=COLUMNS) for i in range(file.num_row_groups)), file.schema_arrow)
    except (pa.ArrowException, OSError) as error:
        why = (str(error).splitlines() or [""])[0]
        remedy = "run the campaign again: what cannot be read is set aside and done again"
        raise InputError(f"is damaged: {why}", file=results, remedy=remedy) from None


NUMBERS = ["cell", "robot", "reached", "targets", "rms_um", "max_um"]
COLUMNS = [*NUMBERS, "method", "tool", "tool_length_mm", "status", "reason"]


def of(tables: Iterable[pa.Table], schema: pa.Schema) -> Summary:
    """The summary of results, given in pieces, and their schema, whose metadata hold the spec."""
    about = json.loads((schema.metadata or {})[Campaign.SCHEMA.partition("/")[0].encode()])
    spec = specs.parse(json.dumps(about["spec"]))
    gathered: dict[Key, list[list[np.ndarray]]] = {}
    counts: dict[Key, np.ndarray] = {}
    reasons: Counter[str] = Counter()
    for piece in tables:
        ok = np.array(piece["status"].to_pylist()) == "ok"
        reasons.update(reason for reason, fine in zip(piece["reason"].to_pylist(), ok, strict=True) if not fine)
        values = {name: piece[name].to_numpy() for name in NUMBERS}
        rows: dict[Key, list[int]] = {}
        keys = zip(*(piece[name].to_pylist() for name in ("cell", "method", "tool", "tool_length_mm")), strict=True)
        for row, key in enumerate(keys):
            rows.setdefault(key, []).append(row)
        for key, where in rows.items():
            here = np.array(where)
            good = here[ok[here]]
            gathered.setdefault(key, []).append([values[name][good] for name in ("robot", "rms_um", "max_um")])
            told = np.array([len(here) - len(good), values["reached"][good].sum(), values["targets"][good].sum()])
            counts[key] = counts.get(key, 0) + told
    groups = []
    for (cell, method, tool, length), pieces in gathered.items():
        robot, rms, largest = (np.concatenate(part) for part in zip(*pieces, strict=True))
        failed, reached, targets = counts[cell, method, tool, length]
        share = float(reached / targets) if targets else 0.0
        point = {path: label(value) for path, value in spec.point(cell).items()}
        groups.append(
            RobotGroup(cell, point, method, tool, length * 1e-3, robot, rms * 1e-6, largest * 1e-6, int(failed), share)
        )
    return Summary(spec, about["versions"], tuple(groups), dict(reasons.most_common()))


HEADER = ("method", "tool mm", "robots", "failed", "reached", "RMS", "median", "95 % below", "max", "worst robot")


def table(summary: Summary) -> tuple[list[str], list[list[str]]]:
    """Header and rows for people: pooled RMS, median and 95th percentile over robots of their RMS, largest error."""
    rows = []
    for g in summary.groups:
        figures = [g.pooled, g.percentile(50), g.percentile(95), g.worst]
        rows.append(
            [
                *(short(g.point[path]) for path in summary.spec.paths),
                g.method,
                tool_text(g),
                str(len(g.rms)),
                str(g.failed or ""),
                f"{100 * g.reached:.1f} %" if g.reached < 1 else "all",
                *(size(v) for v in figures),
                "–" if g.worst_robot is None else str(g.worst_robot),
            ]
        )
    ends = [path.rpartition(".")[2] for path in summary.spec.paths]
    return [*(ends if len(set(ends)) == len(ends) else summary.spec.paths), *HEADER], rows


def write_csv(summary: Summary, path: Path) -> Path:
    """The figures of every group, one row each."""
    columns: dict[str, list[str]] = {}
    for g in as_json(summary)["groups"]:
        flat = {**{key: value for key, value in g.items() if key != "sweep"}, **g["sweep"]}
        for key, value in flat.items():
            text = "" if value is None else f"{value:.9g}" if isinstance(value, float) else str(value)
            columns.setdefault(key, []).append(text)
    tables.write(path, columns, {"campaign": summary.spec.name})
    return path


def as_json(summary: Summary) -> dict[str, Any]:
    """The summary with stable keys."""
    return {
        "schema": Campaign.SCHEMA,
        "name": summary.spec.name,
        "seed": summary.spec.seed,
        "robots": summary.spec.robots,
        "versions": summary.versions,
        "groups": [
            {
                "cell": g.cell,
                "sweep": g.point,
                "method": g.method,
                "tool": g.tool,
                "robots": len(g.rms),
                "failed": g.failed,
                "reached": g.reached,
                "rms_um": g.pooled * 1e6,
                "rms_median_um": g.percentile(50) * 1e6,
                "rms_p95_um": g.percentile(95) * 1e6,
                "max_um": g.worst * 1e6,
                "worst_robot": g.worst_robot,
            }
            for g in summary.groups
        ],
        "failures": summary.reasons,
    }


def tool_text(group: RobotGroup) -> str:
    """A tool as tables show it: its length, or all of it where it does not hang straight down."""
    straight = group.tool.startswith("0,0,-") or group.tool == "0,0,0mm"
    return f"{group.tool_length * 1e3:.12g}" if straight else group.tool.removesuffix("mm")


def select(groups: Sequence[RobotGroup], **wanted: Any) -> list[RobotGroup]:
    """The groups whose attributes have these values."""
    return [g for g in groups if all(getattr(g, name) == value for name, value in wanted.items())]
