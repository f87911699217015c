"""The accuracy study: its robots, poses and landings are what they are said to be."""

from dataclasses import replace

import numpy as np
import pytest

from bench.batch import BatchMachine
from bench.jobs.accuracy import (
    CHOICES,
    DEGREE,
    INSIDE,
    Conditions,
    draw,
    land,
    measure,
    plan,
    random_poses,
    rings,
    shrunk,
    study,
)  # fmt: skip
from bench.jobs.demo import RUNGS
from pcalib.errors import InputError
from pcalib.mechanics import kinematics
from pcalib.model import Model

FEW = Conditions(robots=2, poses=30, spacing=0.2)


def test_errors_have_the_size_asked_for(delta):
    errors = np.array([draw(delta, Conditions(0.2e-3, 0.1 * DEGREE), np.random.default_rng(n)) for n in range(200)])
    errors = errors - delta.mechanism.nominal
    angles = np.array(delta.mechanism.units) == "rad"
    assert errors[:, ~angles].std() == pytest.approx(0.2e-3, rel=0.03)
    assert errors[:, angles].std() == pytest.approx(0.1 * DEGREE, rel=0.05)


@pytest.mark.parametrize("choice", CHOICES)
def test_poses_lie_where_they_should(delta, choice):
    conditions = replace(FEW, choice=choice, poses=200 if choice != "d-optimal" else 30)
    made = (
        plan(delta, conditions) if choice == "d-optimal" else random_poses(delta, conditions, np.random.default_rng(0))
    )
    q, tools = made
    x = kinematics.forward(delta.mechanism, delta.mechanism.nominal, q).pose.x
    assert (shrunk(delta.workspace, INSIDE) if choice == "interior" else delta.workspace).contains(x).all()
    assert (q >= delta.joint_min - 1e-9).all() and (q <= delta.joint_max + 1e-9).all()
    assert (len(np.unique(tools[:, 2])) > 1) == (choice == "d-optimal")
    if choice in ("workspace", "interior"):  # of the area, within half the radius; the reachable part is wider there
        assert np.mean(np.hypot(x[:, 0], x[:, 1]) < 0.2) == pytest.approx(0.25, abs=0.17)


def test_rings_fill_the_working_cylinder(delta):
    points = rings(delta.workspace)
    radius = np.hypot(points[:, 0], points[:, 1])
    assert len(np.unique(points.round(9), axis=0)) == len(points) == 365
    assert delta.workspace.contains(points).all()
    np.testing.assert_allclose(np.unique(radius.round(9)), 0.4 * np.arange(4) / 3, atol=1e-9)
    np.testing.assert_allclose(np.unique(points[:, 2]), np.linspace(-0.925, -0.675, 5))
    np.testing.assert_allclose(points[:, :2].mean(axis=0), 0, atol=1e-12)


def test_a_perfect_model_lands_on_target_and_noise_is_added(delta):
    machine = BatchMachine(delta)
    k = draw(delta, FEW, np.random.default_rng(3))
    machine.become(k)
    rng = np.random.default_rng(4)
    q, tools = random_poses(delta, FEW, rng)
    data = measure(machine, FEW, q, tools, rng)
    off = data.position - kinematics.forward(delta.mechanism, k, q).pose.x
    assert off.std() == pytest.approx(FEW.noise_pos, rel=0.25)
    true = Model.nominal(delta).with_geometry(k)
    assert (
        np.nanmax(land(machine, true, "exact", np.array([[0, 0, -0.8], [0.1, 0, -0.75]]), np.array([0, 0, -0.3])))
        < 1e-12
    )


def test_a_study_is_the_same_twice_and_tells_its_figures(delta):
    ticks = []
    rungs = [rung for rung in RUNGS if rung.name in ("nominal", "complete")]
    one, two = (study(delta, FEW, rungs, lambda: ticks.append(1)) for _ in range(2))
    assert np.array_equal(one.errors, two.errors, equal_nan=True) and len(ticks) == 4
    assert one.statuses == {"converged": 2} and one.lost == 0
    assert (one.rms["complete"] < 0.1 * one.rms["nominal"]).all()
    assert one.largest["nominal"][0] == one.errors[0, 0].max() == one.largest_of_each["nominal"][0].max()
    np.testing.assert_allclose(one.rms["nominal"] ** 2, (one.rms_of_each["nominal"] ** 2).mean(axis=1))
    assert "nominal" in one.table() and "h = 300 mm" in one.table()
    with pytest.raises(InputError, match="unknown choice of poses 'random'"):
        study(delta, replace(FEW, choice="random"))
    with pytest.raises(InputError, match="unknown set of targets 'ring'"):
        study(delta, replace(FEW, targets="ring"))
