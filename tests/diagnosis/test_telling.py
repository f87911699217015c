"""What is said: figures that stand side by side measure the same, and first sentences are plain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.instrument import Instrument
from pcalib import robot as robots
from pcalib.data.noise import Noise
from pcalib.diagnosis import advice, figures, telling
from pcalib.diagnosis.compare import compare
from pcalib.diagnosis.diagnose import Why, diagnose
from pcalib.diagnosis.evidence import evidence
from pcalib.diagnosis.held_out import Change
from pcalib.diagnosis.hypothesis import Hypothesis, Kind
from pcalib.diagnosis.verdict import Doubt, Explanation
from pcalib.effects import Contribution, Effect, EffectParameter, get
from pcalib.fitting import identification

MODELS = Path(__file__).parents[2] / "models"


class TestComparison:
    def test_both_sets_are_judged_alike_and_rows_set_aside_are_named(self, measured):
        data, _ = measured()
        odd = np.flatnonzero(~data.check)[[5, 40, 60]]
        position = data.position.copy()
        position[odd, 2] += 2e-3
        spoiled = replace(data, position=position)
        found = compare(identification.fit(spoiled, measured()[1]).model, spoiled, n_draws=256)
        for a, times in zip((found.fit, found.check), found.times_noise, strict=True):
            assert times**2 * 6 > 0.9 * (a.rms_pos / found.noise.sigma_pos) ** 2
        said = " ".join(telling.comparison_details(found))
        assert all(str(int(line)) in said for line in data.lines[odd]) and "3 rows far from everything" in said
        assert "Without them, and with the geometry refitted, 1.0 times the noise is left" in said

    def test_nothing_is_added_where_a_fit_would_change_nothing(self, measured):
        data, model = measured()
        found = compare(model, data, n_draws=256)
        assert telling.comparison_details(found) == [found.noise.sentence()]
        assert "µrad" not in telling.comparison_sentence(found) and not telling.hot_cells(found.cells)

    def test_rotations_are_named_where_they_make_the_figure(self, measured, robot):
        data, _ = measured(seed=3)
        found = compare(identification.fit(data, robot, "model24").model, data, n_draws=256)
        error = np.hstack([1e-3 * found.error[:, :3], found.error[:, 3:]])
        assert telling.comparison_sentence(replace(found, fit=_judged(found, data, error))).count("µrad") == 2


def _judged(found, data, error):
    return identification.accuracy(error[~data.check], Noise.of(data).take(~data.check), 0.0)


class Wave(Effect):
    """An effect of the user's own that is not there."""

    name = "wave"
    parameters = (EffectParameter("size", "urad", 1e-4),)
    needs = ()

    def contribution(self, at, theta):
        return Contribution(actuator=theta[0] * np.sin(7 * at.q))


class TestCandidates:
    def test_rows_fall_in_p_and_the_users_own_are_listed_in_any_case(self, measured):
        data, model = measured((("drive_compliance", 1.0),))
        found = diagnose(model, data, [Wave()], n_draws=256)
        every = telling.one_per_effect(found)
        assert [(f.p, -f.s) for f in every] == sorted((f.p, -f.s) for f in every)
        rows = telling.candidate_rows(found, 3)
        assert len(rows) == 4 and rows[-1][0] == "wave" and all(len(row) == len(telling.CANDIDATES) for row in rows)
        listed = telling.candidate_rows(found, None)
        assert telling.candidates_left(found, 3).startswith(f"… and {len(listed) - 4} more")
        assert telling.candidates_left(found, len(listed) - 3).endswith("more, all p > 0.99.")
        assert telling.candidates_left(found, None) == ""

    def test_a_compliance_that_cannot_be_has_no_stiffness(self, robot):
        said = get("arm_bending", None, robot).describe(np.array([5e-6, -8e-7]))
        assert said == "vertical 5 µm/N (elbow stiffness 0.2 N/µm); lateral -0.8 µm/N (not physical)"
        assert get("arm_bending", None, robot).describe(np.array([5e-6, 0.0])).endswith("lateral 0 µm/N (rigid)")


class TestEvidence:
    def test_what_is_left_is_the_level_where_everything_is_left(self, measured, robot):
        data, _ = measured((("drive_compliance", 1.0),))
        e = evidence(identification.fit(data, robot, "model24").model, data, "drive_compliance")
        assert e.rest == "complete" and e.rest_p < 0.05

    def test_the_range_is_spoken_of_where_there_is_one(self, measured, robot):
        data, _ = measured((("drive_compliance", 1.0),))
        rough = identification.fit(data, robot, "model24").model
        level = evidence(rough, data, "complete")
        assert not any("physical range" in line for line in telling.evidence_lines(level))
        below = replace(level.finding, candidate=evidence(rough, data, "drive_compliance").candidate,
                        theta=np.array([-1e-6]), sigma=np.array([1e-6]))  # fmt: skip
        for possible, said in ((True, "outside their physical range, by no more than noise"), (False, "range.")):
            lines = telling.evidence_lines(replace(level, finding=below, in_range=possible))
            assert any(said in line for line in lines) and not any("within their" in line for line in lines)

    def test_what_is_possible_is_not_called_impossible_for_noise(self, measured):
        data, model = measured((("drive_compliance", 1.0),))
        e = evidence(model, data, "arm_bending")
        e = replace(e, finding=replace(e.finding, theta=np.array([5e-6, -1e-7])))
        assert e.in_range and "(rigid)" in telling.evidence_sentence(e)
        assert "lateral -0.1 µm/N (not physical)" in telling.evidence_sentence(replace(e, in_range=False))

    def test_held_out_figures_count_what_the_verdict_on_them_counts(self, measured, robot):
        data, _ = measured((("drive_compliance", 1.0),), seed=3)
        e = evidence(identification.fit(data, robot, "model24").model, data, "drive_compliance")
        held = e.held_out
        assert (held.after < held.before) == (held.t > 0) and held.times_before < 15


def test_wording_of_the_first_sentence(measured):
    found = diagnose(*reversed(measured((("backlash", 0.3),))), n_draws=256)
    chance = Change(100.0, 99.0, 180, 30, 1.0, False)
    refused = replace(found.sets[0], held_out=chance, doubts=(Doubt.UNCONFIRMED,))
    once = replace(found, verdict="ambiguous", sets=(refused,))
    assert telling.sentence(once).endswith("; held-out rows do not confirm it.")
    assert any("100 → 99 of 180 readings, within chance" in line for line in telling.details(once))
    many = [Explanation((Hypothesis(Kind.EFFECT, f"e{i}", f"e{i}"),), (), (), 0.0) for i in range(7)]
    assert "e4 or e5." in telling.sentence(replace(found, verdict="ambiguous", sets=tuple(many[:6]), established=()))
    assert "one of 2 more." in telling.sentence(replace(found, verdict="ambiguous", sets=tuple(many), established=()))


def test_joints_repeat_in_the_units_of_their_robot(measured):
    made = compare(*reversed(measured()), n_draws=64).problem
    made = replace(made, noise=replace(made.noise, sigma_q=2.9e-5))
    assert "(part of it from joints that repeat to 29 µrad)" in telling.noise_sentence(made)
    assert "joints that repeat to 29 µm)" in made.noise.sentence("µm")


@pytest.fixture(scope="module")
def soft():
    """A linear delta whose drives give way: the model fitted to it, and the data."""
    robot = robots.load(MODELS / "linear_delta.toml")
    made = truths.Truth(
        robot, truths.draw_errors(robot, 1e-4, 1e-3, 1), Instrument(sigma_pos=15e-6, sigma_rot=60e-6),
        (faults.typical(robot, "drive_compliance", 4.0),),
    )  # fmt: skip
    data = simulate.run(made, plans.make(robot, "rich", 60, check=10, tools=[np.zeros(3)], seed=1), 1).measurements
    return identification.fit(data, robot).model, data


def test_coarse_noise_is_said_in_thousandths(measured):
    data, model = measured()
    coarse = replace(compare(model, data, n_draws=256).noise, sigma_pos=1.2e-3, sigma_rot=2.97e-3)
    assert "Noise 1.2 mm and 2.97 mrad" in coarse.sentence()


class TestSlidingDrives:
    """Carriages have positions [mm] and forces [N], where arms have angles and torques."""

    def test_the_map_names_positions_and_forces(self, soft):
        cells = compare(*soft, n_draws=256).cells
        said = {telling.place(c) for c in cells}
        assert "motor positions by drive force" in said
        drawn = figures.heatmap(cells)
        for text in (*said, drawn):
            assert "angle" not in text and "torque" not in text

    def test_the_drawing_has_their_units(self, soft):
        drawn = figures.evidence(evidence(*soft, "drive_compliance"))
        assert "apparent error of motor positions [µm]" in drawn
        assert "drive force [N]" in drawn and "N·m" not in drawn

    def test_what_the_geometry_does_too_needs_no_other_poses(self, soft):
        """The number of motor steps per mm is a parameter of the geometry itself."""
        found = diagnose(*soft, n_draws=256)
        assert any(f.candidate.name == "gear_ratio" and f.why is Why.UNSEEN for f in found.findings)
        assert not any("gear_ratio" in step.why for step in advice.advised(found, "m.toml"))
        said = telling.evidence_sentence(evidence(*soft, "gear_ratio"))
        assert said == "gear_ratio: no poses can show it, a change of the geometry does the same."
