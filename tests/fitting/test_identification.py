"""Identification: exact where data are exact, calibrated where they are noisy, and outspoken where they are bad."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import effects, planning, prediction, rotation, summary
from pcalib.data.measurement import Measurements
from pcalib.errors import FitError, InputError
from pcalib.fitting import identification
from pcalib.fitting.identifiability import PRIOR
from pcalib.fitting.result import Code
from pcalib.mechanics import kinematics
from pcalib.model import FittedEffect, Frame, Model
from pcalib.prediction import Conditions

LENGTHS = (0.0, 0.1, 0.3)
EXACT = {"noise": 0.0, "stated": 1e-5}
"""Exact data whose instrument is said to be as good: priors have nothing left to say."""


@pytest.fixture(scope="module")
def truth(delta, perturb):
    return replace(Model.nominal(delta), k=perturb(20, 0.2, 0.1))


@pytest.fixture(scope="module")
def fresh(delta):
    """Poses that no fit has seen."""
    return planning.reachable(delta, 200, np.random.default_rng(99)).q


def disagreement(a: Model, b: Model, q: np.ndarray, tool: np.ndarray | float = 0.0) -> tuple[float, float]:
    """Largest difference of two models' readings [m], [rad] at commands q."""
    one, two = (prediction.predict(model, q, Conditions.of(len(q), tool)) for model in (a, b))
    turned = rotation.log(one.rotation @ np.swapaxes(two.rotation, -1, -2))
    off = np.linalg.norm(one.position - two.position, axis=1)
    return float(off.max()), float(np.linalg.norm(turned, axis=1).max())


# --- exact data -----------------------------------------------------------------------------------------------------


def test_exact_full_poses_give_the_robot_back(truth, measure, fresh):
    found = identification.fit(measure(truth, 60, **EXACT), truth.robot)
    assert found.n_identified == 54  # 60 less the six exact gauge freedoms: what is left shows, if only to such noise
    for tool in ([0.0, 0, 0], [0.1, -0.05, -0.3]):
        x, turn = disagreement(found.model, truth, fresh, np.array(tool))
        assert x < 1e-9 and turn < 1e-9


@pytest.mark.parametrize("size", [1.0, 0.1])
def test_the_base_gives_back_a_robot_of_the_base_and_others_to_second_order(truth, measure, fresh, size):
    found = identification.fit(measure(truth, 60, **EXACT), truth.robot, method="base")
    base = [truth.robot.mechanism.index(name) for name in found.identifiability.base]
    assert len(base) == 42
    inside = Model.nominal(truth.robot).errors
    inside[base] = size * truth.errors[base]
    there = truth.with_geometry(truth.robot.mechanism.nominal + inside)
    again = identification.fit(measure(there, 60, **EXACT), truth.robot, method="base")
    assert disagreement(again.model, there, fresh)[0] < 1e-9
    np.testing.assert_allclose(again.model.k, there.k, atol=1e-8)
    outside = truth.with_geometry(truth.robot.mechanism.nominal + size * truth.errors)
    again = identification.fit(measure(outside, 60, **EXACT), truth.robot, method="base")
    assert 1e-8 * size**2 < disagreement(again.model, outside, fresh)[0] < 2e-6 * size**2


def test_identifiable_combinations_themselves(delta, perturb, measure):
    """Not only their readings: the projections of δk on the directions seen at nominal, for errors small enough that
    these directions do not turn (2 µm)."""
    mechanism = delta.mechanism
    truth = replace(Model.nominal(delta), k=perturb(21, 0.002, 0.001))
    data = measure(truth, 60, **EXACT)
    found = identification.fit(data, delta)
    nominal = kinematics.forward(mechanism, mechanism.nominal, data.q).pose
    S = kinematics.sensitivity(mechanism, mechanism.nominal, data.q, nominal)
    scale = np.array([PRIOR[u] for u in mechanism.units])
    _, s, Vt = np.linalg.svd(S.reshape(-1, 60) * scale)
    assert s[41] / s[42] > 1e6
    off = Vt[:42] @ ((found.model.k - truth.k) / scale)
    assert np.abs(off).max() * PRIOR["m"] < 1e-9


def test_exact_positions_with_three_tools(truth, measure, fresh):
    found = identification.fit(measure(truth, 80, tools=LENGTHS, rotations=False, **EXACT), truth.robot)
    for h in (0.0, 0.05, 0.3):
        assert disagreement(found.model, truth, fresh, np.array([0, 0, -h]))[0] < 1e-9


def test_exact_data_with_gaps(truth, measure, fresh):
    """Some rows without rotation, some without x, or with z alone, with several tools."""
    data = measure(truth, 120, tools=LENGTHS, **EXACT)
    mask = data.mask.copy()
    rng = np.random.default_rng(0)
    mask[rng.random(120) < 0.5, 3:] = False
    mask[rng.random(120) < 0.3, 0] = False
    mask[rng.random(120) < 0.2, :2] = False
    mask[:5, :3], mask[:5, 3:] = False, True
    position, turn = np.where(mask[:, :3], data.position, np.nan), data.rotation.copy()
    turn[~mask[:, 3]] = np.nan
    found = identification.fit(replace(data, mask=mask, position=position, rotation=turn), truth.robot)
    assert disagreement(found.model, truth, fresh, np.array([0, 0, -0.2]))[0] < 1e-9
    assert np.array_equal(np.isnan(found.error), ~mask)


FRAME = Frame(rotation.exp(np.array([0.3, -0.5, 2.6])), np.array([2.5, -1.0, 0.8]), np.array([3e-3, -4e-3, 2e-3]))


@pytest.mark.parametrize("method", ["map", "base"])
@pytest.mark.parametrize("rotations", [True, False], ids=["poses", "positions"])
def test_exact_data_of_a_tracker(truth, measure, fresh, rotations, method):
    """Registration and target place unknown: the readings are found again, by the base to second order."""
    there = replace(truth, frame=FRAME)
    data = measure(there, 80, tools=LENGTHS, rotations=rotations, noise=0.0, stated=1e-5 if rotations else 1e-4)
    found = identification.fit(data, truth.robot, method=method).model
    x, turn = disagreement(found, there, fresh, np.array([0.0, 0, -0.1]))
    limit = 1e-9 if method == "map" else 2e-6
    assert x < limit and (turn < limit or not rotations)


def test_exact_data_with_an_effect(truth, measure, fresh):
    drive = effects.get("drive_compliance", robot=truth.robot)
    there = replace(truth, effects=(FittedEffect(drive, np.array([8e-5])),))
    data = measure(there, 80, payload=np.linspace(0, 3, 80), **EXACT)
    found = identification.fit(data, truth.robot, effects=[FittedEffect(drive, np.zeros(1))])
    assert found.model.effects[0].theta[0] == pytest.approx(8e-5, rel=1e-6)
    # Where an arm's centre of mass is, a gauge of the geometry otherwise, shows in the loads: nanometres.
    assert disagreement(found.model, there, fresh)[0] < 3e-9


# --- noisy data -----------------------------------------------------------------------------------------------------


def drawn(delta, perturb, measure, seed, n=40, **options):
    """A robot drawn from the manufacturing priors, and its noisy data."""
    truth = replace(Model.nominal(delta), k=perturb(1000 + seed))
    return truth, measure(truth, n, seed, **options)


def spread(z):
    """RMS of scores and its own standard error, a score per row being independent and those in a row not."""
    mean = np.mean(z**2, axis=1)
    return np.sqrt(mean.mean()), 0.5 * mean.std() / np.sqrt(len(mean)) / np.sqrt(mean.mean())


@pytest.mark.parametrize("options", [{}, {"rotations": False, "tools": LENGTHS}], ids=["poses", "positions"])
def test_sigma_is_calibrated(delta, perturb, measure, options):
    """Errors of all 60 parameters in units of the stated posterior σ, robots drawn from the prior: RMS 1."""
    scores, chi2 = [], []
    for seed in range(60):
        truth, data = drawn(delta, perturb, measure, seed, **options)
        found = identification.fit(data, delta, prior_scale=1.0)
        assert found.model.sigma is not None
        scores.append((found.model.k - truth.k) / found.model.sigma)
        chi2.append(found.accuracy.chi2_dof)
    rms, error = spread(np.array(scores))
    assert error < 0.05
    assert abs(rms - 1) < 4 * error
    assert np.mean(chi2) == pytest.approx(1, abs=4 * np.std(chi2) / np.sqrt(60))
    assert np.std(chi2) < 0.2


def test_sigma_of_identified_directions_without_priors(delta, perturb, measure):
    """The base method: predicted readings at new poses, in units of the σ that the covariance gives them."""
    mechanism = delta.mechanism
    q = planning.reachable(delta, 20, np.random.default_rng(3)).q
    scores = []
    for seed in range(40):
        truth, data = drawn(delta, perturb, measure, seed)
        found = identification.fit(data, delta, method="base")
        pose = kinematics.forward(mechanism, found.model.k, q).pose
        S = kinematics.sensitivity(mechanism, found.model.k, q, pose)[:, :3]
        sigma = np.sqrt(np.einsum("nij,jk,nik->ni", S, found.covariance[:60, :60], S))
        off = pose.x - kinematics.forward(mechanism, truth.k, q).pose.x
        scores.append((off / sigma).ravel())
    rms, error = spread(np.array(scores))
    assert error < 0.05
    assert abs(rms - 1) < 4 * error


def test_sigma_of_an_effect(delta, perturb, measure):
    scores = []
    drive = effects.get("drive_compliance", robot=delta)
    for seed in range(30):
        truth = replace(Model.nominal(delta), k=perturb(seed), effects=(FittedEffect(drive, np.array([8e-5])),))
        data = measure(truth, 60, seed, payload=np.tile([0.0, 1, 2], 20))
        found = identification.fit(data, delta, effects=[FittedEffect(drive, np.zeros(1))], prior_scale=1.0)
        fitted = found.model.effects[0]
        assert fitted.sigma is not None
        scores.append((fitted.theta - 8e-5) / fitted.sigma)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1, abs=0.4)  # 3σ for 30 seeds


def test_priors_widen_where_the_robot_is_worse_than_the_drawing(delta, perturb, measure):
    """Evidence finds the common scale of the errors: five times the tolerances, and never less than them."""
    for factor in (5.0, 0.2):
        robots = [replace(Model.nominal(delta), k=perturb(s, 0.1 * factor, 0.05 * factor)) for s in range(8)]
        found = [identification.fit(measure(robot, 60, s), delta) for s, robot in enumerate(robots)]
        scale = np.mean([f.prior_scale for f in found])
        assert scale == pytest.approx(max(factor, 1.0), rel=0.15)
        assert any("times the assumed tolerances" in str(w) for w in found[0].warnings) == (factor > 1)


# --- rows -----------------------------------------------------------------------------------------------------------


def test_held_out_rows_never_matter(truth, measure):
    check = np.arange(60) % 4 == 0
    data = measure(truth, 60, check=check, rotations=True)
    first = identification.fit(data, truth.robot)
    position, turn, sigma, q = data.position.copy(), data.rotation.copy(), data.sigma.copy(), data.q.copy()
    position[check] += 0.02
    turn[check] = np.eye(3)
    sigma[check] = 1e-9
    q[check] = q[check][::-1]
    changed = replace(data, position=position, rotation=turn, sigma=sigma, q=q)
    second = identification.fit(changed, truth.robot)
    absent = identification.fit(data.take(~check), truth.robot)
    for other in (second, absent):
        assert np.array_equal(first.model.k, other.model.k)
        assert np.array_equal(first.covariance, other.covariance)
        assert first.accuracy == other.accuracy
        assert first.prior_scale == other.prior_scale
    assert first.check is not None and second.check is not None and absent.check is None
    assert first.check.n_rows == 15 and first.accuracy.n_rows == 45
    assert second.check.rms_pos > 100 * first.check.rms_pos
    assert first.check.chi2_dof == pytest.approx(1, abs=1.0)
    with pytest.raises(InputError, match="all are set = check"):
        identification.fit(replace(data, check=np.ones(60, bool)), truth.robot)


def test_check_rows_that_cannot_be_reached_are_said_and_change_nothing(truth, measure):
    check = np.arange(60) >= 55
    data = measure(truth, 60, check=check)
    q = data.q.copy()
    q[58] = np.radians([90, -100, 0])
    plain, odd = identification.fit(data, truth.robot), identification.fit(replace(data, q=q), truth.robot)
    assert np.array_equal(plain.model.k, odd.model.k)
    assert np.isnan(odd.error[58]).all() and np.isfinite(odd.error[57]).all()
    assert odd.check is not None and np.isfinite(odd.check.chi2_dof) and odd.check.n_rows == 4
    assert any("line 60" in str(w) for w in odd.warnings) and not any("line 60" in str(w) for w in plain.warnings)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_gross_outliers_are_reported_and_do_not_spoil_the_fit(truth, measure, fresh, loss):
    data = measure(truth, 80, 4)
    bad = np.array([3, 17, 40, 41, 77])
    position, turn = data.position.copy(), data.rotation.copy()
    position[bad[:3], 2] += 2e-3
    turn[bad[3:]] = rotation.exp(np.array([0.01, -0.02, 0])) @ turn[bad[3:]]
    spoilt = replace(data, position=position, rotation=turn)
    clean = disagreement(identification.fit(data, truth.robot).model, truth, fresh)[0]
    plain = disagreement(identification.fit(spoilt, truth.robot).model, truth, fresh)[0]
    found = identification.fit(spoilt, truth.robot, loss=loss)
    robust = disagreement(found.model, truth, fresh)[0]
    assert robust < {"huber": 3, "cauchy": 1.5}[loss] * clean and robust < 0.25 * plain
    assert set(np.flatnonzero(found.weight < 0.5)) == set(bad)
    said = next(str(w) for w in found.warnings if w.code is Code.LITTLE_WEIGHT)
    assert "5 rows" in said and all(str(line) in said for line in bad + 2)
    assert found.accuracy.max_pos > 1e-3  # figures count every row


def test_outliers_are_judged_in_units_of_sigma(truth, measure):
    """Millimetres and radians have no common threshold: a rotation 30 σ off (0.15°) is seen beside positions in mm."""
    data = measure(truth, 60, 5)
    turn = data.rotation.copy()
    turn[10] = rotation.exp(np.array([30 * np.radians(0.005), 0, 0])) @ turn[10]
    found = identification.fit(replace(data, rotation=turn), truth.robot, loss="cauchy")
    assert np.argmin(found.weight) == 10 and found.weight[10] < 0.2
    assert np.sum(found.weight < 0.5) <= 2
    # and the same data in other units of σ give the same weights
    wide = identification.fit(replace(data, rotation=turn, sigma=data.sigma * 1.0), truth.robot, loss="cauchy")
    assert np.array_equal(found.weight, wide.weight)


# --- priors, bounds, fixed parameters -------------------------------------------------------------------------------


def test_fixed_bounded_and_prior_overrides(truth, measure):
    data, mechanism = measure(truth, 60), truth.robot.mechanism
    free = identification.fit(data, truth.robot).model
    at = mechanism.index
    fixed = identification.fit(data, truth.robot, fixed=["l11", "beta2.x"]).model
    assert fixed.k[at("l11")] == mechanism.nominal[at("l11")]
    assert fixed.k[at("beta2.x")] == mechanism.nominal[at("beta2.x")]
    assert fixed.sigma is not None and np.isnan(fixed.sigma[at("l11")]) and np.isfinite(fixed.sigma[at("l12")])
    moved = free.k[at("l11")] - mechanism.nominal[at("l11")]
    limit = 0.25 * abs(moved)
    assert limit > 1e-6
    bounded = identification.fit(data, truth.robot, bounds={"l11": (-limit, limit)})
    assert abs(bounded.model.k[at("l11")] - mechanism.nominal[at("l11")]) == pytest.approx(limit, rel=1e-6)
    assert bounded.accuracy.rms_pos < 2e-4
    wide = identification.fit(data, truth.robot, bounds={"l11": (-1, 1)}).model
    np.testing.assert_allclose(wide.k, free.k, atol=1e-9)
    tight = identification.fit(data, truth.robot, prior={"l11": 1e-9}, prior_scale=1.0).model
    assert abs(tight.k[at("l11")] - mechanism.nominal[at("l11")]) < 1e-9
    loose = identification.fit(data, truth.robot, prior={"m": 1e-2, "rad": 1e-1}, prior_scale=1.0)
    base = identification.fit(data, truth.robot, method="base")
    assert disagreement(loose.model, base.model, data.q)[0] < 1e-5  # without a prior's pull, both are least squares
    with pytest.raises(InputError, match="unknown parameter of level complete 'l99'"):
        identification.fit(data, truth.robot, fixed=["l99"])
    with pytest.raises(InputError, match="unknown parameter of level complete 'l1'"):
        identification.fit(data, truth.robot, bounds={"l1": (0, 1)})
    with pytest.raises(InputError, match=r"l11: both fixed and bounded\n.*--fix"):
        identification.fit(data, truth.robot, fixed=["l11"], bounds={"l11": (0, 1)})
    with pytest.raises(InputError, match="unknown parameter of level complete 'mm'"):
        identification.fit(data, truth.robot, prior={"mm": 1.0})


@pytest.mark.parametrize("method", ["map", "base"])
@pytest.mark.parametrize("low", [2e-4, -5e-4])
def test_a_start_outside_its_bounds_moves_to_the_nearest(truth, measure, low, method):
    bounds = (low, low + 3e-4)
    assert not bounds[0] <= 0 <= bounds[1]
    found = identification.fit(measure(truth, 60), truth.robot, bounds={"l11": bounds}, method=method).candidate
    change = found.errors[truth.robot.mechanism.index("l11")]
    assert bounds[0] - 1e-12 < change < bounds[1] + 1e-12


def test_a_fit_starts_from_a_model(truth, measure):
    """A start at the answer is an answer at once, and fixed parameters keep the start's values."""
    data, mechanism = measure(truth, 60), truth.robot.mechanism
    nominal = identification.fit(data, truth.robot, prior_scale=1.0)
    again = identification.fit(data, nominal.model, prior_scale=1.0)
    assert again.iterations == 1 < nominal.iterations
    np.testing.assert_allclose(again.model.k, nominal.model.k, atol=1e-8)
    i = mechanism.index("l11")
    start = Model.nominal(truth.robot).with_geometry(truth.k)
    for level in ("complete", "model24"):
        name = {"complete": "l11", "model24": "rod1.length"}[level]
        held = identification.fit(data, start, level, fixed=[name])
        value = held.candidate.k[i]
        wanted = truth.k[i] if level == "complete" else 0.5 * (truth.k[i] + truth.k[i + 1])
        assert value == pytest.approx(wanted, abs=1e-12)


def test_levels_are_subspaces(truth, measure):
    data, mechanism = measure(truth, 60), truth.robot.mechanism
    rms = {}
    for level, n in (("nominal", 0), ("classical", 9), ("model24", 24), ("complete", 60)):
        found = identification.fit(data, truth.robot, level)
        basis = mechanism.levels[level].basis
        errors = found.model.errors
        assert basis.shape[1] == n == found.unknowns.n_geometry
        assert np.abs(errors - basis @ (np.linalg.pinv(basis) @ errors)).max() < 1e-15
        rms[level] = found.accuracy.rms_pos
    assert rms["nominal"] > 2 * rms["classical"] > 4 * rms["model24"] and rms["complete"] < 5e-5
    with pytest.raises(InputError, match="unknown level 'complet'"):
        identification.fit(data, truth.robot, "complet")


def test_rows_that_do_not_settle_are_said(delta):
    """A rod that hangs between the ends of its play: the row counts, and the fit says how far that can be trusted."""
    gap = effects.get("joint_clearance", None, delta)
    model = replace(Model.nominal(delta), effects=(FittedEffect(gap, np.array([1e-4])),))
    q, tool = planning.reachable(delta, 400, np.random.default_rng(1)).q, np.array([0.06, 0, -0.2])
    p = prediction.predict(model, q, Conditions.of(len(q), tool))
    hangs = np.flatnonzero(p.status != "ok")
    assert 0 < len(hangs) < 5
    settled = np.setdiff1d(np.arange(60), hangs)
    for rows, number in ((settled, 0), (np.r_[settled, hangs], len(hangs))):
        data = Measurements.create(
            delta, q[rows], p.position[rows], p.rotation[rows], tool=tool, sigma_pos=1e-5, sigma_rot=1e-4
        )
        found = identification.fit(data, model, "nominal")
        said = [str(w) for w in found.warnings if w.code is Code.UNSETTLED]
        assert len(said) == (number > 0) and np.isfinite(found.error).all()
        assert all(str(line) in said[0] for line in data.lines[len(settled) :])


def test_what_a_level_does_not_free_has_no_sigma(truth, measure):
    """Nor a σ of 1e-20 by rounding, in which any later change would be counted."""
    data, mechanism = measure(truth, 60), truth.robot.mechanism
    tolerance = np.array([PRIOR[unit] for unit in mechanism.units])
    for level, freed in (("nominal", 0), ("classical", 17), ("model24", 39), ("complete", 60)):
        sigma = identification.fit(data, truth.robot, level).candidate.sigma
        assert sigma is not None and np.isfinite(sigma).sum() == freed
        assert (sigma[np.isfinite(sigma)] > 1e-6 * tolerance[np.isfinite(sigma)]).all()


# --- methods --------------------------------------------------------------------------------------------------------


def test_linear_is_the_papers_one_step(truth, measure):
    """Eqs (23)–(26) computed here: S_C at nominal at the measured poses, weighted least squares, one step."""
    data, mechanism = measure(truth, 40, tools=(0.1,)), truth.robot.mechanism
    nominal = kinematics.forward(mechanism, mechanism.nominal, data.q).pose
    S = kinematics.sensitivity(mechanism, mechanism.nominal, data.q, nominal, data.tool[0])
    turned = rotation.log(data.rotation @ np.swapaxes(nominal.R, -1, -2))
    dX = np.hstack([data.position - nominal.tcp(data.tool), turned])
    for weighted in (True, False):
        found = identification.fit(data, truth.robot, method="linear", weighted=weighted)
        W = 1 / data.sigma if weighted else np.tile([1e3, 1e3, 1e3, 1, 1, 1], (40, 1))  # mm and rad alike
        A, y = (W[..., None] * S).reshape(-1, 60), (W * dX).ravel()
        scale = np.array([PRIOR[u] for u in mechanism.units])
        fitted = A @ (scale * np.linalg.lstsq(A * scale, y, rcond=1e-9)[0])
        step = found.candidate.errors
        np.testing.assert_allclose(A @ step, fitted, atol=1e-8 * np.abs(fitted).max())
        assert np.sum(np.abs(step) > 0) == 42
        assert found.iterations == 1 and found.status == "converged"
        out = set(found.identifiability.dependent)
        assert len(out) == 18 and {p for p, e in zip(mechanism.parameters, step, strict=True) if e == 0} == out


def test_iteration_removes_the_second_order_that_linear_keeps(delta, perturb, measure, fresh):
    truth = replace(Model.nominal(delta), k=perturb(22, 0.5, 0.2))
    data = measure(truth, 60, **EXACT)
    fits = {method: identification.fit(data, delta, method=method) for method in identification.METHODS}
    off = {method: disagreement(found.model, truth, fresh)[0] for method, found in fits.items()}
    assert off["linear"] > 5 * off["base"]
    assert off["map"] < 1e-9


# --- refusals -------------------------------------------------------------------------------------------------------


def test_an_unconverged_fit_refuses_its_model(delta, perturb, measure):
    data = measure(replace(Model.nominal(delta), k=perturb(23, 1.0, 0.5)), 60)
    found = identification.fit(data, delta, max_iterations=2)
    assert found.status == "not_converged"
    assert np.isfinite(found.candidate.k).all()
    with pytest.raises(FitError, match="no minimum after 2 iterations"):
        _ = found.model


@pytest.mark.parametrize("method", ["map", "base", "linear"])
def test_poses_in_one_corner_are_rank_deficient(truth, measure, method):
    one = planning.reachable(truth.robot, 1, np.random.default_rng(0)).q
    q = one + np.radians(0.01) * np.random.default_rng(1).uniform(-1, 1, (60, 3))
    found = identification.fit(measure(truth, q=q), truth.robot, method=method)
    assert found.status == "rank_deficient"
    with pytest.raises(FitError, match=r"the data identify \d+ of the 42 directions of level complete"):
        _ = found.model
    assert summary.fit_json(found)["status"] == "rank_deficient"


def test_too_few_poses(truth, measure):
    for n, level, options, readings in (
        (7, "complete", {}, 42),
        (1, "complete", {}, 6),
        (12, "complete", {"rotations": False}, 36),
        (2, "classical", {}, 6),  # which takes no rotations
    ):
        data = measure(truth, n, **options)
        with pytest.raises(InputError, match=f"too few poses: {n} poses? gives? {readings} readings, level") as caught:
            identification.fit(data, truth.robot, level)
        assert "measure at least" in str(caught.value)
    assert identification.fit(measure(truth, 8), truth.robot).expected == 42  # the minimum of full poses


def test_expectations_follow_the_readings(truth, measure):
    def expected(**options):
        return identification.fit(measure(truth, 60, **options), truth.robot).expected

    assert expected() == 42
    assert expected(rotations=False) in (37, 38)
    assert expected(rotations=False, tools=LENGTHS) in (40, 41)
    many = np.random.default_rng(0).uniform(-0.3, 0.3, (60, 3))  # a tool of its own for every row
    assert expected(rotations=False, tools=many) in (40, 41, 42)


def test_position_only_with_one_tool_is_warned_of(truth, measure):
    found = identification.fit(measure(truth, 60, rotations=False), truth.robot)
    assert any("tilt is not seen" in str(w) for w in found.warnings)
    for options in ({"rotations": False, "tools": LENGTHS}, {}):
        found = identification.fit(measure(truth, 60, **options), truth.robot)
        assert Code.TILT_UNSEEN not in {w.code for w in found.warnings}


def test_swapped_joint_columns_are_named(truth, measure):
    data = measure(truth, 60)
    with pytest.raises(InputError, match="q1 is what stands in q2, q2 is what stands in q1") as caught:
        identification.fit(replace(data, q=data.q[:, [1, 0, 2]]), truth.robot)
    assert "measurements" in str(caught.value)


def test_degrees_given_as_radians_cannot_be_closed(truth, measure):
    data = measure(truth, 60)
    with pytest.raises(InputError, match="cannot close its loops") as caught:
        identification.fit(replace(data, q=np.degrees(data.q)), truth.robot)
    assert "check the sign, order and unit" in str(caught.value)


def test_unknown_method_and_loss(truth, measure):
    data = measure(truth, 30)
    with pytest.raises(InputError, match="unknown method 'maps'"):
        identification.fit(data, truth.robot, method="maps")
    with pytest.raises(InputError, match="unknown loss 'hubert'"):
        identification.fit(data, truth.robot, loss="hubert")


# --- what others paid for -------------------------------------------------------------------------------------------


def test_the_cost_is_squared_once(truth, measure):
    """Without priors, twice the stated σ quarters χ², and leaves the estimate and the σ that the data support alone."""
    data = measure(truth, 60)
    one = identification.fit(data, truth.robot, method="base")
    two = identification.fit(replace(data, sigma=2 * data.sigma), one.model, method="base")  # so both end at one point
    assert one.identifiability.base == two.identifiability.base
    np.testing.assert_allclose(two.model.k, one.model.k, atol=1e-7)  # both within 0.003 σ of the minimum
    size = np.sqrt(np.diag(one.covariance)) + 1e-12
    np.testing.assert_allclose(two.covariance / np.outer(size, size), one.covariance / np.outer(size, size), atol=1e-3)
    assert one.accuracy.chi2_dof / two.accuracy.chi2_dof == pytest.approx(4, rel=1e-5)
    assert one.accuracy.rms_pos == pytest.approx(two.accuracy.rms_pos, rel=1e-4)


def test_priors_do_not_mix_metres_and_radians(truth, measure):
    """A regulariser of one number for all would hold angles 1000 times tighter than lengths; the fit's answer does not
    depend on the unit in which it thinks of angles, nor does an angle's σ ever exceed its own prior."""
    found = identification.fit(measure(truth, 40), truth.robot, prior_scale=1.0)
    units = np.array(truth.robot.mechanism.units)
    sigma = found.model.sigma
    assert sigma is not None
    for unit in ("m", "rad"):
        share = sigma[units == unit] / PRIOR[unit]
        assert share.max() <= 1 + 1e-9 and share.min() < 0.9
    errors = found.model.errors / np.where(units == "rad", PRIOR["rad"], PRIOR["m"])
    assert 0.2 < np.std(errors[units == "rad"]) / np.std(errors[units == "m"]) < 5


def test_a_frame_absorbs_no_geometry_in_silence(truth, measure):
    """With the frame unknown, six combinations of geometry are the frame's: said so, and held by priors."""
    data = measure(replace(truth, frame=FRAME), 80)
    found = identification.fit(data, truth.robot)
    assert found.expected == 36 and found.identifiability.n_identified <= 38
    units = np.array(truth.robot.mechanism.units)
    scale = np.where(units == "rad", PRIOR["rad"], PRIOR["m"])
    assert np.std(found.model.errors / scale) < 3
    sentences = found.identifiability.sentences()
    assert len(sentences) >= 60 - 38
    assert len(summary.fit_json(found)["unidentifiable"]) == len(sentences)


def test_json_of_a_fit_has_the_keys_of_the_contract(truth, measure):
    import json

    found = identification.fit(measure(truth, 60, check=np.arange(60) > 50), truth.robot)
    said = json.loads(json.dumps(summary.fit_json(found)))
    assert said["schema"] == "pcalib.fit/1" and said["level"] == "complete" and said["effects"] == []
    assert said["n_identified"] == 42 and set(said["check"]) >= {"rms_pos_um", "chi2_dof"}
    assert {"rms_pos_um", "max_pos_um", "rms_rot_urad", "chi2_dof"} <= set(said)
    assert said["parameters"]["l11"].keys() == {"nominal", "value", "sigma", "unit"}
    assert said["parameters"]["l11"]["nominal"] == 0.8 and said["parameters"]["l11"]["unit"] == "m"
    bp = said["combinations"]["bp11.x"]
    at = said["parameters"]
    assert bp["value"] == pytest.approx(at["b11.x"]["value"] - at["p1.x"]["value"], abs=1e-15)
    i, j = (truth.robot.mechanism.index(n) for n in ("b11.x", "p1.x"))
    C = found.covariance
    assert bp["sigma"] == pytest.approx(np.sqrt(C[i, i] + C[j, j] - 2 * C[i, j]))


@pytest.mark.parametrize("start", [0.0, 36_000.0, 1.76e9], ids=["stopwatch", "ten in the morning", "Unix"])
def test_a_drift_is_found_whatever_the_clock_reads(delta, perturb, measure, start):
    """Time counts from the first row, as effects are promised; and a refit counts from where the first fit did."""
    drift = FittedEffect(effects.get("base_drift", None, delta), np.array([5e-8, 0, 0, 0, 0, 0]), "base_drift")
    truth = replace(Model(delta, perturb(5), "complete", (drift,)), time_origin=start)
    time = start + 60.0 * np.arange(80)
    data = measure(truth, 80, columns={"time": time}, check=np.arange(80) >= 60)
    found = identification.fit(data, delta, effects=[replace(drift, theta=np.zeros(6))])
    assert found.model.time_origin == start
    np.testing.assert_allclose(found.model.effects[0].theta[0], 5e-8, rtol=0.2)
    assert found.check is not None and found.check.chi2_dof < 1.6
    later = data.take(np.arange(80) >= 20)
    assert identification.fit(later, found.model).model.time_origin == start


def test_a_fit_says_itself_in_a_line_and_in_a_summary(truth, measure):
    found = identification.fit(measure(truth, 40, rotations=False), truth.robot)
    assert len(repr(found)) < 120 and "complete converged" in repr(found)
    lines = found.summary().splitlines()
    assert lines[0] == found.headline() and len(lines) == 1 + len(found.warnings) > 1


@pytest.mark.parametrize("gross", ["rod", "zero"])
def test_one_gross_error_of_the_drawing_does_not_bias_the_others(delta, perturb, measure, gross):
    """A rod 20 mm longer than drawn, or a motor homed 2° off, beside errors as large as the tolerances."""
    mechanism, scores = delta.mechanism, []
    name, change, basis = {
        "rod": ("l31", 0.02, np.eye(60)[mechanism.index("l31")]),
        "zero": ("q2.zero", np.radians(2), mechanism.motor_zeros[:, 1]),
    }[gross]
    for seed in range(4):
        there = Model(delta, perturb(seed) + change * basis, "complete")
        q = 0.8 * planning.reachable(delta, 60, np.random.default_rng(seed)).q
        found = identification.fit(measure(there, q=q), delta)
        assert found.prior_scale < 1.5 and found.model.sigma is not None
        scores.append((found.model.k - there.k) / found.model.sigma)
        assert [(f.name, f.setting) for f in found.far] == [(name, gross == "zero")]
        assert found.far[0].change == pytest.approx(change, rel=0.05)
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2 and np.abs(scores).max() < 4.5
