"""What is stated of landings, against Monte Carlo through the whole model and against robots whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import compensation, effects, modelfile, prediction, rotation, workspace
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.fitting import identification
from pcalib.model import Conditions, FittedEffect, Model
from pcalib.uncertainty import assessed, discrepancy, expect, maps, outlook, propagation, radius

SOFT = "drive_compliance"


@pytest.fixture(scope="module")
def truth(delta, perturb) -> Model:
    """A robot with soft drives, 60 µrad/N·m."""
    effect = effects.parse(SOFT, delta)
    model = replace(Model.nominal(delta), effects=(FittedEffect(effect, np.array([6e-5]), SOFT),))
    return model.with_geometry(perturb(5))


@pytest.fixture(scope="module")
def data(truth, measure) -> Measurements:
    rng = np.random.default_rng(3)
    check = np.arange(150) >= 120
    return measure(truth, 150, 2, tools=(0.0, 0.1, 0.3), payload=rng.choice([0.0, 1.0, 2.0], 150), check=check)


def landings(truth: Model, model: Model, data: Measurements, n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Misses (n,) of commands by a model under conditions like those measured, and u95 (n,)."""
    rng = np.random.default_rng(11)
    rows = rng.integers(len(data), size=n)
    conditions = Conditions(data.tool[rows], data.payload[rows])
    wanted = workspace.reachable(model.robot, n, rng).pose.x + conditions.tool
    q = compensation.compensate(model, wanted, conditions=conditions, limits=False).q
    there = prediction.predict(truth, q, conditions).position
    return np.linalg.norm(there - wanted, axis=1), expect(model, q, conditions).u95


def test_propagation_agrees_with_monte_carlo_through_the_whole_model(data, delta):
    start = FittedEffect(effects.parse(SOFT, delta), np.zeros(1), SOFT)
    model = assessed(identification.fit(data, delta, effects=[start]))
    assert model.posterior is not None and model.uncertainty is not None
    model = replace(model, uncertainty=replace(model.uncertainty, shift=0.0, turn=0.0))
    q = workspace.reachable(delta, 4, np.random.default_rng(1)).q
    conditions = Conditions(np.tile([0.0, 0.05, -0.3], (4, 1)), np.full(4, 1.5))
    stated = expect(model, q, conditions)
    rng, level, spots = np.random.default_rng(2), delta.mechanism.levels["complete"], []
    for _ in range(1500):
        off = model.posterior.factor @ rng.standard_normal(len(model.posterior.names))
        k = model.k + level.basis @ off[: len(level.columns)]
        effect = replace(model.effects[0], theta=model.effects[0].theta + off[len(level.columns) :])
        spots.append(prediction.predict(replace(model, k=k, effects=(effect,)), q, conditions).position)
    spots = np.array(spots) - prediction.predict(model, q, conditions).position
    drawn = np.einsum("sni,snj->nij", spots, spots) / len(spots)
    size = np.trace(drawn, axis1=1, axis2=2)[:, None, None]
    assert np.abs((stated.covariance - drawn) / size).max() < 0.06
    assert np.mean(np.linalg.norm(spots, axis=2) <= stated.u95) == pytest.approx(0.95, abs=0.01)


def test_soft_drives_that_nobody_looked_for_are_covered(truth, data, delta):
    model = assessed(identification.fit(data, delta))
    miss, u95 = landings(truth, model, data)
    alone = replace(model, uncertainty=replace(model.uncertainty, shift=0.0, turn=0.0))
    assert np.mean(miss <= landings(truth, alone, data)[1]) < 0.5  # what parameters alone say is wrong
    assert np.mean(miss <= u95) >= 0.9 and u95.mean() < 3 * np.quantile(miss, 0.95)
    assert model.uncertainty.held_out == 30 and model.uncertainty.inside >= 27


def test_an_effect_that_is_known_leaves_nothing_unexplained(truth, data, delta):
    start = FittedEffect(effects.parse(SOFT, delta), np.zeros(1), SOFT)
    model = assessed(identification.fit(data, delta, effects=[start]))
    miss, u95 = landings(truth, model, data)
    assert u95.mean() < 25e-6 and np.mean(miss <= u95) > 0.8


def test_a_row_left_out_is_predicted_as_a_refit_without_it_does(delta, perturb, measure):
    from pcalib.uncertainty.discrepancy import _left_out

    data = measure(Model.nominal(delta).with_geometry(perturb(8)), 30, 4, tools=(0.0, 0.2))
    fit = identification.fit(data, delta, prior_scale=1.0)
    rows = _left_out(fit)
    for row in (0, 7, 19):
        without = identification.fit(data.take(np.arange(30) != row), delta, prior_scale=1.0)
        refit = identification.residuals(without.model, data.take([row]))[0][0]
        off, moved = (np.linalg.norm((e - refit) / data.sigma[row]) for e in (rows.error[row], fit.error[row]))
        assert off < 0.15 * moved  # of how far the row draws the fit, a seventh at most is second order


@pytest.mark.parametrize("rotations", [True, False])
def test_what_turns_the_plate_grows_with_the_tool(delta, perturb, measure, rotations):
    """A turn that jumps from row to row, 0.3 mrad per component, which no geometry explains."""
    rng = np.random.default_rng(6)
    data = measure(Model.nominal(delta).with_geometry(perturb(9)), 120, 5, tools=(0.0, 0.1, 0.3), rotations=rotations)
    turn = 3e-4 * rng.standard_normal((len(data), 3))
    moved = data.position + np.cross(turn, data.tool)  # the plate is nearly level
    from pcalib import rotation

    data = replace(data, position=moved, rotation=rotation.exp(turn) @ data.rotation if rotations else data.rotation)
    kept = assessed(identification.fit(data, delta)).uncertainty
    assert kept.turn == pytest.approx(3e-4, rel=0.25) and kept.shift < 30e-6
    arm = np.array([[0.0, 0, 0], [0, 0, -0.3]])
    small, large = radius.containing(kept.covariance(arm))
    assert large > 5 * small


@pytest.mark.parametrize("tracked", [False, True])
def test_rotations_that_a_level_leaves_out_still_show_what_turns_the_plate(delta, perturb, measure, tracked):
    """A level of perfect parallelograms fits positions without a tool, and misses with one as the plate is tilted."""
    truth = Model.nominal(delta).with_geometry(perturb(5))
    data = measure(truth, 60, 3)
    if tracked:
        turn, body = rotation.exp(np.array([0.1, 0.2, 1.0])), rotation.exp(np.array([0.0, 0.1, 0.5]))
        data = replace(data, frame="tracker", position=data.position @ turn.T, rotation=turn @ data.rotation @ body)
    model = assessed(identification.fit(data, delta, "model24"))
    model = replace(model, frame=None)
    tool = np.array([0.0, 0.0, -0.3])
    wanted = workspace.reachable(delta, 50, np.random.default_rng(4)).pose.x + tool
    conditions = Conditions(np.broadcast_to(tool, wanted.shape), np.zeros(50))
    q = compensation.compensate(model, wanted, conditions=conditions, limits=False).q
    miss = np.linalg.norm(prediction.predict(truth, q, conditions).position - wanted, axis=1)
    u95 = expect(model, q, conditions).u95
    assert np.mean(miss <= u95) >= 0.9 and u95.mean() < 3 * np.quantile(miss, 0.95)


def test_what_was_never_measured_is_named(data, delta):
    model = assessed(identification.fit(data, delta))
    q = np.tile(data.q[:1], (6, 1))
    tool = np.tile([0.0, 0, -0.2], (6, 1))
    tool[1] = [0.15, 0, -0.2]
    columns = {"temp_arms": np.array([20.0] * 6), "dir1": np.array([0.0, 0, 0, 1, 0, 0])}
    found = expect(model, q, Conditions(tool, np.array([1.0, 1, 5, 1, 1, 1]), columns)).extrapolates
    assert all("temperature" in text for text in found)  # none was recorded
    assert found[0] == "temperature" and "tool" in found[1] and "payload" in found[2] and "direction" in found[3]
    plain = expect(model, data.q, Conditions(data.tool, data.payload))
    assert not any(plain.extrapolates)
    far = expect(model, np.full((1, 3), delta.joint_max), Conditions.of(1, [0, 0, -0.2]))
    assert far.extrapolates[0] == "place"


def test_uncertainty_is_kept_in_the_model_file_and_absent_in_old_ones(data, delta):
    model = assessed(identification.fit(data, delta))
    text = modelfile.dumps(model)
    again = modelfile.loads(text)
    q, conditions = data.q[:5], Conditions(data.tool[:5], data.payload[:5])
    assert np.allclose(expect(again, q, conditions).u95, expect(model, q, conditions).u95, rtol=1e-5)
    old = modelfile.loads(text[: text.index("[uncertainty]")] + text[text.index("[robot]") :])
    assert old.uncertainty is None
    with pytest.raises(InputError, match="states no uncertainty"):
        expect(old, q, conditions)
    assert "states no uncertainty" in outlook.said(old)[0]
    for before, after in (("shift_um = ", "shift_um = -"), ("rows = 30", "rows = []"), ("payload_kg = [", "x = [")):
        with pytest.raises(InputError, match="uncertainty"):
            modelfile.loads(text.replace(before, after))


def test_the_outlook_says_what_it_is_made_of(data, delta):
    model = assessed(identification.fit(data, delta))
    said, content = outlook.said(model)
    assert said.startswith("Expect 95 % of landings within ") and "with a 300 mm tool" in said and "unexplained" in said
    assert content["schema"] == "pcalib.uncertainty/1" and content["coverage"]["rows"] == 30
    assert content["components_um"]["unexplained"] > content["components_um"]["geometry"] > 0
    assert content["components_um"]["effects"] == 0 == content["components_um"]["rivals"]


def test_the_map_of_a_model_is_what_is_expected_command_by_command(data, delta):
    model = assessed(identification.fit(data, delta))
    over = maps.of_model(model)
    assert [m.label for m in over.maps] == ["tool 0 mm", "tool 300 mm"]
    field = over.maps[1]
    assert field.expected is not None and field.expected.pooled[0] > over.maps[0].expected.pooled[0]
    conditions = Conditions(np.tile(field.tool, (3, 1)), np.zeros(3))
    q = compensation.compensate(model, field.targets[:3], conditions=conditions, limits=False).q
    assert field.expected.u95[0, :3] == pytest.approx(expect(model, q, conditions).u95, rel=1e-9)
    assert maps.of_model(Model.nominal(delta)).maps[0].expected is None


def test_a_rival_counts_where_it_would_land_the_tcp_elsewhere(data, delta):
    model = assessed(identification.fit(data, delta))
    other = model.with_geometry(model.k + delta.mechanism.levels["complete"].basis[:, 0] * 1e-4)
    entry = modelfile.snapshot(other, "rival", weight=0.5, effect="arm_bending")
    torn = replace(model, uncertainty=replace(model.uncertainty, rivals=(entry,)))
    torn = modelfile.loads(modelfile.dumps(torn))
    from pcalib.uncertainty import rivals

    q, conditions = data.q[:3], Conditions(data.tool[:3], data.payload[:3])
    found = expect(torn, q, conditions, rivals=rivals.models(torn))
    assert np.array_equal(expect(torn, q, conditions).covariance, found.covariance, equal_nan=True)
    apart = prediction.predict(other, q, conditions).position - prediction.predict(model, q, conditions).position
    assert np.allclose(found.components["rivals"], 0.5 * apart[:, :, None] * apart[:, None, :], rtol=1e-3, atol=1e-18)
    more = found.covariance - expect(model, q, conditions).covariance
    assert np.allclose(more, found.components["rivals"], rtol=1e-2)


def test_a_rival_that_only_stands_elsewhere_counts_nothing_once_the_frame_is_taught(data, delta):
    """What moves all landings alike is taught away; what bends them apart is not."""
    seen = replace(data, frame="tracker", position=data.position + [2.0, 1.0, 0.5])
    model = assessed(identification.fit(seen, delta))
    mechanism = delta.mechanism
    lifted, longer = np.zeros((2, len(mechanism.nominal)))
    lifted[[mechanism.index(f"p{i}.z") for i in (1, 2, 3)]] = 1e-3
    longer[mechanism.index("l11")] = 1e-3
    conditions = Conditions.of(60, np.array([0.0, 0.0, -0.3]))
    q = workspace.reachable(delta, 60, np.random.default_rng(3)).q
    radii = []
    for change in (None, lifted, longer):
        shifted = [] if change is None else [model.with_geometry(model.k + change)]
        other = tuple(modelfile.snapshot(each, "rival", weight=0.5) for each in shifted)
        torn = replace(model, uncertainty=replace(model.uncertainty, rivals=other))
        radii.append(propagation.taught(torn, expect(torn, q, conditions), q, conditions))
    assert radii[1] == pytest.approx(radii[0], rel=1e-3) and radii[2] > 3 * radii[0]


def test_adding_an_effect_keeps_the_explanations_that_stand_beside_it(truth, data, delta):
    from pcalib.diagnosis import steps
    from pcalib.uncertainty import rivals

    step = steps.add(identification.fit(data, delta).model, data, SOFT)
    model = rivals.kept(assessed(step.after), step.before.candidate, data, SOFT)
    assert model.uncertainty.rivals and sum(r["weight"] for r in model.uncertainty.rivals) < 1
    assert "arm_bending" in rivals.words(model)
    assert outlook.outlook(model, rivals=rivals.models(model)).components["rivals"] > 0


def test_a_plate_that_cannot_turn_has_no_lever(delta):
    """What positions leave unexplained is then a shift alone, and no model states a turn that is no number."""
    still = replace(delta.mechanism, plate_dofs=(0, 1, 2))
    robot = replace(delta)
    vars(robot)["mechanism"] = still  # where the cached property keeps it
    model = replace(Model.nominal(delta), robot=robot)
    assert not still.plate_turns and discrepancy._half_width(model) == np.inf
    assert delta.mechanism.plate_turns and 0 < discrepancy._half_width(Model.nominal(delta)) < 0.2
