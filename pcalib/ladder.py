"""The same error field under successive models: the data behind every before/after figure, table and recording.

A ladder has one step per model and one map per tool; a map holds where the TCP missed each target, for every step.
Who measured the misses (MuJoCo, an instrument, or a model's own prediction) is said by `source`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcalib import summary
from pcalib.fitting.identification import Fit
from pcalib.model import Model
from pcalib.robot import Robot
from pcalib.wording import size


@dataclass(frozen=True, eq=False)
class ResidualPlot:
    """Residuals against the variable that explains most of them, and the curve that a candidate fits to them."""

    variable: str
    """What is on the axis, with its unit as people write it."""
    x: np.ndarray
    """(n,) in that unit."""
    residual: np.ndarray
    """(n,) residuals of the step in units of the noise σ."""
    label: str
    """The part that the residuals belong to: 'actuator 2', 'rod 31'."""
    curve: np.ndarray | None = None
    """(c, 2) x and [σ]; None where nothing was fitted."""


@dataclass(frozen=True)
class CandidateBar:
    """One explanation of the residuals of a step, and how strongly the data support it."""

    name: str
    strength: float
    """Norm of its visible part at the fitted size, in units of the noise σ."""
    favoured: bool = False


@dataclass(frozen=True, eq=False)
class Step:
    """One model of the ladder, its fit, and what may explain its residuals."""

    name: str
    """Short and stable, for files: 'model24'."""
    label: str
    """For people: 'Model 24'."""
    model: Model
    method: str = "exact"
    """How commands were found: 'exact', 'first-order', or 'none' where they were not compensated."""
    text: str = ""
    """What the step assumes and what it cannot see, in plain sentences."""
    fit: Fit | None = None
    candidates: tuple[CandidateBar, ...] = ()
    """Explanations of the residuals, the strongest first."""
    scatter: ResidualPlot | None = None


@dataclass(frozen=True, eq=False)
class Expected:
    """How far off landings may be at P targets, as the models of S steps state it; NaN where one states nothing."""

    covariance: np.ndarray
    """(S, P, 3, 3) [m²] covariance of the miss, base frame."""
    u95: np.ndarray
    """(S, P) [m] radius that contains the miss with 95 %."""
    pooled: np.ndarray
    """(S,) [m] radius that contains 95 % of the misses at all targets together."""


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Where the TCP with one tool missed its targets, for S steps and P targets."""

    tool: np.ndarray
    """(3,) [m] TCP in the plate frame."""
    targets: np.ndarray
    """(P, 3) [m] wanted TCP positions, base frame."""
    errors: np.ndarray
    """(S, P, 3) [m] reached minus wanted, base frame; NaN where the status is not 'ok'."""
    status: np.ndarray
    """(S, P) 'ok' or why the target was not reached."""
    expected: Expected | None = None
    """How far off each step's model says that the TCP may be; None where no model states it."""

    def __post_init__(self) -> None:
        S, P = self.status.shape
        if self.expected is not None and self.expected.u95.shape != (S, P):
            raise ValueError(f"u95 {self.expected.u95.shape} does not agree with status {(S, P)}")
        shapes = self.targets.shape, self.errors.shape, self.tool.shape
        if shapes != ((P, 3), (S, P, 3), (3,)):
            raise ValueError(f"targets, errors, tool {shapes} do not agree with status {(S, P)}")

    @property
    def reached(self) -> np.ndarray:
        """(P,) bool, targets that every step reached; figures are taken over these, so that they compare."""
        return (self.status == "ok").all(axis=0)

    @property
    def distance(self) -> np.ndarray:
        """(S, P) [m] |error|."""
        return np.linalg.norm(self.errors, axis=-1)

    @property
    def rms(self) -> np.ndarray:
        """(S,) [m] sqrt(mean |error|²) over the targets that every step reached; NaN where there are none."""
        d = self.distance[:, self.reached]
        return np.sqrt(np.mean(d**2, axis=1)) if d.shape[1] else np.full(len(d), np.nan)

    @property
    def max(self) -> np.ndarray:
        """(S,) [m] largest |error| over the same targets."""
        d = self.distance[:, self.reached]
        return d.max(axis=1) if d.shape[1] else np.full(len(d), np.nan)

    @property
    def label(self) -> str:
        """How the tool is called: 'tool 300 mm'."""
        return tool_label(self.tool)


@dataclass(frozen=True, eq=False)
class Ladder:
    """Models, and where the TCP lands under each of them, with every tool."""

    robot: Robot
    steps: tuple[Step, ...]
    maps: tuple[ErrorMap, ...]
    source: str = "measured"
    """Origin of the reached positions: 'measured', 'MuJoCo', 'predicted' …"""
    floor: float = 0.0
    """[m] resolution of the instrument, for comparison; 0 if unknown."""
    truth: np.ndarray | None = field(default=None, repr=False)
    """(nk,) true geometry of a virtual robot; None where it is unknown."""

    def __post_init__(self) -> None:
        if any(len(m.errors) != len(self.steps) for m in self.maps):
            raise ValueError("every map needs one error field per step")

    @property
    def rms(self) -> np.ndarray:
        """(S, T) [m]."""
        return np.stack([m.rms for m in self.maps], axis=1)

    @property
    def max(self) -> np.ndarray:
        """(S, T) [m]."""
        return np.stack([m.max for m in self.maps], axis=1)

    @property
    def worst_tool(self) -> int:
        """Index of the map with the largest RMS at the first step."""
        return int(np.nanargmax(self.rms[0])) if np.isfinite(self.rms[0]).any() else 0


def tool_label(tool: np.ndarray) -> str:
    """'tool 300 mm'; a tool (3,) [m] that does not hang straight below the plate is given by its three numbers."""
    x, y, z = (float(round(v * 1e3, 3)) + 0.0 for v in tool)
    if x == y == 0 and z <= 0:
        return f"tool {abs(z):g} mm"
    return f"tool ({x:g}, {y:g}, {z:g}) mm"


def table(ladder: Ladder) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the ladder: RMS and maximum per tool, one row per step."""
    header = ["model", "commands"]
    for m in ladder.maps:
        header += [f"{m.label} RMS", "max"]
    rows = []
    for s, step in enumerate(ladder.steps):
        row = [step.label, {"none": "as drawn"}.get(step.method, step.method)]
        for m in ladder.maps:
            row += [size(m.rms[s]), size(m.max[s])]
        rows.append(row)
    return header, rows


def as_json(ladder: Ladder) -> dict[str, Any]:
    """The figures of every step; lists have one entry per tool."""
    return {
        "tools_mm": [m.tool * 1e3 for m in ladder.maps],
        "targets": [len(m.targets) for m in ladder.maps],
        "steps": [
            {
                "name": step.name,
                "commands": step.method,
                "rms_um": ladder.rms[s] * 1e6,
                "max_um": ladder.max[s] * 1e6,
                "not_reached": [int((m.status[s] != "ok").sum()) for m in ladder.maps],
                "fit": None if step.fit is None else summary.statistics(step.fit),
            }
            for s, step in enumerate(ladder.steps)
        ],
    }


def sentence(ladder: Ladder) -> str:
    """The outcome in one plain sentence."""
    first, last, t = ladder.rms[0], ladder.rms[-1], ladder.worst_tool
    lengths = [m.label for m in ladder.maps]
    text = (
        f"{_with(lengths[t]).capitalize()} the TCP missed its targets by {size(first[t])} RMS; "
        f"after calibration it misses them by {size(last[t])}"
    )
    others = [f"{size(last[i])} {_with(lengths[i])}" for i in range(len(lengths)) if i != t]
    return text + (f" ({', '.join(others)})." if others else ".")


def _with(tool: str) -> str:
    return "without a tool" if tool == "tool 0 mm" else f"with a {tool.removeprefix('tool ')} tool"
