"""Every kind round the whole loop: perturbed in MuJoCo, measured, identified, compensated, and landed in MuJoCo."""

from functools import lru_cache

import numpy as np
import pytest

from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import compensation, rotation
from pcalib import robot as robots
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.fitting.identifiability import priors
from pcalib.mechanics import kinematics
from pcalib.workspace import reachable

NAMES = sorted(path.stem for path in MODELS.glob("*.toml") if path.stem != "delta")
TOOL = np.array([0.02, -0.01, -0.15])
SIGMA_POS, SIGMA_ROT = 2e-5, np.radians(0.005)


@lru_cache
def load(name):
    return robots.load(MODELS / f"{name}.toml")


def perturbed(name, seed):
    mechanism = load(name).mechanism
    size = priors(mechanism.units)
    return mechanism.nominal + size * np.random.default_rng(seed).standard_normal(len(size))


def poses(name, n, seed):
    return reachable(load(name), n, np.random.default_rng(seed))


@pytest.mark.parametrize("name", NAMES)
def test_noise_free_data_give_the_robot_back(name):
    """Whatever any pose can show is recovered: predictions at new poses, with a tool never measured, to 1e-9 m."""
    robot, k, seen, new = load(name), perturbed(name, 1), poses(name, 120, 0), poses(name, 200, 5)
    machine = Machine(robot, k)
    landing, other = machine.land(seen.q), machine.land(new.q, TOOL)
    data = Measurements.create(robot, seen.q, landing.x, landing.R, sigma_pos=1e-8, sigma_rot=1e-8)
    found = identification.fit(data, robot, prior_scale=1.0).model
    there = kinematics.forward(robot.mechanism, found.k, new.q).pose
    before = kinematics.forward(robot.mechanism, robot.mechanism.nominal, new.q).pose
    assert np.abs(before.tcp(TOOL) - other.tcp).max() > 1e-4
    assert np.abs(there.tcp(TOOL) - other.tcp).max() <= 1e-9
    assert np.abs(rotation.log(there.R @ np.swapaxes(other.R, 1, 2))).max() <= 2e-9
    if robot.kind in ("hexa", "hexa321", "hexapod"):  # rods and plate points are free of any gauge there
        free = [i for i, p in enumerate(robot.mechanism.parameters) if p[0] in "ls" or (p[0] == "b" and p[1] != "e")]
        assert np.abs(found.k - k)[free].max() <= 1e-9


def commanded(name):
    """Which of x y z a command prescribes."""
    return [c for c in load(name).mechanism.task if c < 3]


def floor(name, k, q, targets):
    """[m] RMS TCP error at targets that noise alone leaves: covariance of the measured poses, priors included."""
    mechanism = load(name).mechanism

    def sensitivity(q, tool):
        pose = kinematics.forward(mechanism, k, q).pose
        S, dofs = np.zeros((len(q), 6, len(k))), list(mechanism.plate_dofs)
        S[:, dofs] = kinematics.sensitivity(mechanism, k, q, pose, tool)[:, : len(dofs)]
        return S * priors(mechanism.units)

    J = sensitivity(q, np.zeros(3)) / np.array([SIGMA_POS] * 3 + [SIGMA_ROT] * 3)[:, None]
    J = J.reshape(-1, J.shape[-1])
    covariance = np.linalg.inv(J.T @ J + np.eye(J.shape[-1]))
    S = sensitivity(targets, TOOL)[:, commanded(name)]
    return np.sqrt(np.einsum("nij,jk,nik->n", S, covariance, S).mean())


@pytest.mark.parametrize("name", NAMES)
def test_compensated_robots_land_at_the_floor_set_by_noise(name):
    robot = load(name)
    wanted = poses(name, 120, 9).pose
    ratios, gains = [], []
    for seed in range(3):
        k, q, rng = perturbed(name, 10 + seed), poses(name, 60, seed).q, np.random.default_rng(seed)
        machine = Machine(robot, k)
        landing = machine.land(q)
        R = rotation.exp(SIGMA_ROT * rng.standard_normal((60, 3))) @ landing.R
        data = Measurements.create(
            robot, q, landing.x + SIGMA_POS * rng.standard_normal((60, 3)), R, sigma_pos=SIGMA_POS, sigma_rot=SIGMA_ROT
        )
        model = identification.fit(data, robot).model
        goal = wanted.tcp(TOOL)
        commands = compensation.compensate(model, goal, TOOL, rotation_matrix=wanted.R, limits=False)
        landed = Machine(robot, k).land(commands.q, TOOL)
        error = (landed.tcp - goal)[landed.ok][:, commanded(name)]
        assert landed.ok.mean() > 0.95
        left = np.sqrt((error**2).sum(axis=1).mean())
        ratios.append(left / floor(name, k, q, commands.q[landed.ok]))
        plain = kinematics.inverse(robot.mechanism, robot.mechanism.nominal, goal, wanted.R, TOOL).q
        missed = machine.land(plain, TOOL)
        off = (missed.tcp - goal)[missed.ok][:, commanded(name)]
        gains.append(np.sqrt((off**2).sum(axis=1).mean()) / left)
    print(f"{name}: TCP error over its floor {np.round(ratios, 2)}, gain over no compensation {np.round(gains, 1)}")
    assert max(ratios) <= 1.5
    assert min(gains) > 5
