"""Whole diagnoses of the virtual robot: what MuJoCo hides is found, told apart, or said to be unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import plan as plans
from bench import simulate
from bench import truth as truths
from bench.instrument import Instrument
from bench.jobs.diagnosis_benchmark import rows
from pcalib import robot as robots
from pcalib import rotation
from pcalib.diagnosis import results, telling
from pcalib.diagnosis.compare import compare
from pcalib.diagnosis.diagnose import Why, diagnose
from pcalib.diagnosis.evidence import evidence
from pcalib.diagnosis.steps import add, drop
from pcalib.diagnosis.verdict import Doubt
from pcalib.diagnosis.visibility import kinship, visibility
from pcalib.effects import get, parse
from pcalib.errors import EffectError, InputError
from pcalib.fitting import identification
from pcalib.fitting.linearisation import residuals
from pcalib.model import FittedEffect, Model

KEYS = {"schema", "verdict", "established", "adequate", "refuted", "candidates", "noise", "misfit", "heatmap", "next"}
ENOUGH_DRAWS = 1024


def names(found):
    return {e.names for e in found.sets}


def test_no_fault_nothing_missing_with_limits(measured):
    data, model = measured()
    found = diagnose(model, data)
    assert found.verdict == "nothing_missing" and found.established == () and names(found) == {()}
    assert found.noise.verified
    assert found.noise.sigma_pos == pytest.approx(15e-6, rel=0.1)
    assert found.noise.sigma_rot == pytest.approx(60e-6, rel=0.1)
    limits = {f.candidate.spec: f.smallest_seen for f in found.findings}
    assert 1e-6 < limits["backlash"][0] < 1e-4  # well below an arc minute
    assert limits["drive_compliance"][0] < 3e-5
    assert telling.sentence(found).startswith("Nothing is missing")


@pytest.mark.parametrize(
    ("fault", "scale", "spec", "value"),
    [
        ("backlash", 0.3, "backlash", None),
        ("thermal_arms", 1.0, "thermal_arms", 2.36e-5),
        ("joint_clearance", 1.0, "joint_clearance", 1e-5),
        ("tool_bending", 1.0, "tool_bending", 2e-6),
        ("friction_hysteresis", 1.0, "friction_hysteresis", 1e-5),
    ],
)
def test_single_faults_are_established_with_their_size(measured, fault, scale, spec, value):
    data, model = measured(((fault, scale),))
    found = diagnose(model, data, n_draws=ENOUGH_DRAWS)
    assert found.verdict == "established" and found.established == (fault,)
    assert found.sets[0].specs == (spec,)
    assert found.sets[0].held_out.confirmed and not found.sets[0].doubts
    if value is not None:
        assert found.sets[0].theta[0][0] == pytest.approx(value, rel=0.2)


def test_drives_and_arms_are_rivals_unless_the_lateral_part_tells(measured):
    data, model = measured((("drive_compliance", 1.0),))
    found = diagnose(model, data, n_draws=ENOUGH_DRAWS)
    assert ("drive_compliance",) in names(found)
    assert names(found) <= {("drive_compliance",), ("arm_bending",)}


def test_a_pair(measured):
    data, model = measured((("thermal_arms", 1.0), ("backlash", 0.2)))
    found = diagnose(model, data, n_draws=ENOUGH_DRAWS)
    assert ("backlash", "thermal_arms") in names(found)
    assert "backlash" in found.established


def test_what_no_library_has_is_unexplained_with_the_place(measured):
    data, model = measured((("tool_creep", 1.0),))
    found = diagnose(model, data, n_draws=ENOUGH_DRAWS)
    assert found.verdict == "unexplained" and not found.sets
    assert any("tool" in c.variable for c in found.cells[:3])
    assert "no effect of the library explains it" in telling.sentence(found)


@pytest.mark.parametrize("level", ["classical", "model24"])
def test_incomplete_geometry_is_what_is_missing(measured, robot, level):
    data, _ = measured()
    found = diagnose(identification.fit(data, robot, level).model, data, n_draws=ENOUGH_DRAWS)
    assert found.verdict == "established" and found.established == ("complete",)


def test_the_simplest_geometry_that_does_is_the_answer(robot):
    """Richer levels do as well; they are no rivals, because they hold nothing that is needed."""
    basis = np.linalg.qr(robot.mechanism.levels["model24"].basis)[0]
    errors = basis @ (basis.T @ truths.draw_errors(robot, 1e-4, np.radians(0.05), 1))
    made = truths.Truth(robot, errors, Instrument(sigma_pos=15e-6, sigma_rot=60e-6))
    data = simulate.run(made, plans.make(robot, "rich", 120, check=30, seed=1), 1).measurements
    found = diagnose(identification.fit(data, robot, "classical").model, data, n_draws=ENOUGH_DRAWS)
    assert found.verdict == "established" and found.established == ("model24",)


def test_incomplete_geometry_and_an_effect(measured, robot):
    data, _ = measured((("backlash", 0.3),))
    found = diagnose(identification.fit(data, robot, "model24").model, data, n_draws=ENOUGH_DRAWS)
    assert found.established == ("backlash", "complete")


def test_without_replicates_the_noise_is_judged_by_what_is_left(measured):
    data, model = measured((("thermal_arms", 1.0),))
    blind = replace(data, pose_id=np.full(len(data), -1), sigma=2.5 * data.sigma)
    found = diagnose(model, blind, n_draws=ENOUGH_DRAWS)
    assert found.noise.source == "residuals" and not found.noise.verified
    assert found.noise.ratio[0] == pytest.approx(0.4, rel=0.15)
    assert "thermal_arms" in found.established
    assert any("replicates" in line for line in telling.details(found))


def test_position_only(measured):
    data, model = measured((("backlash", 0.5),), kind="position")
    found = diagnose(model, data, n_draws=ENOUGH_DRAWS)
    assert ("backlash",) in names(found) and np.isnan(found.noise.sigma_rot)


def test_json(measured):
    data, model = measured((("drive_compliance", 1.0),))
    found = diagnose(model, data.take(np.arange(120)))
    text = results.diagnosis_json(found)
    assert text.keys() >= KEYS and text["schema"] == "pcalib.diagnosis/1"
    assert {"effect", "kappa", "s", "p", "adequate", "parameters"} <= text["candidates"][0].keys()
    assert {"channel", "variable", "p"} <= text["heatmap"][0].keys()
    assert {"verified", "source", "sigma_pos_um", "sigma_rot_urad"} <= text["noise"].keys()


def test_negative_stiffness_is_no_explanation(measured, robot):
    """Data bent the wrong way: everything that a drive compliance would add, taken away instead."""
    data, model = measured()
    effect = get("drive_compliance", None, robot)
    soft = replace(model, effects=(FittedEffect(effect, np.array([4e-5])),))
    away = residuals(model, data)[1].position - residuals(soft, data)[1].position
    bent = replace(data, position=data.position + away)
    found = diagnose(identification.fit(bent, robot).model, bent, n_draws=ENOUGH_DRAWS)
    mine = next(f for f in found.findings if f.candidate.spec == "drive_compliance")
    assert mine.p < 0.01 and mine.theta[0] < 0 and mine.why is Why.IMPOSSIBLE
    assert all("drive_compliance" not in e.names for e in found.sets), [e.words() for e in found.sets]


def test_what_the_model_has_is_no_candidate_but_its_richer_variants_are(measured, robot):
    data, model = measured()
    effect = get("drive_compliance", None, robot)
    has = replace(model, effects=(FittedEffect(effect, np.array([2e-5]), "drive_compliance"),))
    found = diagnose(has, data, n_draws=64)
    specs = [f.candidate.spec for f in found.findings]
    assert "drive_compliance" not in specs and "drive_compliance:arm" in specs
    assert "gravity_tilt" in specs  # now there is something that answers to gravity


class TestEvidence:
    def test_for_the_truth(self, measured):
        data, model = measured((("thermal_arms", 1.0),))
        e = evidence(model, data, "thermal_arms")
        assert e.in_range and e.rest_p > 0.05 and e.held_out.confirmed
        assert "explains all there is" in telling.evidence_sentence(e)
        assert e.plot.slope == pytest.approx(1.0)
        assert results.evidence_json(e)["rest"]["p"] == e.rest_p

    def test_against_a_bystander(self, measured):
        data, model = measured((("thermal_arms", 1.0),))
        e = evidence(model, data, "backlash")
        assert e.rest_p < 0.05
        assert "Nothing speaks for" in telling.evidence_sentence(e) or "not enough" in telling.evidence_sentence(e)

    def test_drive_effects_are_drawn_against_what_tells(self, measured):
        data, model = measured((("backlash", 0.3),))
        by = evidence(model, data, "backlash").by_variable
        assert by.variable == "direction" and by.channel == "actuator"
        up, down = by.y[by.x > 0].mean(), by.y[by.x < 0].mean()
        assert up < down  # the arm lags behind its motion

    def test_messages(self, measured):
        data, model = measured()
        with pytest.raises(EffectError, match="did you mean 'backlash'"):
            evidence(model, data, "backlsh")
        with pytest.raises(EffectError, match="add a compliance first"):
            evidence(model, data, "gravity_tilt")


class TestSteps:
    def test_add_and_drop(self, measured):
        data, model = measured((("backlash", 0.3),))
        up = add(model, data, "backlash")
        assert up.fell and up.after.check.rms_pos < 0.8 * up.before.check.rms_pos
        back = drop(up.after.model, data, "backlash")
        assert not back.fell
        np.testing.assert_allclose(back.after.model.k, model.k, atol=1e-7)
        assert results.step_json(up)["schema"] == "pcalib.add/1"
        with pytest.raises(EffectError, match="already"):
            add(up.after.model, data, "backlash")
        per_arm = add(up.after.model, data, "backlash:arm")
        assert [f.spec for f in per_arm.after.model.effects] == ["backlash:arm"]

    def test_add_a_level(self, measured, robot):
        data, _ = measured()
        rough = identification.fit(data, robot, "model24").model
        assert add(rough, data, "complete").after.model.level == "complete"

    def test_geometry_that_had_been_bent_is_named(self, measured):
        data, model = measured((("drive_compliance", 2.0),))
        step = add(model, data, "drive_compliance")
        assert len(step.moved()) > 3 and step.moved()[0][2] > 2

    def test_messages(self, measured):
        data, model = measured()
        with pytest.raises(EffectError, match="did you mean 'backlash'"):
            add(model, data, "backlsh")
        with pytest.raises(EffectError, match="no effects to drop"):
            drop(model, data, "backlash")
        bare = replace(data, columns={})
        with pytest.raises(EffectError, match="needs columns that the data do not have: time"):
            add(model, bare, "base_drift")


def test_a_row_out_of_reach_is_refused_and_not_judged(measured):
    data, model = measured()
    q = data.q.copy()
    q[3] = np.radians([-95.0, 90.0, 90.0])
    with pytest.raises(InputError, match="cannot close its loops") as error:
        diagnose(model, replace(data, q=q), n_draws=ENOUGH_DRAWS)
    assert error.value.line == data.lines[3]


def test_the_telling_plot_of_a_ripple_with_named_cycles_is_over_the_angle(measured, robot):
    """The pattern that it resembles are fast waves in q, and the plot is over q."""
    data, model = measured((("gear_ripple", 1.0),))
    named = robots.parse(f"{robot.text}\n[drive]\nripple_per_turn = [24]\n", "delta.toml")
    shown = evidence(replace(model, robot=named), data, "gear_ripple").by_variable
    assert shown is not None and shown.channel == "actuator"
    assert np.ptp(shown.x) > np.radians(40) and np.ptp(shown.curve) > 1e-5


def test_a_model_meets_data_of_another_measuring_frame(measured):
    """A model from the base frame is laid onto a tracker's data, and one with a frame does without where none is."""
    data, model = measured((("thermal_arms", 1.0),))
    turn, shift = rotation.exp(np.array([0.8, 1.2, 0.3])), np.array([1.0, 2.0, 0.5])
    tracked = replace(data, position=data.position @ turn.T + shift, rotation=turn @ data.rotation, frame="tracker")
    found = compare(model, tracked)
    assert found.fit.rms_pos == pytest.approx(compare(model, data).fit.rms_pos, rel=0.1)
    assert "thermal_arms" in diagnose(model, tracked, n_draws=ENOUGH_DRAWS).established
    framed = identification.fit(tracked, model).model
    assert framed.frame is not None
    # What a tracker sees does not tell a robot that stands askew from a frame that does: 0.5 mm here, and no metres.
    assert compare(framed, data).fit.rms_pos < 1e-3


USER = """
import numpy as np
from pcalib.effects import Contribution, EffectParameter
class {name}:
    name = "{snake}"
    parameters = (EffectParameter("size", "{unit}", {prior}),)
    needs = {needs}
    def contribution(self, at, theta):
        return {body}
"""


def own(tmp_path, robot, name, body, unit="urad", prior="1e-4", needs="()"):
    file = tmp_path / f"{name.lower()}.py"
    file.write_text(USER.format(name=name, snake=name.lower(), unit=unit, prior=prior, needs=needs, body=body))
    return parse(f"{file}:{name}", robot)


class TestOwnEffects:
    def test_the_unexplained_is_explained_by_ten_lines_of_the_users(self, measured, robot, tmp_path):
        """Encoders that warm up: in no library; the map shows motor angles by temperature, and ten lines do."""
        data, model = measured((("encoder_warming", 4.0),))
        alone = diagnose(model, data, n_draws=ENOUGH_DRAWS)
        assert alone.verdict == "unexplained"
        assert (alone.cells[0].channel, alone.cells[0].variable) == ("actuator", "temp_base")
        body = 'Contribution(actuator=theta * (at.column("temp_base") - 20)[:, None] * np.ones(3))'
        effect = own(tmp_path, robot, "Warm", body, "urad_K", "1e-5", '("temp_base",)')
        found = diagnose(model, data, [effect], n_draws=ENOUGH_DRAWS)
        assert found.established == ("warm",)
        step = add(model, data, effect.spec, [effect])
        assert step.fell and step.after.accuracy.chi2_dof < 1.25
        assert add(model, data, "warm", [effect]).after.accuracy.chi2_dof == pytest.approx(step.after.accuracy.chi2_dof)

    def test_kinship(self, robot, tmp_path):
        twin = own(tmp_path, robot, "Twin", "Contribution(actuator=theta[0] * at.torque)", "urad_Nm", "2e-5")
        assert any("no different from drive_compliance" in line for line in kinship(twin, robot))
        offset = own(tmp_path, robot, "Offset", "Contribution(actuator=theta[0] * np.ones_like(at.q))")
        assert "The geometry absorbs it" in kinship(offset, robot)[0]
        new = own(tmp_path, robot, "Wave", "Contribution(actuator=theta[0] * np.sin(7 * at.q))")
        assert len(kinship(new, robot)) == 1


def test_outliers_are_a_finding_and_do_not_decide(measured):
    data, model = measured((("thermal_arms", 1.0),))
    position = data.position.copy()
    position[[5, 60]] += [1e-3, -5e-4, 8e-4]
    found = diagnose(
        identification.fit(replace(data, position=position), model).model,
        replace(data, position=position),
        n_draws=ENOUGH_DRAWS,
    )
    assert sorted(found.problem.set_aside) == [5, 60]
    assert "thermal_arms" in found.established
    assert any("far from everything" in line and str(int(data.lines[5])) in line for line in telling.details(found))


def test_many_gross_rows_are_set_aside_and_nothing_passes_for_right(measured):
    """One row in twelve is a finding of its own; the noise is that of the others, and what they show still counts."""
    for hidden in ((), (("thermal_arms", 1.0),)):
        data, model = measured(hidden)
        position = data.position.copy()
        gross = np.flatnonzero(~data.check)[::12]
        position[gross] += [1e-3, -2e-3, 2e-3]
        found = diagnose(model, replace(data, position=position), n_draws=ENOUGH_DRAWS)
        assert sorted(found.problem.set_aside) == sorted(gross) and found.problem.outliers.too_many
        assert found.noise.sigma_pos == pytest.approx(15e-6, rel=0.15)
        if hidden:
            assert ("thermal_arms",) in names(found)
        else:
            assert found.verdict == "unexplained" and "of 120 rows are far from everything" in telling.sentence(found)


def test_what_add_confirms_diagnose_does_not_miss():
    """A fault of 3 noise units in the rows to fit, which held-out rows ask for: where `add` confirms it, the diagnosis
    names it too."""
    made = rows.replay("agreement.hidden/3#0", 0)
    found = diagnose(made.model, made.data)
    assert found.verdict == "ambiguous" and ("drive_compliance",) in names(found) and found.refuted == ()
    assert all(e.held_out.confirmed and Doubt.SMALL in e.doubts for e in found.sets)
    assert add(made.model, made.data, "drive_compliance").fell
    assert any(line.startswith("Held-out rows ask for it; the rows to fit alone") for line in telling.details(found))
    alone = replace(found, sets=found.sets[:1])
    assert telling.sentence(alone).endswith("the rows to fit alone show no more of it than noise would.")
    said = telling.evidence_sentence(evidence(made.model, made.data, "drive_compliance"))
    assert said.startswith("Held-out poses ask for drive_compliance. The rows to fit alone show only 3.2 noise units")


class TestVisibility:
    def test_payload_uncovers_compliance(self, measured):
        """κ as it was measured elsewhere: 7 % without payload, 28 % with; gear ratio 2 %, encoder 1x 5 %."""
        plain, rich = (visibility(model, data) for data, model in (measured((), "plain", 100, 0), measured()))
        assert plain["drive_compliance"] < 0.15 < 0.2 < rich["drive_compliance"] < 0.4
        assert rich["gear_ratio"] < 0.05 and rich["encoder_eccentricity"] < 0.1
        assert rich["backlash"] > 0.8 and "friction_hysteresis" not in plain
        assert list(rich.values()) == sorted(rich.values(), reverse=True)

    def test_a_scale_is_no_business_of_poses(self, measured, robot):
        """With one tool an instrument's scale is the geometry's own, exactly."""
        data, _ = measured((), "plain", 100, 0)
        one = replace(data, tool=np.zeros_like(data.tool))
        assert visibility(Model(robot, robot.mechanism.nominal, "complete"), one)["tracker_scale"] < 0.01
