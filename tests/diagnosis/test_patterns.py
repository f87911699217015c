"""Patterns and candidates are derivatives of the reading, and the map finds the channel and variable at fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcalib import prediction, rotation
from pcalib.diagnosis.candidates import candidates
from pcalib.diagnosis.compare import compare
from pcalib.diagnosis.hypothesis import richer_levels
from pcalib.diagnosis.patterns import legendre, patterns
from pcalib.diagnosis.point import Point
from pcalib.effects.base import Contribution
from pcalib.fitting import linearisation
from pcalib.model import FittedEffect, Frame


@pytest.fixture(scope="module")
def point(measured):
    data, model = measured()
    p = prediction.predict(model, data.q, linearisation.conditions_of(data))
    return Point.of(model, p, linearisation.conditions_of(data))


def test_what_moves_nothing_is_said_once_and_why(point):
    """Without masses and payload nothing loads the robot; with them the tool still hangs straight down."""
    at = replace(point.situation, payload=np.zeros(len(point.situation)))
    weightless = replace(point.model, robot=replace(point.model.robot, mass={}))
    calm = replace(point, model=weightless, situation=replace(at, robot=weightless.robot).under(at.g))
    found, left = candidates(calm)
    said = {u.name: u.why for u in left}
    assert len(said) == len(left) and not said.keys() & {c.name for c in found}
    assert "no [mass] and there is no payload" in said["drive_compliance"] == said["tool_bending"]
    heavy = replace(point, situation=at.under(at.g))
    assert {u.name: u.why for u in candidates(heavy)[1]}["tool_bending"] == "under these conditions it moves nothing"


def test_legendre():
    x = np.linspace(-3, 5, 2001)
    P = legendre(x, 1, 3)
    np.testing.assert_allclose(P[:, 0], (x - 1) / 4, atol=1e-12)
    np.testing.assert_allclose(P.T @ P / 2001 * np.array([3, 5, 7]), np.eye(3), atol=0.01)
    assert legendre(np.full(5, 2.0), 1, 3).shape == (5, 0)
    assert legendre(np.array([0.0, 1, 0, 1]), 1, 4).shape == (4, 1)


def test_actuator_pattern_is_what_moving_the_motor_does(point):
    cell = next(p for p in patterns(point, 60, 400) if (p.channel, p.variable) == ("actuator", "q"))
    q, h = point.situation.q, 1e-6
    degrees = cell.columns.shape[-1] // 3
    for i in range(3):
        shape = legendre(q[:, i], 1, degrees)
        for n in range(degrees):
            moved = []
            for sign in (1, -1):
                changed = q.copy()
                changed[:, i] += sign * h * shape[:, n]
                moved.append(prediction.predict(point.model, changed, _conditions(point)).position)
            slope = (moved[0] - moved[1]) / (2 * h)
            np.testing.assert_allclose(cell.columns[:, :3, i * degrees + n], slope, atol=1e-6)


def test_the_tool_pattern_holds_turns_of_the_tool_in_any_measuring_frame(point):
    turned = Frame(rotation.exp(np.array([0.8, 1.2, 0.3])), np.array([1.0, 2.0, 0.5]))
    model = replace(point.model, frame=turned)
    conditions = _conditions(point)
    there = Point.of(model, prediction.predict(model, point.situation.q, conditions), conditions)
    load = point.situation.payload - (point.situation.payload.max() + point.situation.payload.min()) / 2
    for at in (point, there):
        cell = next(p for p in patterns(at, 60, 400) if (p.channel, p.variable) == ("tool", "payload"))
        twist = np.cross([1.0, -0.5, 0.3], at.situation.tool) * load[:, None]
        signal = at.columns([Contribution(tool=twist)])[..., 0].ravel()
        columns = cell.columns.reshape(len(signal), -1)
        left = signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]
        assert np.linalg.norm(left) < 1e-9 * np.linalg.norm(signal)


def test_candidate_columns_are_derivatives_of_the_reading(point):
    found, _ = candidates(point)
    for c in found:
        if (
            c.name in ("base_drift", "tracker_scale", "backlash", "tool_bending", "thermal_base")
            and c.effect is not None
        ):
            h = 0.1 * c.scale[0] * np.eye(len(c.scale))[0]
            both = []
            for sign in (1, -1):
                fitted = FittedEffect(c.effect, sign * h)
                model = replace(point.model, effects=(fitted,))
                both.append(prediction.predict(model, point.situation.q, _conditions(point)).position)
            slope = (both[0] - both[1]) / (2 * h[0])
            size = np.abs(slope).max()
            np.testing.assert_allclose(c.columns[:, :3, 0], slope, atol=2e-3 * size, err_msg=c.spec)


def _conditions(point):
    at = point.situation
    return prediction.Conditions(at.tool, at.payload, at.columns)


def test_budgets_are_kept(point):
    for budget, total in ((60, 400), (20, 150), (6, 40)):
        found = patterns(point, budget, total)
        assert all(p.columns.shape[-1] <= budget for p in found)
        assert sum(p.columns.shape[-1] for p in found) <= max(total, budget)


def test_levels_above(measured):
    _, model = measured()
    assert richer_levels(model) == []
    assert richer_levels(replace(model, level="classical"))[-1] == "complete"
    assert "classical" not in richer_levels(replace(model, level="model24"))


@pytest.mark.parametrize(
    ("fault", "cell"),
    [
        ("backlash", ("actuator", "direction")),
        ("encoder_warming", ("actuator", "temp_base")),
        ("joint_clearance", ("rod", "sign of the rod force")),
        ("tracker_drift", ("body", "time")),
        ("drive_compliance", ("actuator", "torque")),
    ],
)
def test_the_map_is_hottest_where_the_fault_is(measured, fault, cell):
    data, model = measured(((fault, 2.0),))
    found = compare(model, data, n_draws=256)
    hottest = [(c.channel, c.variable) for c in found.cells[:2]]
    assert cell in hottest and found.cells[0].p < 0.01


def test_nothing_stands_out_of_noise(measured):
    data, model = measured()
    found = compare(model, data)
    assert found.cells[0].p > 0.05
    assert 0.85 < found.times_noise[0] < 1.1
