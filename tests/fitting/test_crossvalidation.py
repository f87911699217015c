"""Cross-validation: no row helps to predict itself, replicates stay together, and rod errors are closure errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib import rotation
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.fitting import crossvalidation, identification
from pcalib.mechanics import kinematics
from pcalib.model import Frame, Model
from pcalib.workspace import reachable

MODELS = Path(__file__).parents[2] / "models"
ROBOT = robots.load(MODELS / "hexapod.toml")
MECHANISM = ROBOT.mechanism
SIGMA = (5e-5, 1e-4)


def measured(n=60, noise=1.0, seed=0, robot=ROBOT, **more):
    """A perturbed robot's poses with noise, and its parameters."""
    rng = np.random.default_rng(seed)
    mechanism = robot.mechanism
    size = np.array([{"m": 2e-4, "rad": 1e-3, "1": 1e-3}[unit] for unit in mechanism.units])
    k = mechanism.nominal + size * rng.standard_normal(len(mechanism.nominal))
    q = reachable(robot, n, rng).q
    pose = kinematics.forward(mechanism, k, q).pose
    x = pose.x + noise * SIGMA[0] * rng.standard_normal((n, 3))
    R = rotation.exp(noise * SIGMA[1] * rng.standard_normal((n, 3))) @ pose.R
    return Measurements.create(robot, q, x, R, sigma_pos=SIGMA[0], sigma_rot=SIGMA[1], **more), k


def test_held_out_errors_are_a_little_above_the_noise():
    data, _ = measured()
    found = crossvalidation.cross_validate(data, ROBOT, folds=6)
    fit = identification.fit(data, ROBOT)
    assert fit.accuracy.rms_pos < found.rms_pos < 1.3 * np.sqrt(3) * SIGMA[0]
    assert sorted(np.bincount(crossvalidation.require_folds(data, 6))) == [10] * 6
    assert found.json()["folds"] == 6 and found.json()["rms_pos_um"] == pytest.approx(found.rms_pos * 1e6)
    # The spread over folds is that of a jackknife: about σ·√(1/5) for each unknown that the data fix.
    sigma = np.sqrt(np.diag(fit.covariance))
    assert 0.2 < np.median(found.spread / sigma) < 0.8


def test_a_held_out_row_does_not_help_to_predict_itself():
    """Spoil one row: its own prediction stays as it was, and only other folds see the spoiled reading."""
    data, _ = measured()
    spoiled = data.position.copy()
    spoiled[7] += [0.0, 0.0, 3e-3]
    other = Measurements.create(ROBOT, data.q, spoiled, data.rotation, sigma_pos=SIGMA[0], sigma_rot=SIGMA[1])
    a, b = (crossvalidation.cross_validate(d, ROBOT, folds=5) for d in (data, other))
    fold = crossvalidation.require_folds(data, 5)
    assert fold[7] == 2
    assert b.error[7, :3] - a.error[7, :3] == pytest.approx([0, 0, 3e-3], abs=1e-12)
    same = (fold == fold[7]) & (np.arange(60) != 7)
    assert np.array_equal(a.error[same], b.error[same])
    assert not np.allclose(a.error[fold == 0], b.error[fold == 0], atol=1e-9)


def test_replicates_are_held_out_together_and_check_rows_stay_out():
    data, _ = measured(60, check=np.arange(60) < 6)
    twice = Measurements.create(
        ROBOT, np.repeat(data.q, 2, axis=0), np.repeat(data.position, 2, axis=0), np.repeat(data.rotation, 2, axis=0),
        check=np.repeat(data.check, 2), sigma_pos=SIGMA[0], sigma_rot=SIGMA[1],
    )  # fmt: skip
    fold = crossvalidation.require_folds(twice, 4)
    assert (fold[0::2] == fold[1::2]).all() and (fold[:12] == -1).all()
    found = crossvalidation.cross_validate(twice, ROBOT, folds=4)
    assert np.isnan(found.error[:12]).all() and np.isfinite(found.error[12:]).all()
    named = Measurements.create(
        ROBOT, data.q, data.position, data.rotation, pose_id=np.arange(60) // 3, sigma_pos=SIGMA[0], sigma_rot=SIGMA[1]
    )
    fold = crossvalidation.require_folds(named, 4)
    assert (fold.reshape(20, 3) == fold[::3, None]).all()


def test_a_pose_id_does_not_part_rows_of_one_command():
    """Ids on the first half only: twins stay together, and what an id joins stays joined."""
    data, _ = measured(12)
    both = data.take(np.r_[0:12, 0:12])
    half = replace(both, pose_id=np.r_[np.arange(12), np.full(12, -1)])
    fold = crossvalidation.require_folds(half, 5)
    assert (fold[:12] == np.arange(12) % 5).all() and (fold[:12] == fold[12:]).all()
    chain = replace(both, pose_id=np.r_[np.full(12, -1), np.arange(12) // 3])
    fold = crossvalidation.require_folds(chain, 4)
    assert (fold[:12] == np.arange(12) // 3).all() and (fold[:12] == fold[12:]).all()
    with pytest.raises(InputError, match="5 folds of 4 commands"):
        crossvalidation.require_folds(chain, 5)


@pytest.mark.parametrize("name", ["hexapod", "hexa", "delta"])
def test_rod_errors_are_closure_errors_at_the_measured_pose(name):
    """A lengthened rod shows as that rod's error; the frame of the instrument does not matter."""
    robot = robots.load(MODELS / f"{name}.toml")
    mechanism, tool = robot.mechanism, np.array([0.01, 0.02, -0.1])
    q = reachable(robot, 8, np.random.default_rng(1)).q
    k = mechanism.nominal.copy()
    k[mechanism.index(f"l{mechanism.rods[2]}")] += 5e-4
    pose = kinematics.forward(mechanism, k, q).pose
    frame = Frame(rotation.exp(np.array([0.1, -0.2, 0.3])), np.array([1.0, 2.0, 3.0]), np.array([1e-3, 0, 2e-3]))
    x = pose.tcp(tool + frame.offset) @ frame.rotation.T + frame.translation
    data = Measurements.create(robot, q, x, frame.rotation @ pose.R, tool=tool, frame="tracker")
    model = Model(robot, mechanism.nominal.copy(), "nominal", frame=frame)
    error, p = identification.residuals(model, data)
    wanted = np.zeros((8, len(mechanism.rods)))
    wanted[:, 2] = 5e-4
    assert np.abs(crossvalidation.rod_errors(model, error, p) - wanted).max() < 1e-12


def test_rod_errors_of_an_h4_leave_out_what_its_hinges_can_take_up():
    robot = robots.load(MODELS / "h4.toml")
    data, k = measured(10, noise=0.0, robot=robot)
    error, p = identification.residuals(Model(robot, k), data)
    assert np.abs(crossvalidation.rod_errors(Model(robot, k), error, p)).max() < 1e-11
    error, p = identification.residuals(Model.nominal(robot), data)
    assert 1e-5 < np.abs(crossvalidation.rod_errors(Model.nominal(robot), error, p)).max() < 5e-3


def test_rows_without_rotation_have_no_rod_errors_and_folds_have_limits():
    data, _ = measured(30)
    half = np.where(np.arange(30)[:, None, None] < 15, data.rotation, np.nan)
    mixed = Measurements.create(ROBOT, data.q, data.position, half, sigma_pos=SIGMA[0], sigma_rot=SIGMA[1])
    found = crossvalidation.cross_validate(mixed, ROBOT, "classical", folds=3)
    assert np.isnan(found.rod[15:]).all() and np.isfinite(found.rod[:15]).all()
    for folds in (1, 31):
        with pytest.raises(InputError, match="choose 2 to 30 folds"):
            crossvalidation.cross_validate(data, ROBOT, folds=folds)
