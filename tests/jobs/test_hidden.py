"""Hidden faults have the visible size that is stated, judged by non-linear refits of what MuJoCo measures."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from bench import random_laws
from bench.jobs.hidden import case as cases
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.catalogue import CATALOGUE
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.stage import MOVED, RANGE, Replay, Stage, suits
from pcalib import effects
from pcalib import robot as robots
from pcalib.diagnosis.problem import problem
from pcalib.fitting import identification
from pcalib.fitting import noise_level as noises

ROOT = Path(__file__).resolve().parents[2]
ROBOT = robots.load(ROOT / "models" / "delta.toml")

SEEN_IN_PLAIN = (
    "drive_compliance", "rod_compliance", "arm_bending", "encoder_eccentricity", "encoder_ovality", "gear_ripple",
    "joint_clearance",
)  # fmt: skip


@lru_cache
def stage(design="rich", companion=False):
    return Stage.draw(DESIGNS[design], ROBOT, 7, companion)


def fault(name, uneven=False, seed=3):
    return CATALOGUE[name].draw(ROBOT, np.random.default_rng(seed), uneven)


def test_every_effect_of_the_library_is_hidden_by_some_fault(own_tests):
    hidden = {CATALOGUE[name].effect for name in catalogue.LISTED}
    assert hidden <= set(effects.names()) <= hidden | own_tests


@pytest.mark.parametrize("name", CATALOGUE)
def test_scaling_a_fault_scales_its_sizes_and_nothing_else(name):
    one = fault(name, uneven=True)
    two = catalogue.scaled(one, 2.0)
    assert not one.absent and catalogue.scaled(one, 0.0).absent
    for key, value in one.values.items():
        if key in catalogue.sizes(one):
            assert two.values[key] == pytest.approx(2.0 * np.asarray(value), rel=1e-12)
        else:
            assert np.array_equal(two.values[key], value)
    low, high = {s.name: (s.low, s.high) for s in one.SETTINGS}[catalogue.sizes(one)[0]]
    most = catalogue.scaled(one, catalogue.largest(one)).values
    assert any(
        np.isclose(np.max(most[key]), high) or np.isclose(np.min(most[key]), low) for key in catalogue.sizes(one)
    )


def test_uneven_faults_differ_from_arm_to_arm():
    assert len(set(fault("drive_compliance").values["compliance"])) == 1
    uneven = fault("drive_compliance", uneven=True).values["compliance"]
    assert len(set(uneven)) == 3 and (uneven > 0).all()


@pytest.mark.parametrize(
    ("design", "name"),
    [
        ("rich", "drive_compliance"),
        ("rich", "thermal_rods"),
        ("plain", "encoder_ovality"),
        ("rich-position", "backlash"),
    ],
)
def test_the_visible_size_is_what_a_refit_of_noise_free_data_leaves(design, name):
    """s² is the χ² that stays when only the geometry is refitted to noise-free readings of the faulty robot."""
    there = stage(design)
    case = cases.single(there, CATALOGUE[name], fault(name), 8.0)
    assert case.facts.size == pytest.approx(8.0, rel=0.04)
    exact = there._exact(case.hidden, case.landing)[0]
    kept = exact.take(~exact.check)
    fit = identification.fit(kept, ROBOT, "complete", prior_scale=1e3)
    left = np.sqrt(np.nansum((fit.error / kept.sigma) ** 2))
    assert left == pytest.approx(case.facts.size, rel=0.03)


def test_nothing_hidden_leaves_nothing():
    assert np.linalg.norm(stage().signal([])) < 1e-6
    assert cases.nothing(stage()).facts.kind == "none"


@pytest.mark.parametrize("name", ["rod_compliance", "joint_clearance", "encoder_eccentricity", "base_drift"])
def test_the_library_comes_close_to_what_it_lists_and_only_to_that(name):
    there = stage()
    signal = there.signal([there.scaled(fault(name, uneven=True), 10.0).fault])
    size = np.linalg.norm(signal)
    far, nearest = there.nearest(signal)
    assert far < 0.01 * size and nearest == (CATALOGUE[name].effect,)
    assert there.nearest(signal, without=CATALOGUE[name].effect)[0] > 3 * far


@pytest.mark.parametrize(
    ("design", "name"),
    # A gear ratio of that size would move the plate by more than is hidden.
    [("rich-position", name) for name in catalogue.LISTED if name != "gear_ratio"]
    + [("plain", name) for name in SEEN_IN_PLAIN],
)
def test_a_diagnosis_finds_nothing_beside_the_truth_where_there_is_no_noise(design, name):
    """All that MuJoCo shows of a large fault lies in what the diagnosis takes for its effect, to 1 % of its size.

    Where it did not, the rest would speak against the true cause however good the data.
    """
    there = stage(design, CATALOGUE[name].companion)
    case = cases.single(there, CATALOGUE[name], fault(name), 12.0)
    exact = replace(there._exact(case.hidden, case.landing)[0], stated=(True, True))
    model = identification.fit(exact, ROBOT, "complete", effects=there.effects).model
    kept = exact.take(~exact.check)
    made = problem(model, exact, noise=noises.as_stated(kept))
    screen = made.screen(n_draws=2)
    left = [
        np.linalg.norm(screen.y - screen.joint([g]) @ (screen.joint([g]).T @ screen.y))
        for g, c in enumerate(made.candidates)
        if c.name == case.facts.effects[0] and screen.visible[g]
    ]
    assert case.facts.size == pytest.approx(12.0, rel=0.04) and np.linalg.norm(screen.y) > 6.0
    assert min(left) < 0.01 * case.facts.size
    if screen.left is not None:
        assert np.sqrt(screen.left[0]) < 0.01 * case.facts.size


def test_what_no_library_lists_is_made_as_far_as_asked():
    case = cases.outside(stage(), CATALOGUE["encoder_warming"], fault("encoder_warming"), 8.0)
    assert case.facts.distance == pytest.approx(8.0, rel=0.04)
    assert case.facts.distance <= case.facts.size
    assert case.facts.kind == "outside" and case.facts.effects == ()


def test_a_pair_is_more_than_any_single_effect():
    both = [CATALOGUE["thermal_base"], CATALOGUE["backlash"]]
    case = cases.pair(stage(), both, [fault("thermal_base"), fault("backlash")], 8.0)
    assert case is not None and case.facts.kind == "pair"
    assert case.facts.effects == ("backlash", "thermal_base")
    assert case.facts.distance >= 0.95 * 8.0 and min(case.sizes) >= 0.95 * 8.0


def test_a_pair_that_one_effect_explains_is_refused():
    both = [CATALOGUE["base_drift"], CATALOGUE["tracker_drift"]]
    assert cases.pair(stage(), both, [fault("base_drift"), fault("tracker_drift")], 8.0) is None


def test_what_cannot_be_seen_stays_small_and_says_so():
    there = stage("plain")
    found = there.scaled(fault("drive_compliance"), 1e4, "drive_compliance")
    assert found.capped and found.size < 1e4
    moved = np.sqrt(np.mean(np.sum(there.change([found.fault])[:, :3] ** 2, axis=1)))
    high = effects.get("drive_compliance", None, ROBOT).parameters[0].high
    assert moved == pytest.approx(MOVED, rel=0.1) or found.fault.values["compliance"].max() <= 1.01 * RANGE * high
    assert there.scaled(fault("tracker_scale"), 6.0, "tracker_scale").capped


def test_a_design_that_records_no_temperature_hides_no_thermal_fault():
    assert suits(CATALOGUE["thermal_arms"], DESIGNS["rich"], ROBOT)
    assert not suits(CATALOGUE["thermal_arms"], DESIGNS["plain"], ROBOT)
    for name, hidden in CATALOGUE.items():
        if suits(hidden, DESIGNS["plain"], ROBOT):
            assert stage("plain", hidden.companion).land([fault(name)]).ok.all(), name


def test_the_stated_noise_is_that_of_the_design():
    plain, over = (
        replace(stage(), design=DESIGNS[name]).measure((), stage().reference, 5) for name in ("rich", "rich-overstated")
    )
    assert np.array_equal(plain.position, over.position)
    assert over.sigma[0, 0] == pytest.approx(1.8 * plain.sigma[0, 0])
    there = Replay(stage().reference).run(stage().plan.commands)
    scatter = (plain.position - there.tcp).std()
    assert scatter == pytest.approx(15e-6, rel=0.1)


def test_rows_held_out_among_the_others():
    there = Stage.draw(replace(DESIGNS["rich"], check=120, interleaved=True), ROBOT, 7)
    held = there.plan.check
    assert held.sum() == pytest.approx(120, abs=4)
    time = there.plan.commands.columns["time"]
    assert time[held].mean() == pytest.approx(time.mean(), rel=0.15)
    q = there.plan.commands.q
    same = (q[1:] == q[:-1]).all(axis=1)
    assert same.sum() > 20 and (held[1:] == held[:-1])[same].all()  # replicates stay together


def test_replicates_apart():
    there = Stage.draw(replace(DESIGNS["rich"], apart=True), ROBOT, 7)
    plan, plain = there.plan, stage().plan
    time, held = plan.commands.columns["time"], plan.check
    assert (np.diff(time) > 0).all() and (np.diff(held.astype(int)) >= 0).all() and held.sum() == plain.check.sum()
    gaps = [np.ptp(np.flatnonzero(plan.pose_id == i)) for i in np.unique(plan.pose_id[plan.pose_id >= 0])]
    assert len(gaps) > 15 and np.median(gaps) > 10
    for i in np.unique(plan.pose_id[plan.pose_id >= 0]):
        rows = plan.pose_id == i
        assert np.ptp(plan.commands.q[rows], axis=0).max() == 0 == np.ptp(plan.commands.columns["temp_rods"][rows])
    assert sorted(map(tuple, plan.commands.q)) == sorted(map(tuple, plain.commands.q))


def test_a_plain_law_has_one_factor_of_few_shapes():
    for seed in range(60):
        [law] = random_laws.draw({"actuator": 3, "rod": 6, "axis": 3}, seed, plain=True)
        [term] = law.terms
        assert term.shape in random_laws.PLAIN[term.variable].split()
