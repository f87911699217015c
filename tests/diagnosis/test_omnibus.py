"""What keeps a diagnosis honest where the library is silent: every channel that is measured, and fast motor errors."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib.diagnosis.diagnose import diagnose
from pcalib.diagnosis.patterns import FINE, patterns
from pcalib.diagnosis.problem import problem


def test_positions_only_spend_no_columns_on_rotations(measured):
    """What is not measured takes no place in the budget, so that tools and loads keep theirs."""
    data, model = measured(kind="position")
    cells = {(p.channel, p.variable): p.columns for p in problem(model, data).patterns}
    assert {("body", "tool x"), ("body", "time"), ("body", "payload × place")} <= cells.keys()
    for (channel, _), columns in cells.items():
        if channel == "body":
            assert not columns[:, 3:].any() and columns[:, :3].any(axis=(0, 1)).all()


def test_a_cell_too_large_for_what_is_left_does_not_cost_the_smaller_ones(measured):
    data, model = measured()
    point = problem(model, data).point
    some = patterns(point, 60, 100)
    assert sum(p.columns.shape[-1] for p in some) > 90  # the room is used up to the size of the smallest cells


@pytest.mark.parametrize("cycles", [13, 31])
def test_fast_motor_errors_are_seen_though_no_effect_is_searched_for(measured, cycles):
    """A robot file that names other cycles, or a user who excludes ripple, leaves fast waves to the patterns."""
    data, model = measured((("gear_ripple", 0.0),))
    q = data.q
    change = 4e-5 * np.sin(cycles * q + np.array([0.3, 1.0, 2.0]))
    at = problem(model, data).point
    moved = np.einsum("ncq,nq->nc", at.response().actuator, change[~data.check])
    position = data.position.copy()
    position[~data.check] += moved[:, :3]
    waved = replace(data, position=position)
    named = robots.parse(model.robot.text + "\n[drive]\nripple_per_turn = [24]\n", "delta.toml")
    for found in (
        diagnose(replace(model, robot=named), waved, n_draws=1024),
        diagnose(model, waved, n_draws=1024, without=("gear_ripple",)),
    ):
        assert found.verdict == "unexplained"
        assert (found.cells[0].channel, found.cells[0].variable) == ("actuator", FINE) and found.cells[0].p < 0.01
    assert not any(p.variable == FINE for p in problem(model, data).patterns)  # there the effect itself is searched for
    listed = diagnose(model, waved, n_draws=1024)
    assert ("gear_ripple",) in [e.names for e in listed.sets]


def test_what_is_left_out_is_said(measured):
    data, model = measured((("backlash", 0.3),))
    found = diagnose(model, data, n_draws=1024, without=("backlash",))
    assert "backlash" not in {f.candidate.name for f in found.findings}
    assert [u.why for u in found.unavailable if u.name == "backlash"] == ["left out, as asked"]
