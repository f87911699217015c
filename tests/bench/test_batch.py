"""Poses closed many at once, against the machine that closes them one by one with rod bodies."""

import mujoco
import numpy as np
import pytest

from bench.batch import BatchMachine, possible
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import robot as robots
from pcalib.errors import ReachError

RNG = np.random.default_rng(3)


@pytest.fixture(scope="module")
def many(delta):
    return BatchMachine(delta, chunk=64)


def commands(delta, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(np.radians(-40), np.radians(30), (n, len(delta.mechanism.actuators)))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_same_poses_as_with_rod_bodies(delta, perturb, many, seed):
    k = perturb(seed, mm=0.5, deg=0.2)
    many.become(k)
    q = commands(delta, 150, seed)
    tools = np.tile([[0.0, 0.0, 0.0], [0.01, -0.02, -0.3], [0.0, 0.0, -0.1]], (50, 1))
    fast, slow = many.land(q, tools), Machine(delta, k).land(q, tools)
    assert (fast.status == slow.status).all() and fast.ok.sum() > 120
    ok = fast.ok
    assert np.abs(fast.tcp[ok] - slow.tcp[ok]).max() <= 1e-11
    assert np.abs(fast.R[ok] - slow.R[ok]).max() <= 1e-11
    assert np.isnan(fast.x[~ok]).all() and np.isnan(fast.tcp[~ok]).all()


def test_loops_are_closed_by_mujocos_own_residual(delta, perturb, many):
    many.become(perturb(4))
    found = many.land(commands(delta, 40))
    data = mujoco.MjData(many.model)
    plate = many.model.joint("plate").qposadr[0]
    for q, x, R in zip(commands(delta, 40)[found.ok], found.x[found.ok], found.R[found.ok], strict=True):
        for i, name in enumerate(delta.mechanism.actuators):
            data.qpos[many.model.joint(name).qposadr[0]] = q[i]
        data.qpos[plate : plate + 3] = x
        mujoco.mju_mat2Quat(data.qpos[plate + 3 : plate + 7], R.ravel())
        mujoco.mj_fwdKinematics(many.model, data)
        mujoco.mj_makeConstraint(many.model, data)
        assert data.nefc == 6 and np.abs(data.efc_pos).max() <= 2e-12  # 1e-12, and what quaternions lose in R


def test_the_start_does_not_matter(delta, perturb, many):
    many.become(perturb(5))
    q = commands(delta, 30)
    home = many.land(q)
    R = home.R.copy()
    R[~home.ok] = np.eye(3)
    near = many.land(q, near=(np.nan_to_num(home.x, nan=-0.8), R))
    far = many.land(q, near=(RNG.uniform(-1, 1, (30, 3)), np.tile(np.diag([1.0, -1.0, -1.0]), (30, 1, 1))))
    for other in (near, far):  # far starts end above the elbows, or nowhere, and are walked to
        assert (other.status == home.status).all()
        assert np.nanmax(np.abs(other.tcp - home.tcp)) <= 1e-11


def test_what_cannot_be_reached_has_a_status(delta, many):
    many.become(delta.mechanism.nominal)
    q = np.radians([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [-60.0, 45.0, 45.0]])
    found = many.land(q)
    assert list(found.status[:3]) == ["ok", "joint_limit", "not_converged"]
    assert found.status[3] == Machine(delta).land(q[3:]).status[0]


def test_drives_that_miss(delta, perturb, many):
    from bench.commands import Commands

    many.become(perturb(6))
    q = commands(delta, 5)
    miss = np.full(q.shape, 1e-4)
    assert np.array_equal(many.run(Commands.of(q), miss).tcp, many.run(Commands.of(q + miss)).tcp)


def test_a_robot_that_cannot_be_built(delta, many):
    k = delta.mechanism.nominal.copy()
    k[[name.startswith("l") for name in delta.mechanism.parameters]] = 0.2
    with pytest.raises(ReachError, match="cannot be assembled"):
        many.become(k)


def test_which_robots_it_is_for(delta):
    assert possible(delta)
    assert not possible(robots.load(MODELS / "hexa.toml"))
