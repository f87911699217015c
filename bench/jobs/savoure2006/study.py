"""All trials together: the tables and the studies of noise, poses, scale and tools, in parallel."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from bench.jobs.savoure2006 import closed_form as closed
from bench.jobs.savoure2006.trial import (
    DELTA_ERRORS,
    DELTA_TOOLS,
    Q_MEASURED,
    SIGMA_POS,
    SIGMA_ROT,
    TABLE_2,
    TOOLS,
    Errors,
    Trial,
    delta_errors,
    method,
    planar_errors,
    robot,
)
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
class Study:
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
    """The same with ten times the poses."""
    delta: dict[str, Scores]
    """By key of :data:`DELTA_ERRORS`."""
    rank: int


COMPARED = tuple(method(key) for key in ("classical", "paper_linear_first_order", "gauss_newton_exact", "map_exact"))
"""What the studies of noise, poses and scale compare."""
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


@dataclass(frozen=True, eq=False)
class Job:
    """A batch of seeds of one trial."""

    study: str
    value: float | str
    once: Callable[[int], Errors]
    seeds: range


def jobs(seeds: int, robots: int, quick: bool) -> list[Job]:
    """The work of :func:`run`, in batches for its processes."""

    def batches(study: str, value: float | str, once: Callable[[int], Errors], n: int, size: int) -> list[Job]:
        return [Job(study, value, once, range(i, min(i + size, n))) for i in range(0, n, size)]

    out: list[Job] = []
    for (study, value), trial in trials(quick).items():
        n = seeds if study in ("ladder", "transfer") else max(1, seeds // AXIS_SHARE)
        out += batches(study, value, partial(planar_errors, trial), n, 20)
    for name, sigma in DELTA_ERRORS.items():
        out += batches("delta", name, partial(delta_errors, sigma), robots, 2)
    return out


def _perform(job: Job) -> tuple[Job, dict[int, Errors]]:
    return job, {seed: job.once(seed) for seed in job.seeds}


def run(
    seeds: int = 200, robots: int = 20, quick: bool = False, workers: int = 2, tick: Callable[[], None] | None = None
) -> Study:
    """All studies.

    Args:
        seeds: noise seeds of the tables; the studies along an axis use a fifth of them.
        robots: random Deltas.
        quick: fewer values along each axis.
        tick: called after each of :func:`jobs`.
    """
    from joblib import Parallel, delayed

    found: dict[tuple[str, float | str], dict[int, Errors]] = defaultdict(dict)
    results: Any = Parallel(n_jobs=workers, return_as="generator_unordered")(
        delayed(_perform)(job) for job in jobs(seeds, robots, quick)
    )
    for job, errors in results:
        found[job.study, job.value] |= errors
        if tick:
            tick()
    scores = {key: _score([of[seed] for seed in sorted(of)]) for key, of in found.items()}

    def axis(study: str) -> dict[float, Scores]:
        return {value: scores[study, value] for name, value in trials(quick) if name == study}

    return Study(
        seeds=seeds, ladder=axis("ladder"), transfer=scores["transfer", MEASURED_AT], noise=axis("noise"),
        poses=axis("poses"), scaling=axis("scaling"), scaling_poses=axis("scaling_poses"),
        delta={name: scores["delta", name] for name in DELTA_ERRORS}, rank=planar_rank(),
    )  # fmt: skip


def planar_rank() -> int:
    """Identifiable errors of nine, from the measured poses of the paper, by the threshold of the project."""
    mechanism = robot("planar").mechanism
    S = closed.sensitivity(mechanism.nominal, Q_MEASURED, 0.1) / np.array([SIGMA_POS, SIGMA_POS, SIGMA_ROT])[:, None]
    prior = identifiability.priors(mechanism.units)
    return identifiability.analyse(S.reshape(-1, 9), prior, mechanism.parameters).n_identified


def _score(runs: Sequence[Errors]) -> Scores:
    """What the seeds have in common."""
    out = {}
    for key in runs[0]:
        e = np.stack([r[key] for r in runs])
        rms = np.sqrt(np.mean(e**2, axis=1))
        out[key] = Score(
            float(rms.mean()), float(np.abs(e).max(axis=1).mean()), e[0], float(rms.std() / np.sqrt(len(rms)))
        )
    return out


def summary(study: Study) -> dict[str, Any]:
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
