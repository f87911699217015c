"""All trials together: the tables, and the studies of noise, poses, scale and tools."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa

from bench.jobs.savoure2006 import closed_form as closed
from bench.jobs.savoure2006.trial import (
    DELTA_ERRORS,
    DELTA_TOOLS,
    Q_MEASURED,
    SIGMA_POS,
    SIGMA_ROT,
    TABLE_2,
    TOOLS,
    Trial,
    delta_errors,
    method,
    planar_errors,
    robot,
)
from bench.jobs.study import Row, Study
from pcalib.fitting import identifiability


@dataclass(frozen=True, eq=False)
class Score:
    """TCP errors over the checked targets: RMS and maximum, each the mean over seeds [m]."""

    rms: float
    max: float
    curve: np.ndarray
    """(n,) [m] errors of the first seed, in the order of the targets."""
    spread: float
    """Standard error of `rms`."""


Scores = dict[tuple[str, float], Score]
"""By method and tool length in use."""


@dataclass(frozen=True, eq=False)
class Found:
    """Everything that the figures and tables show. Keys of the dicts are the values of the axis."""

    seeds: int
    ladder: dict[float, Scores]
    """Table 2 by tool length, measured and used with the same tool."""
    transfer: Scores
    """Measured with h = 100 mm, used with 0 … 300 mm."""
    noise: dict[float, Scores]
    """By factor on σ, h = 200 mm."""
    poses: dict[float, Scores]
    """By number of measured poses, h = 200 mm."""
    scaling: dict[float, Scores]
    """By factor on the errors of Table 2, h = 200 mm, 19 poses."""
    scaling_poses: dict[float, Scores]
    """By factor on the errors of Table 2, h = 200 mm, 181 poses."""
    delta: dict[str, Scores]
    """By key of :data:`DELTA_ERRORS`."""
    rank: int


COMPARED = tuple(method(key) for key in ("classical", "paper_linear_first_order", "gauss_newton_exact", "map_exact"))
"""Methods that the studies of noise, poses and scale compare."""
LONG = 0.2
"""[m] the tool of those studies."""
MEASURED_AT = 0.1
"""[m] the tool of the transfer study while measuring."""
USED_AT = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
NOISE = (0.1, 0.3, 1.0, 3.0, 10.0)
POSES = (5, 10, 19, 37, 91, 181)
SCALES = (0.05, 0.1, 0.2, 0.5, 1.0, 1.5, 2.0)
AXIS_SHARE = 5
"""The studies along these axes use one of so many seeds."""


def spread(n: int) -> np.ndarray:
    """n evenly spread measured angles, (n,) [rad]."""
    return np.linspace(Q_MEASURED[0], Q_MEASURED[-1], n)


def trials(quick: bool = False) -> dict[tuple[str, float], Trial]:
    """The planar trials, by study and value of its axis."""
    noise, poses, scales = (NOISE[::2], POSES[::2], SCALES[::3]) if quick else (NOISE, POSES, SCALES)
    base = Trial(LONG, (LONG,), methods=COMPARED)
    out: dict[tuple[str, float], Trial] = {("ladder", h): Trial(h, (h,)) for h in TOOLS}
    out["transfer", MEASURED_AT] = Trial(MEASURED_AT, USED_AT)
    out |= {("noise", f): replace(base, noise=f) for f in noise}
    out |= {("poses", n): replace(base, q=spread(n)) for n in poses}
    out |= {("scaling", s): replace(base, errors=s * TABLE_2) for s in scales}
    many = spread(POSES[-1])
    out |= {("scaling_poses", s): replace(base, errors=s * TABLE_2, q=many, methods=COMPARED[1:]) for s in scales}
    return out


Item = tuple[str, float | str, int]
"""Name of a study, value of its axis, seed: one trial."""


def items(seeds: int, robots: int, quick: bool) -> list[Item]:
    """All trials, in order."""
    out: list[Item] = []
    for study, value in trials(quick):
        n = seeds if study in ("ladder", "transfer") else max(1, seeds // AXIS_SHARE)
        out += [(study, value, seed) for seed in range(n)]
    return out + [("delta", name, seed) for name in DELTA_ERRORS for seed in range(robots)]


class Savoure(Study):
    """The trials of the study; the errors at every target are kept for the first seed."""

    SCHEMA = "pcbench.savoure2006/1"

    def __init__(self, seeds: int = 200, robots: int = 20, quick: bool = False):
        self.name, self.seeds, self.quick = "savoure2006", seeds, quick
        self.source = json.dumps({"seeds": seeds, "robots": robots, "quick": quick})
        self.items = items(seeds, robots, quick)
        self._trials = trials(quick)

    @classmethod
    def parse(cls, source: str) -> Savoure:
        """The study of a source."""
        return cls(**json.loads(source))

    @property
    def n_trials(self) -> int:
        """Seeds of all studies."""
        return len(self.items)

    @property
    def part_trials(self) -> int:
        """Seeds per part: a second of work of the planar mechanism, ten of the Delta."""
        return 10

    def columns(self) -> Sequence[tuple[str, pa.DataType]]:
        """RMS and largest TCP error over the checked targets, per method and tool."""
        return [
            ("trial", pa.int32()), ("study", pa.string()), ("value", pa.string()), ("seed", pa.int32()),
            ("method", pa.string()), ("tool_m", pa.float64()), ("rms_m", pa.float64()), ("max_m", pa.float64()),
            ("error_m", pa.list_(pa.float64())),
        ]  # fmt: skip

    def rows(self, number: int) -> Sequence[Row]:
        """One row per method and tool."""
        study, value, seed = self.items[number]
        if study == "delta":
            errors = delta_errors(DELTA_ERRORS[str(value)], seed)
        else:
            errors = planar_errors(self._trials[study, float(value)], seed)
        return [
            {
                "trial": number, "study": study, "value": str(value), "seed": seed, "method": method, "tool_m": tool,
                "rms_m": float(np.sqrt(np.mean(e**2))), "max_m": float(np.abs(e).max()),
                "error_m": e.tolist() if seed == 0 else None,
            }
            for (method, tool), e in errors.items()
        ]  # fmt: skip


def found(study: Savoure, results: pa.Table) -> Found:
    """What the tables and figures show, from the results."""
    gathered: dict[tuple[str, float | str], dict[tuple[str, float], list[Row]]] = {}
    for row in results.to_pylist():
        name, value, _ = study.items[row["trial"]]
        gathered.setdefault((name, value), {}).setdefault((row["method"], row["tool_m"]), []).append(row)
    scores = {key: {of: _score(rows) for of, rows in mine.items()} for key, mine in gathered.items()}

    def axis(name: str) -> dict[float, Scores]:
        return {value: scores[name, value] for study_name, value in trials(study.quick) if study_name == name}

    return Found(
        seeds=study.seeds, ladder=axis("ladder"), transfer=scores["transfer", MEASURED_AT], noise=axis("noise"),
        poses=axis("poses"), scaling=axis("scaling"), scaling_poses=axis("scaling_poses"),
        delta={name: scores["delta", name] for name in DELTA_ERRORS}, rank=planar_rank(),
    )  # fmt: skip


def planar_rank() -> int:
    """Identifiable errors of nine, from the measured poses of the paper, by the threshold of the project."""
    mechanism = robot("planar").mechanism
    S = closed.sensitivity(mechanism.nominal, Q_MEASURED, 0.1) / np.array([SIGMA_POS, SIGMA_POS, SIGMA_ROT])[:, None]
    prior = identifiability.priors(mechanism.units)
    return identifiability.analyse(S.reshape(-1, 9), prior, mechanism.parameters).n_identified


def _score(rows: Sequence[Row]) -> Score:
    """Means and standard error over the seeds."""
    rms, largest = (np.array([row[name] for row in rows]) for name in ("rms_m", "max_m"))
    return Score(
        float(rms.mean()), float(largest.mean()), np.array(rows[0]["error_m"]), float(rms.std() / np.sqrt(len(rms)))
    )


def summary(study: Found) -> dict[str, Any]:
    """The study as JSON."""

    def table(scores: Scores, tool: float) -> dict[str, dict[str, float]]:
        return {
            key: {"rms_mm": 1e3 * s.rms, "max_mm": 1e3 * s.max, "rms_standard_error_mm": 1e3 * s.spread}
            for (key, h), s in scores.items()
            if h == tool
        }

    def axis(values: Mapping[float, Scores]) -> list[dict[str, Any]]:
        return [{"value": value} | table(scores, LONG) for value, scores in values.items()]

    return {
        "schema": "pcalib.savoure2006/1",
        "seeds": study.seeds,
        "planar": {f"h{1e3 * h:.0f}": table(scores, h) for h, scores in study.ladder.items()},
        "planar_rank": study.rank,
        "planar_base": list(closed.BASE),
        "planar_measured_at_h100": {f"h{1e3 * h:.0f}": table(study.transfer, h) for h in USED_AT},
        "noise_factor": axis(study.noise),
        "n_poses": axis(study.poses),
        "error_factor": axis(study.scaling),
        "error_factor_181_poses": axis(study.scaling_poses),
    } | {name: {f"tool_{1e3 * h:.0f}": table(scores, h) for h in DELTA_TOOLS} for name, scores in study.delta.items()}
