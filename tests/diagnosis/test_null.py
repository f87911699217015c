"""Pure noise through every pattern: none may know of it, and none may find it more often than it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from pcalib import planning, prediction, rotation
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.diagnosis import adequacy
from pcalib.diagnosis.patterns import patterns
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.problem import problem
from pcalib.diagnosis.screen import Group, Known, screen
from pcalib.diagnosis.searched import breaks
from pcalib.fitting import linearisation
from pcalib.mechanics import kinematics
from pcalib.model import Model

MODELS = Path(__file__).parents[2] / "models"
CHANCE = 1e-3
"""Of each comparison with a uniform distribution that a right one fails it."""


def read(model: Model, q: np.ndarray, rng: np.random.Generator, components: str, n_tools: int = 2) -> Measurements:
    """Readings of a model with noise, of which only some components are kept."""
    n = len(q)
    tool = np.zeros((n, 3))
    tool[:, 2] = -0.1 * (np.arange(n) % n_tools)
    columns = {"time": 20.0 * np.arange(n)}
    p = prediction.predict(model, q, prediction.Conditions(tool, np.zeros(n), columns))
    x = p.position + 2e-5 * rng.standard_normal((n, 3))
    x[:, [c not in components for c in "xyz"]] = np.nan
    R = rotation.exp(1e-4 * rng.standard_normal((n, 3))) @ p.rotation if "r" in components else None
    return Measurements.create(
        model.robot, q, x, R, tool=tool, columns=columns, sigma_pos=2e-5, sigma_rot=None if R is None else 1e-4,
    )  # fmt: skip


@pytest.mark.parametrize("components", ["xyzr", "xyz", "z"])
@pytest.mark.parametrize("file", sorted(MODELS.glob("*.toml")), ids=lambda f: f.stem)
def test_no_pattern_knows_the_readings(file, components):
    """What is read at given commands decides how far a pattern is needed, and never what it looks like."""
    robot = robots.load(file)
    model = Model(robot, robot.mechanism.nominal, "complete")
    q = planning.reachable(robot, 24, np.random.default_rng(2)).q
    seen = np.array([c in components for c in "xyz"] + [False] * 3)
    made = []
    for seed in (1, 2):
        data = read(model, q, np.random.default_rng(seed), components)
        conditions = linearisation.conditions_of(data)
        point = Point.of(model, prediction.predict(model, data.q, conditions), conditions)
        made.append(patterns(point, 40, 400, seen | data.mask.any(axis=0)))
    assert len(made[0]) == len(made[1]) > 3
    for one, other in zip(*made, strict=True):
        np.testing.assert_array_equal(one.columns, other.columns)


@pytest.mark.parametrize("slope", [0.0, 0.01])
def test_contacts_of_a_bed_are_as_rare_as_they_say(slope):
    """Commands that are lowered until a bed is touched hold the noise themselves; places by them must not."""
    robot = robots.load(MODELS / "linear_delta.toml")
    model = Model(robot, robot.mechanism.nominal, "firmware6")
    rng = np.random.default_rng(7)
    radius, turn = 0.1 * np.sqrt(rng.random(37)), 2 * np.pi * rng.random(37)
    target = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(37, robot.workspace.z_min)], axis=1)
    target[:, 2] += slope * target[:, 0]
    found: dict[str, list[float]] = {}
    for _ in range(80):
        touched = target + [0, 0, 1] * (3e-5 * rng.standard_normal((37, 1)))
        q = kinematics.inverse(robot.mechanism, model.k, touched).q
        data = Measurements.create(robot, q, target * np.where([0, 0, 1], 1, np.nan), sigma_pos=3e-5)
        made = problem(model, data)
        p = adequacy.p_values(made.screen(16)).p
        for pattern, value in zip(made.patterns, p[len(made.candidates) :], strict=True):
            variable = pattern.variable if pattern.found is None else "a step or a slope"
            found.setdefault(f"{pattern.channel} by {variable}", []).append(float(value))
    assert {"body by place", "body by a step or a slope"} <= found.keys()
    for name, values in found.items():
        if len(values) > 70:
            # A search takes the best of many tries, and knows how many these are to a few per cent only.
            assert kstest(values, "uniform", alternative="greater").pvalue > CHANCE, name


@pytest.mark.parametrize(("kind", "components", "rows"), [("delta", "xyzr", 60), ("delta", "z", 37), ("h4", "xyz", 24)])
def test_what_is_searched_for_in_noise_is_as_rare_as_it_says(kind, components, rows):
    robot = robots.load(MODELS / f"{kind}.toml")
    model = Model(robot, robot.mechanism.nominal, "complete")
    q = planning.reachable(robot, rows, np.random.default_rng(3)).q
    data = read(model, q, np.random.default_rng(4), components)
    made = problem(model, data)
    seen, whiten = data.mask.any(axis=0), Noise.of(data).whiten
    rng = np.random.default_rng(5)
    known = Known(np.zeros(len(made.y), int), np.array([np.inf]))
    found: dict[str, list[float]] = {}
    for _ in range(60):
        y = rng.standard_normal(len(made.y))
        events = breaks(made.point, y, made.nuisance, made.row, seen, whiten)
        groups = [Group(e.channel, whiten(e.columns), np.full(e.columns.shape[-1], 1e-3), e.search) for e in events]
        p = adequacy.p_values(screen(y, made.nuisance, groups, known, n_draws=4)).p
        for group, value in zip(groups, p, strict=True):
            found.setdefault(group.name, []).append(float(value))
    assert found.keys() == {"actuator", "body"}
    for name, values in found.items():
        assert kstest(values, "uniform", alternative="greater").pvalue > CHANCE, (name, np.sort(values)[:9])
