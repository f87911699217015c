"""What a step brought: held-out readings of every kind decide, each in units of its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcalib.diagnosis import telling
from pcalib.diagnosis.held_out import HeldOut
from pcalib.diagnosis.problem import problem
from pcalib.diagnosis.searched import _most_probable
from pcalib.diagnosis.steps import add, drop
from pcalib.errors import InputError
from pcalib.fitting import identification


@pytest.fixture(scope="module")
def completed(measured, robot):
    data, _ = measured()
    return add(identification.fit(data, robot, "model24").model, data, "complete")


def test_what_rotations_ask_for_is_said_with_rotations(completed):
    assert completed.held.confirmed and completed.fell
    step = replace(completed, held=replace(completed.held, by_rotations=True))
    said = telling.step_sentence(step)
    assert said.count("µrad") == 2 and "no difference" not in said
    rows = telling.before_after(step.before, step.after)
    assert all(len(row) == len(telling.BEFORE_AFTER) for row in rows) and "µrad" in rows[1][4]


def test_rotations_that_neither_level_explains_do_not_count(measured, robot):
    data, _ = measured(seed=3)
    step = add(identification.fit(data, robot, "classical").model, data, "model24")
    assert step.held.confirmed and not step.held.by_rotations
    assert step.held.readings == 3 * data.check.sum()
    assert "µrad" not in telling.step_sentence(step)


def test_chance_confirms_what_is_wrong_as_rarely_as_it_says(measured, robot):
    """Held-out noise drawn again: the t of a wrong effect is standard normal, that of nothing at all is 0."""
    data, model = measured()
    held = HeldOut.of(problem(model, data), data)
    step = add(model, data, "gear_ratio:arm")
    a, b = (held.residual(m) for m in (step.before.model, step.after.model))
    rng = np.random.default_rng(0)
    change = held.whitener @ (a - b)
    t = [held._errors(change, rng.standard_normal(len(a))) for _ in range(2000)]
    assert 0.005 < np.mean(np.array(t) > 2.0) < 0.04
    nothing = held.change(model, model)
    assert nothing.t == 0 and not nothing.confirmed and not nothing.refuted


def test_what_helps_and_is_not_all_is_not_confirmed(completed):
    assert telling.step_sentence(completed).endswith(": confirmed.")
    left = replace(completed.after, accuracy=replace(completed.after.accuracy, chi2_dof=1.69))
    said = telling.step_sentence(replace(completed, after=left))
    assert "confirmed" not in said and "1.3 times the stated noise is left. Something else is missing too" in said


def test_steps_refit_as_the_model_was_fitted(measured, robot):
    """Gross rows stay down-weighted, and what was held stays held."""
    data, _ = measured((("thermal_arms", 1.0),))
    position = data.position.copy()
    position[[5, 40, 71]] += [3e-3, 0.0, 0.0]
    gross = replace(data, position=position)
    first = identification.fit(gross, robot, loss="huber", fixed=["l11"]).model
    added = add(first, gross, "thermal_arms")
    for step in (added, drop(added.after.model, gross, "thermal_arms")):
        for fit in (step.before, step.after):
            assert fit.candidate.k[robot.mechanism.parameters.index("l11")] == pytest.approx(0.8, abs=1e-12)
            assert fit.check.rms_pos < 60e-6 and (fit.weight[[5, 40, 71]] < 0.5).all()
            assert fit.candidate.options.loss == "huber"


def test_what_was_held_is_not_let_go_in_silence(measured, robot):
    data, _ = measured()
    simple = identification.fit(data, robot, "classical", prior={"m": 2e-4})
    assert add(simple.model, data, "complete").after.candidate.options.prior == {"m": 2e-4}
    held = identification.fit(data, robot, "classical", fixed=["rod1.length"]).model
    with pytest.raises(InputError, match=r"rod1.length: held, .* which level complete cannot do"):
        add(held, data, "complete")
    assert identification.fit(data, held, "complete", fixed=["l11"]).candidate.options.fixed == ("l11",)


def test_the_place_of_a_break_is_the_middle_of_what_is_likely():
    """A lone best place gives way to three good neighbours; one beyond doubt does not, at either end too."""
    assert _most_probable(np.array([0.0, 9, 10, 9, 0, 0, 10.4, 0])) == 2
    for place in (0, 3, 7):
        gain = np.zeros(8)
        gain[place] = 60.0
        assert _most_probable(gain) == place
