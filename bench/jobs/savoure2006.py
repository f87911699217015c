"""The numerical study of Savoure, Maurine, Corbel and Krut (ICRA 2006), repeated and carried further.

The planar mechanism of Table 2 is measured through its closed form and identified by the general solvers, which do
not know it. The Delta, which has no closed form, is measured through its forward kinematics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pcalib import compensation, identifiability, identification, kinematics, planning, rotation
from pcalib import planar_closed_form as closed
from pcalib import robot as robots
from pcalib.measurement import Measurements
from pcalib.model import Model
from pcalib.robot import Robot

MODELS = Path(__file__).parents[2] / "models"
DEGREE = np.pi / 180

TABLE_2 = np.array([0.01 * DEGREE, 1e-3, 0.0, 3e-3, 0.0, -2e-3, 0.0, 1e-3, -1e-3])
"""(9,) [rad, m] errors of the planar mechanism, in the order of its parameters."""
SIGMA_POS, SIGMA_ROT = 3e-6, 0.003 * DEGREE
"""[m], [rad] measuring noise of the planar study, 1σ."""
Q_MEASURED = np.arange(-45, 46, 5) * DEGREE
Q_CHECKED = np.arange(-45, 46, 1) * DEGREE
TOOLS = (0.0, 0.1, 0.2)
"""[m] tool lengths: the text's 0 and 200 mm, Table 2's 100 mm."""
HELD = tuple(closed.MERGED)
"""Errors outside the base of (73): held at nominal, they merge into those of the base."""

DELTA_TOOLS = (0.0, 0.1, 0.3)
DELTA_SIGMA_POS, DELTA_SIGMA_ROT = 20e-6, 0.005 * DEGREE
DELTA_ERRORS = {"delta": (0.1e-3, 0.05 * DEGREE), "delta_large_errors": (0.5e-3, 0.2 * DEGREE)}
"""1σ of the 60 raw errors, [m] and [rad]."""
DELTA_POSES = 40


@dataclass(frozen=True)
class Method:
    """One way to calibrate: what is fitted to what, and how commands are found with it."""

    key: str
    label: str
    fit: Mapping[str, Any] | None = None
    """Arguments of :func:`identification.fit`; None: nominal robot."""
    compensation: str = "exact"
    reads: str = "pose"
    """'pose', 'x' (eq. 38 knows no more), 'position', 'position, three tools'."""


_LINEAR = {"method": "linear", "fixed": HELD}
_GAUSS_NEWTON = {"method": "base", "fixed": HELD}
PLANAR_METHODS = (
    Method("none", "no calibration"),
    Method("classical", "classical: q0 and l", {"level": "classical", "method": "linear"}, reads="x"),
    Method("paper_linear_first_order", "the paper: linear LS, first order", _LINEAR | {"weighted": False}, "first-order"),
    Method("linear_weighted_first_order", "linear LS weighted by 1σ, first order", _LINEAR, "first-order"),
    Method("linear_weighted_exact", "linear LS weighted, exact inverse", _LINEAR),
    Method("gauss_newton_first_order", "Gauss–Newton on the base, first order", _GAUSS_NEWTON, "first-order"),
    Method("gauss_newton_exact", "Gauss–Newton on the base, exact inverse", _GAUSS_NEWTON),
    Method("map_exact", "MAP on all nine, exact inverse", {"method": "map"}),
)
DELTA_METHODS = (
    Method("none", "no calibration"),
    Method("classical", "classical: 9 parameters", {"level": "classical", "method": "base"}),
    Method("model24", "Model 24: perfect parallelograms", {"level": "model24", "method": "base"}),
    Method("linear_weighted_first_order", "the paper: linear LS weighted by 1σ, first order", {"method": "linear"}, "first-order"),
    Method("gauss_newton_exact", "Gauss–Newton on the base, exact inverse", {"method": "base"}),
    Method("map_exact", "MAP on all, exact inverse", {"method": "map"}),
    Method("map_position_one_tool", "MAP, position only, one tool", {"method": "map"}, reads="position"),
    Method(
        "map_position_three_tools", "MAP, position only, same poses with three tools", {"method": "map"}, reads="position, three tools"
    ),
)


@dataclass(frozen=True, eq=False)
class Trial:
    """One planar mechanism and one way to measure and use it."""

    measured: float = 0.0
    """[m] tool length while measuring."""
    used: tuple[float, ...] = (0.0,)
    """[m] tool lengths of the check."""
    errors: np.ndarray = field(default_factory=lambda: TABLE_2)
    q: np.ndarray = field(default_factory=lambda: Q_MEASURED)
    noise: float = 1.0
    """Factor on σ."""
    methods: tuple[Method, ...] = PLANAR_METHODS


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


@cache
def robot(name: str) -> Robot:
    """A robot of `models/`."""
    return robots.load(MODELS / f"{name}.toml")


def method(key: str, of: Sequence[Method] = PLANAR_METHODS) -> Method:
    """The method of that key."""
    return next(m for m in of if m.key == key)


def calibrate(nominal: Robot, data: Measurements, how: Method) -> Model:
    """The model that a method makes of measurements.

    Raises:
        FitError: the fit did not converge.
    """
    if how.fit is None:
        return Model.nominal(nominal)
    return identification.fit(data, nominal, **how.fit).model


def command(model: Model, targets: np.ndarray, tool: np.ndarray, how: Method) -> np.ndarray:
    """Actuator values (N, nq) for TCP targets (N, 3) [m]; NaN where there are none."""
    return compensation.compensate(model, targets, tool, method=how.compensation, limits=False).q


# --- planar --------------------------------------------------------------------------------------------------------------


def planar_tool(h: float) -> np.ndarray:
    """Tool of length h in the plate frame: C = −h·y_p."""
    return np.array([0.0, -h, 0.0])


def measure_planar(trial: Trial, seed: int) -> tuple[Measurements, Measurements]:
    """Poses as an instrument sees them, and the x of the TCP alone; the mechanism is its closed form."""
    rng = np.random.default_rng(seed)
    pose = closed.forward(robot("planar").mechanism.nominal + trial.errors, trial.q)
    noise = trial.noise * rng.standard_normal((len(trial.q), 3)) * [SIGMA_POS, SIGMA_POS, SIGMA_ROT]
    position = pose.tcp(planar_tool(trial.measured))
    position[:, :2] += noise[:, :2]
    turned = rotation.about(np.array([0.0, 0.0, 1.0]), noise[:, 2]) @ pose.R
    position[:, 2] = np.nan  # there is no third axis to measure
    x_only = np.where([True, False, False], position, np.nan)

    def data(position: np.ndarray, turned: np.ndarray | None) -> Measurements:
        return Measurements.create(
            robot("planar"), trial.q[:, None], position, turned, tool=planar_tool(trial.measured),
            sigma_pos=trial.noise * SIGMA_POS, sigma_rot=trial.noise * SIGMA_ROT,
        )  # fmt: skip

    return data(position, turned), data(x_only, None)


def planar_errors(trial: Trial, seed: int) -> dict[tuple[str, float], np.ndarray]:
    """Signed x-errors of the TCP [m] at the checked targets, by method and tool length in use."""
    nominal = robot("planar")
    true = nominal.mechanism.nominal + trial.errors
    wanted = np.zeros((len(Q_CHECKED), 3))
    wanted[:, 0] = closed.forward_simplified(Q_CHECKED, 0.0, nominal.dimensions["l1"])
    full, x_only = measure_planar(trial, seed)
    models: dict[int, Model] = {}  # methods that differ in compensation alone share a fit
    out = {}
    for how in trial.methods:
        if id(how.fit) not in models:
            models[id(how.fit)] = calibrate(nominal, x_only if how.reads == "x" else full, how)
        for h in trial.used:
            q = command(models[id(how.fit)], wanted, planar_tool(h), how)[:, 0]
            out[how.key, h] = closed.forward(true, q).tcp(planar_tool(h))[:, 0] - wanted[:, 0]
    return out


def planar_rank() -> int:
    """Identifiable errors of nine, from the measured poses of the paper, by the threshold of the project."""
    mechanism = robot("planar").mechanism
    S = closed.sensitivity(mechanism.nominal, Q_MEASURED, 0.1) / np.array([SIGMA_POS, SIGMA_POS, SIGMA_ROT])[:, None]
    prior = identifiability.priors(mechanism.units)
    return identifiability.analyse(S.reshape(-1, 9), prior, mechanism.parameters).n_identified


# --- Delta ---------------------------------------------------------------------------------------------------------------


def delta_tool(h: float) -> np.ndarray:
    """Tool of length h below the plate."""
    return np.array([0.0, 0.0, -h])


@cache
def delta_targets() -> np.ndarray:
    """Plate positions on a grid over what the nominal robot reaches of its workspace, (364, 3) [m]."""
    nominal = robot("delta")
    across = np.linspace(-nominal.workspace.radius, nominal.workspace.radius, 9)
    up = np.linspace(nominal.workspace.z_min, nominal.workspace.z_max, 11)
    grid = np.stack(np.meshgrid(across, across, up, indexing="ij"), axis=-1).reshape(-1, 3)
    found = kinematics.inverse(nominal.mechanism, nominal.mechanism.nominal, grid)
    return grid[planning.allowed(nominal, found.q, found.pose, found.status)]


def delta_errors(sigma: tuple[float, float], seed: int) -> dict[tuple[str, float], np.ndarray]:
    """Distances between TCP and target [m], by method and tool length; measured once, at the plate's centre."""
    nominal = robot("delta")
    mechanism = nominal.mechanism
    rng = np.random.default_rng(seed)
    size = np.where(np.array(mechanism.units) == "m", *sigma)
    true = mechanism.nominal + size * rng.standard_normal(len(size))
    q = planning.reachable(nominal, DELTA_POSES, rng).q

    def measure(tools: Sequence[float], turned: bool) -> Measurements:
        commands = np.tile(q, (len(tools), 1))
        tool = np.repeat([delta_tool(h) for h in tools], len(q), axis=0)
        pose = kinematics.forward(mechanism, true, commands).pose
        position = pose.tcp(tool) + DELTA_SIGMA_POS * rng.standard_normal(tool.shape)
        R = rotation.exp(DELTA_SIGMA_ROT * rng.standard_normal(tool.shape)) @ pose.R
        return Measurements.create(
            nominal, commands, position, R if turned else None, tool=tool,
            sigma_pos=DELTA_SIGMA_POS, sigma_rot=DELTA_SIGMA_ROT,
        )  # fmt: skip

    data = {
        "pose": measure([0.0], True),
        "position": measure([0.0], False),
        "position, three tools": measure(DELTA_TOOLS, False),
    }
    targets = delta_targets()
    out = {}
    for how in DELTA_METHODS:
        model = calibrate(nominal, data[how.reads], how)
        for h in DELTA_TOOLS:
            wanted = targets + delta_tool(h)
            commands = command(model, wanted, delta_tool(h), how)
            out[how.key, h] = np.linalg.norm(
                kinematics.forward(mechanism, true, commands).pose.tcp(delta_tool(h)) - wanted, axis=1
            )
    return out


# --- the studies ---------------------------------------------------------------------------------------------------------


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
AXIS_SHARE = 5
SCALES = (0.05, 0.1, 0.2, 0.5, 1.0, 1.5, 2.0)


def spread(n: int) -> np.ndarray:
    """n evenly spread measured angles, (n,) [rad]."""
    return np.linspace(Q_MEASURED[0], Q_MEASURED[-1], n)


def trials(quick: bool = False) -> dict[tuple[str, float], Trial]:
    """The planar trials, by study and value of its axis."""
    noise, poses, scales = ((NOISE[::2], POSES[::2], SCALES[::3]) if quick else (NOISE, POSES, SCALES))
    base = Trial(LONG, (LONG,), methods=COMPARED)
    out: dict[tuple[str, float], Trial] = {("ladder", h): Trial(h, (h,)) for h in TOOLS}
    out["transfer", MEASURED_AT] = Trial(MEASURED_AT, USED_AT)
    out |= {("noise", f): replace(base, noise=f) for f in noise}
    out |= {("poses", n): replace(base, q=spread(n)) for n in poses}
    out |= {("scaling", s): replace(base, errors=s * TABLE_2) for s in scales}
    many = spread(POSES[-1])
    out |= {("scaling_poses", s): replace(base, errors=s * TABLE_2, q=many, methods=COMPARED[1:]) for s in scales}
    return out


def run(
    seeds: int = 200, robots: int = 20, quick: bool = False, workers: int = 2, tick: Callable[[], None] | None = None
) -> Study:
    """All studies.

    Args:
        seeds: noise seeds of the tables; the studies along an axis use a fifth of them.
        robots: random Deltas.
        quick: fewer values along each axis.
        tick: called after each of :func:`n_jobs` jobs.
    """
    from joblib import Parallel, delayed

    planned, jobs = trials(quick), _jobs(seeds, robots, quick)
    found: dict[tuple[str, float | str], list[tuple[int, dict]]] = {}
    calls = (delayed(_job)(key, planned.get(key) or DELTA_ERRORS[key[1]], batch) for key, batch in jobs)  # type: ignore[index]
    for key, results in Parallel(n_jobs=workers, return_as="generator_unordered")(calls):
        found.setdefault(key, []).extend(results)
        if tick:
            tick()
    scores = {key: _score([errors for _, errors in sorted(found[key], key=lambda r: r[0])]) for key in found}

    def axis(study: str) -> dict[float, Scores]:
        return {value: scores[study, value] for name, value in planned if name == study}

    return Study(
        seeds=seeds, ladder=axis("ladder"), transfer=scores["transfer", MEASURED_AT], noise=axis("noise"),
        poses=axis("poses"), scaling=axis("scaling"), scaling_poses=axis("scaling_poses"),
        delta={name: scores["delta", name] for name in DELTA_ERRORS}, rank=planar_rank(),
    )  # fmt: skip


def n_jobs(seeds: int, robots: int, quick: bool) -> int:
    """How often :func:`run` ticks."""
    return len(_jobs(seeds, robots, quick))


def _jobs(seeds: int, robots: int, quick: bool) -> list[tuple[tuple[str, float | str], range]]:
    """Batches of seeds of each trial, and of Deltas."""
    jobs: list[tuple[tuple[str, float | str], range]] = []
    for key in trials(quick):
        n = seeds if key[0] in ("ladder", "transfer") else max(1, seeds // AXIS_SHARE)
        jobs += [(key, range(i, min(i + 20, n))) for i in range(0, n, 20)]
    for name in DELTA_ERRORS:
        jobs += [(("delta", name), range(i, min(i + 2, robots))) for i in range(0, robots, 2)]
    return jobs


def _job(key: tuple[str, float | str], what: Any, batch: range) -> tuple[tuple[str, float | str], list[tuple[int, dict]]]:
    once = delta_errors if key[0] == "delta" else planar_errors
    return key, [(seed, once(what, seed)) for seed in batch]


def _score(runs: Sequence[Mapping[tuple[str, float], np.ndarray]]) -> Scores:
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
        return {key: {"rms_mm": 1e3 * s.rms, "max_mm": 1e3 * s.max} for (key, h), s in scores.items() if h == tool}

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
