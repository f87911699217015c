"""One trial: a robot with errors is measured, calibrated by several methods, and checked.

The planar mechanism of Table 2 is measured through its closed form and identified by the general solvers, which do
not know it. The Delta, which has no closed form, is measured through its forward kinematics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from bench.jobs.methods import Method
from bench.jobs.savoure2006 import closed_form as closed
from bench.kinds import MODELS
from pcalib import compensation, rotation, workspace
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.mechanics import kinematics
from pcalib.model import Model
from pcalib.robot import Robot

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


_PAPER = Method(
    "paper_linear_first_order", fit="linear", compensation="first-order", weighted=False,
    label="the paper: linear LS, first order",
)  # fmt: skip
"""1 mm weighs like 1 rad, the plain reading of the paper."""
_WEIGHTED = replace(
    _PAPER, name="linear_weighted_first_order", weighted=True, label="linear LS weighted by 1σ, first order"
)
_BASE = Method("gauss_newton_exact", fit="base", label="Gauss–Newton on the base, exact inverse")
PLANAR_METHODS = (
    Method("none", "nominal", label="no calibration"),
    Method("classical", "classical", "linear", reads="x", label="classical: q0 and l"),
    *(
        replace(method, fixed=HELD)
        for method in (
            _PAPER,
            _WEIGHTED,
            replace(
                _WEIGHTED, name="linear_weighted_exact", compensation="exact",
                label="linear LS weighted, exact inverse",
            ),
            replace(
                _BASE, name="gauss_newton_first_order", compensation="first-order",
                label="Gauss–Newton on the base, first order",
            ),
            _BASE,
            replace(
                _BASE, name="gauss_newton_unweighted_exact", weighted=False,
                label="Gauss–Newton on the base, unweighted, exact inverse",
            ),
        )
    ),
    Method("map_exact", label="MAP on all nine, exact inverse"),
)  # fmt: skip
DELTA_METHODS = (
    Method("none", "nominal", label="no calibration"),
    Method("classical", "classical", "base", label="classical: 9 parameters"),
    Method("model24", "model24", "base", label="Model 24: perfect parallelograms"),
    _PAPER,
    _WEIGHTED,
    _BASE,
    Method("map_exact", label="MAP on all, exact inverse"),
    Method("map_position_one_tool", reads="position", label="MAP, position only, one tool"),
    Method("map_position_three_tools", reads="position", label="MAP, position only, same poses with three tools"),
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


Errors = dict[tuple[str, float], np.ndarray]
"""TCP errors (n,) [m] at the checked targets, by method and tool length in use."""


@cache
def robot(name: str) -> Robot:
    """A robot of `models/`."""
    return robots.load(MODELS / f"{name}.toml")


def method(name: str, of: Sequence[Method] = PLANAR_METHODS) -> Method:
    """The method of that name."""
    return next(m for m in of if m.name == name)


def commanded(model: Model, targets: np.ndarray, tool: np.ndarray, how: Method) -> np.ndarray:
    """Actuator values (N, nq) for TCP targets (N, 3) [m]; NaN where there are none."""
    return compensation.compensate(model, targets, tool, method=how.compensation, limits=False).q


# --- planar ---


def planar_tool(h: float) -> np.ndarray:
    """Tool of length h in the plate frame: C = −h·y_p."""
    return np.array([0.0, -h, 0.0])


def measure_planar(trial: Trial, seed: int) -> Measurements:
    """Poses as an instrument sees them; the mechanism is its closed form."""
    rng = np.random.default_rng(seed)
    pose = closed.forward(robot("planar").mechanism.nominal + trial.errors, trial.q)
    noise = trial.noise * rng.standard_normal((len(trial.q), 3)) * [SIGMA_POS, SIGMA_POS, SIGMA_ROT]
    position = pose.tcp(planar_tool(trial.measured))
    position[:, :2] += noise[:, :2]
    turned = rotation.about(np.array([0.0, 0.0, 1.0]), noise[:, 2]) @ pose.R
    position[:, 2] = np.nan  # there is no third axis to measure
    return Measurements.create(
        robot("planar"), trial.q[:, None], position, turned, tool=planar_tool(trial.measured),
        sigma_pos=trial.noise * SIGMA_POS, sigma_rot=trial.noise * SIGMA_ROT,
    )  # fmt: skip


def planar_errors(trial: Trial, seed: int) -> Errors:
    """Signed x-errors of the TCP."""
    nominal = robot("planar")
    true = nominal.mechanism.nominal + trial.errors
    wanted = np.zeros((len(Q_CHECKED), 3))
    wanted[:, 0] = closed.forward_simplified(Q_CHECKED, 0.0, nominal.dimensions["l1"])
    data = measure_planar(trial, seed)
    models: dict[Method, Model] = {}  # methods that differ in compensation alone share a fit
    out = {}
    for how in trial.methods:
        fitted = replace(how, name="", label="", compensation="exact")
        if fitted not in models:
            models[fitted] = how.model(data, nominal)
        for h in trial.used:
            q = commanded(models[fitted], wanted, planar_tool(h), how)[:, 0]
            out[how.name, h] = closed.forward(true, q).tcp(planar_tool(h))[:, 0] - wanted[:, 0]
    return out


# --- Delta ---


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
    return grid[workspace.allowed(nominal, found.q, found.pose, found.status)]


def delta_errors(sigma: tuple[float, float], seed: int) -> Errors:
    """Distances between TCP and target; measured once and without a tool, but for `map_position_three_tools`."""
    nominal = robot("delta")
    mechanism = nominal.mechanism
    rng = np.random.default_rng(seed)
    size = np.where(np.array(mechanism.units) == "m", *sigma)
    true = mechanism.nominal + size * rng.standard_normal(len(size))
    q = workspace.reachable(nominal, DELTA_POSES, rng).q

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
        "map_position_three_tools": measure(DELTA_TOOLS, False),
    }
    targets = delta_targets()
    out = {}
    for how in DELTA_METHODS:
        model = how.model(data.get(how.name, data[how.reads]), nominal)
        for h in DELTA_TOOLS:
            wanted = targets + delta_tool(h)
            commands = commanded(model, wanted, delta_tool(h), how)
            out[how.name, h] = np.linalg.norm(
                kinematics.forward(mechanism, true, commands).pose.tcp(delta_tool(h)) - wanted, axis=1
            )
    return out
