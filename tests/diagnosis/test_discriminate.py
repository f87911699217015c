"""The next measurement: the recursion against brute force, and what a payload is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcalib import effects
from pcalib.diagnosis import discriminate
from pcalib.diagnosis.discriminate import Options, _Discrepancy, _Rows, plan
from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.diagnosis.problem import problem
from pcalib.errors import EffectError, InputError


def hypothesis(name, robot):
    return Hypothesis.of(effects.get(name, None, robot))


def rows(seed, n):
    rng = np.random.default_rng(seed)
    return _Rows(
        rng.standard_normal((n, 6, 4)),
        (rng.standard_normal((n, 6, 1)), rng.standard_normal((n, 6, 2))),
        np.zeros((n, 3)),
        np.ones(n, bool),
    )


def brute(parts, theta, side):
    """Δ by stacking everything and solving the regularised least squares."""
    fit = np.concatenate(
        [np.concatenate([r.nuisance, r.rivals[1 - side]], axis=-1).reshape(-1, 4 + len_of(r, side)) for r in parts]
    )
    truth = np.concatenate([(r.rivals[side] @ theta).ravel() for r in parts])
    hold = np.sqrt(np.r_[np.ones(4), np.full(fit.shape[1] - 4, 1e-6)])
    A, b = np.vstack([fit, np.diag(hold)]), np.r_[truth, np.zeros(fit.shape[1])]
    return float(np.sum((b - A @ np.linalg.lstsq(A, b, rcond=None)[0]) ** 2))


def len_of(r, side):
    return r.rivals[1 - side].shape[-1]


@pytest.mark.parametrize("side", [0, 1])
def test_rows_add_up_as_in_a_full_least_squares(side):
    old, new = rows(1, 5), rows(2, 7)
    theta = np.array([2.0]) if side == 0 else np.array([1.0, -1.0])
    state = _Discrepancy.start(old, theta, side)
    assert state.value == pytest.approx(brute([old], theta, side))
    gains = state.gains(new)
    for row in (0, 3, 6):
        one = _Rows(new.nuisance[[row]], tuple(e[[row]] for e in new.rivals), np.zeros((1, 3)), np.ones(1, bool))
        want = brute([old, one], theta, side)
        assert state.added(new, row).value == pytest.approx(want)
        assert state.value + gains[row] == pytest.approx(want)


@pytest.fixture(scope="module")
def plain(measured, robot):
    """No payload anywhere: gravity compliance looks like encoder errors."""
    data, model = measured((), "plain", 60, 0)
    pair = [[hypothesis("drive_compliance", robot)], [hypothesis("encoder_eccentricity", robot)]]
    return problem(model, data), pair


def test_a_payload_tells_what_more_poses_never_will(plain):
    made, pair = plain
    without = plan(made, pair, 24, Options(payloads=[0.0]))
    with_load = plan(made, pair, 24, Options(payloads=[0.0, 2.0]))
    assert with_load.after[-1] > 4 * without.after[-1]
    assert with_load.after[-1] > 4 * with_load.more_of_the_same
    assert with_load.conditions.payload.max() == 2.0
    assert "more of the same will not tell" in with_load.sentence()
    assert np.all(np.diff(with_load.after) > -1e-9)


def test_chosen_rows_beat_random_ones(plain):
    made, pair = plain
    good = plan(made, pair, 8, Options(payloads=[2.0]))
    poor = plan(made, pair, 8, Options(payloads=[2.0], candidates=8))  # no choice at all
    assert good.after[-1] > 1.2 * poor.after[-1]


def test_backlash_asks_for_directions_and_drift_for_time(measured, robot):
    data, model = measured((), "plain", 60, 0)
    made = problem(model, data)
    found = plan(made, [[hypothesis("backlash", robot)], []], 6)
    table = discriminate.table(robot, found)
    assert set(np.unique([table[f"dir{i}"] for i in (1, 2, 3)])) == {-1.0, 1.0}
    later = plan(made, [[hypothesis("base_drift", robot)], []], 6)
    assert later.conditions.columns["time"].max() >= 3600
    assert later.between == ("base_drift", "nothing")


def test_plans_are_reachable_and_written_with_units(plain, robot):
    made, pair = plain
    found = plan(made, pair, 5)
    table = discriminate.table(robot, found)
    low, high = np.degrees(robot.joint_range)
    for i in (1, 2, 3):
        assert ((table[f"q{i}_deg"] >= low) & (table[f"q{i}_deg"] <= high)).all()
    assert {"payload_kg", "expected_z_mm"} <= table.keys()


def test_bad_requests(plain, robot):
    made, pair = plain
    with pytest.raises(InputError, match="two different explanations"):
        plan(made, [pair[0], pair[0]], 3)
    with pytest.raises(InputError, match="at least 1"):
        plan(made, pair, 0)


def test_columns_that_nobody_has_are_named(plain, robot, tmp_path):
    made, _ = plain
    file = tmp_path / "damp.py"
    file.write_text(
        "from pcalib.effects import Contribution, EffectParameter\n"
        "class Damp:\n"
        "    name = 'damp'\n"
        "    parameters = (EffectParameter('a', 'urad', 1e-4),)\n"
        "    needs = ('humidity',)\n"
        "    def contribution(self, at, theta):\n"
        "        return Contribution(actuator=theta[0] * at.columns['humidity'][:, None] * at.q)\n"
    )
    with pytest.raises(EffectError, match="humidity"):
        plan(made, [[Hypothesis.of(effects.parse(f"{file}:Damp", robot))], []], 3)


def test_one_thermometer_is_planned_for_as_it_is_written(measured, robot):
    """Where only one temperature is recorded, all parts follow it, in the plan and in the file that asks for it."""
    data, model = measured()
    rng = np.random.default_rng(0)
    made = problem(model, replace(data, columns={"temp": 20 + rng.standard_normal(len(data))}))
    pair = [[hypothesis("thermal_arms", robot)], [hypothesis("thermal_rods", robot)]]
    found = plan(made, pair, 6, Options(candidates=200))
    assert set(found.conditions.columns) == {"temp"}
    written = discriminate.table(robot, found)
    assert [name for name in written if name.startswith("temp")] == ["temp_degC"]
    np.testing.assert_array_equal(written["temp_degC"], found.conditions.columns["temp"])


def test_a_plan_counts_with_the_repeatability_of_the_joints(measured, robot):
    """Rows that an exact instrument reads behind sloppy joints tell little."""
    data, model = measured((), "plain", 60, 0)
    made = problem(model, data)
    pair = [[hypothesis("backlash", robot)], [hypothesis("joint_clearance", robot)]]
    exact = plan(made, pair, 6)
    unit = made.whitener[:, :1, :1] * 0 + np.eye(6)
    sloppy = replace(made, noise=replace(made.noise, sigma_q=1e-4), whitener=0.25 * unit)
    assert plan(sloppy, pair, 6).after[-1] < 0.5 * exact.after[-1]


def test_rivals_that_nothing_tells_apart_are_one(measured, robot):
    data, model = measured((("drive_compliance", 1.0),))
    pair = [[hypothesis("drive_compliance", robot)], [hypothesis("arm_bending", robot)]]
    found = plan(problem(model, data), pair, 6)
    assert found.needed > discriminate.SENSIBLE
    assert "no sensible number of such rows brings them. Treat the two as one" in found.sentence()
    assert found.hopeless
    # 2 noise units and 4 more in four rows, in squares: 21 are lacking, at 3 a row.
    some = replace(found, before=2.0, after=np.sqrt([7.0, 10.0, 13.0, 16.0]))
    assert some.needed == pytest.approx(7.0) and "about 7 such rows" in some.sentence()
    alone = replace(found, between=("backlash", "nothing"))
    assert "Leave backlash out" in alone.sentence()
