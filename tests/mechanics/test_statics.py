"""Statics against virtual work along constrained motion, which never uses J_X."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib import rotation
from pcalib.mechanics import kinematics, statics
from pcalib.mechanics.kinematics import Deviation

MODELS = sorted((Path(__file__).parents[2] / "models").glob("*.toml"))


@pytest.fixture(scope="module")
def delta():
    return robots.load(MODELS[0].parent / "delta.toml")


def some_poses(robot, n, seed=0):
    """Actuator values about mid-range with closed loops, on a slightly imperfect robot."""
    rng = np.random.default_rng(seed)
    mechanism = robot.mechanism
    lo, hi = robot.joint_range
    k = mechanism.nominal + 1e-3 * rng.standard_normal(len(mechanism.nominal))
    q = 0.5 * (lo + hi) + 0.15 * (hi - lo) * rng.uniform(-1, 1, (4 * n, len(mechanism.actuators)))
    found = kinematics.forward(mechanism, k, q)
    J = kinematics.jacobian_state(mechanism, kinematics.closure(mechanism, k, q, found.pose), found.pose)
    # Away from singular poses, where finite differences of the energy are poor.
    solved = np.flatnonzero(found.ok)
    good = solved[np.argsort(np.linalg.cond(J[solved]))[:n]]
    assert len(good) >= 2
    return k, q[good], found.pose.take(good)


def anchors_on_plate(mechanism, k, pose):
    b = np.broadcast_to(mechanism.plate_points(k), (len(pose), len(mechanism.rods), 3)).copy()
    for h, columns in enumerate(mechanism.hinges):
        hinge, rods = columns.at(k), mechanism.body == h + 1
        R = rotation.exp(pose.phi[:, h, None] * hinge.axis)
        b[:, rods] = hinge.point + (b[:, rods] - hinge.point) @ np.swapaxes(R, -1, -2)
    return pose.x[:, None] + b @ np.swapaxes(pose.R, -1, -2)


def potential(robot, k, q, pose, tool, payload, gravity):
    """Potential energy of plate, payload and half rods (not of the arms), (N,) [J]."""
    m = robot.mass
    A = robot.mechanism.actuation.base(k, q).A
    B = anchors_on_plate(robot.mechanism, k, pose)
    height = m.get("plate", 0) * pose.x @ gravity + payload * (pose.tcp(tool) @ gravity)
    bodies = np.array([name != "drive" for name in robot.mechanism.rods])  # the planar drive's row is no rod
    height += 0.5 * m.get("rod", 0) * (A @ gravity + B @ gravity)[:, bodies].sum(axis=1)
    return -height


def loads(robot, k, q, pose, tool=0.0, payload=0.0, at=None):
    return statics.loads(robot.mechanism, k, q, pose, robot.mass, robot.gravity, tool, payload, at)


@pytest.mark.parametrize("path", MODELS, ids=lambda p: p.stem)
@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (2.0, -1.5, -9.0)])
def test_virtual_work(path, gravity):
    robot = replace(robots.load(path), gravity=np.array(gravity))
    mechanism = robot.mechanism
    k, q, pose = some_poses(robot, 5)
    n = len(q)
    tool, payload = np.array([0.02, -0.03, -0.25]), np.linspace(0, 2, n)
    got = loads(robot, k, q, pose, tool, payload)
    own = mechanism.actuation.weight_moment(k, q, robot.mass, robot.gravity)

    def energy(q, deviation=kinematics.RIGID):
        moved = kinematics.forward(mechanism, k, q, pose, deviation, tolerance=1e-14)
        return potential(robot, k, q, moved.pose, tool, payload, robot.gravity)

    h = 2e-6
    for i in range(len(mechanism.actuators)):
        step = h * np.eye(len(mechanism.actuators))[i]
        slope = (energy(q + step) - energy(q - step)) / (2 * h)
        np.testing.assert_allclose(got.torque[:, i] - own[:, i], -slope, atol=1e-6)
    for r, name in enumerate(mechanism.rods):
        if name == "drive":
            assert not got.tension[:, r].any()
            continue
        step = np.broadcast_to(h * np.eye(len(mechanism.rods))[r], (n, len(mechanism.rods)))
        slope = (energy(q, Deviation(rod=step)) - energy(q, Deviation(rod=-step))) / (2 * h)
        np.testing.assert_allclose(got.tension[:, r], -slope, atol=1e-6)


def test_arm_weight_is_minus_slope_of_its_energy(delta):
    k, q, pose = some_poses(delta, 3)
    actuation = delta.mechanism.actuation
    bare = replace(delta, mass=dict(delta.mass) | {"arm": 0.0})
    alone = loads(delta, k, q, pose).torque - loads(bare, k, q, pose).torque

    def height(q):
        # the centre of mass lies on the arm's own y axis
        E = rotation.exp(k[actuation.beta]) @ rotation.about(np.array([0.0, 0, 1]), actuation.azimuth)
        return 0.175 * np.einsum("ij,nij->ni", E[:, 2, :], np.stack([0 * q, np.cos(q), np.sin(q)], axis=-1))

    h = 1e-6
    np.testing.assert_allclose(alone, -9.81 * (height(q + h) - height(q - h)) / (2 * h), atol=1e-7)
    assert (alone[np.abs(q) < 1.0] < 0).all()  # a horizontal arm's weight pulls it down, towards −q


def test_centred_plate_by_hand(delta):
    """Symmetry: six equal tensions hold the hanging weight, Σ T n_z = weight below the elbows."""
    q = np.full((1, 3), 0.1)
    k = delta.mechanism.nominal
    pose = kinematics.forward(delta.mechanism, k, q).pose
    got = loads(delta, k, q, pose, payload=1.0)
    np.testing.assert_allclose(got.tension, got.tension[0, 0], rtol=1e-9)
    n = kinematics.closure(delta.mechanism, k, q, pose).n
    np.testing.assert_allclose(-got.tension[0] @ n[0, :, 2], 9.81 * (0.5 + 1.0 + 6 * 0.05), rtol=1e-12)
    assert (got.torque < 0).all()


def test_off_centre_compression_of_the_default_delta(delta):
    """With 1 kg some rods are pushed: several newtons far out, −8.3 N at the upper rim, none at the centre."""
    grid = np.linspace(-0.4, 0.4, 17)
    x = np.array([(a, b, c) for a in grid for b in grid for c in np.linspace(-0.925, -0.675, 6)])
    x = x[delta.workspace.contains(x)]
    k = delta.mechanism.nominal
    solved = kinematics.inverse(delta.mechanism, k, x)
    lo, hi = delta.joint_range
    good = solved.ok & ((solved.q >= lo) & (solved.q <= hi)).all(axis=1)
    least = loads(delta, k, solved.q[good], solved.pose.take(good), payload=1.0).tension.min(axis=1)
    far = np.hypot(x[good, 0], x[good, 1])
    assert -8.4 < least.min() < -8.1
    np.testing.assert_allclose(x[good][least.argmin(), 2], -0.675)
    assert -6.7 < least[x[good, 2] < -0.75].min() < -5.5
    assert (least[far < 0.06] > 0).all()


def test_given_closure_saves_work_and_changes_nothing(delta):
    k, q, pose = some_poses(delta, 4)
    at = kinematics.closure(delta.mechanism, k, q, pose)
    a, b = loads(delta, k, q, pose, 0.0, 0.5), loads(delta, k, q, pose, 0.0, 0.5, at)
    np.testing.assert_array_equal(a.torque, b.torque)


def test_singular_pose_is_nan_and_leaves_the_others_alone(delta):
    k = delta.mechanism.nominal
    q = np.array([[0.1, 0.2, 0.3], [0, 0, 0], [-0.3, 0.1, 0.0]])
    pose = kinematics.forward(delta.mechanism, k, q).pose
    pose.x[1], pose.R[1] = 0.0, np.eye(3)  # arms, rods and plate in one plane: nothing bears weight
    got = loads(delta, k, q, pose)
    assert np.isnan(got.tension[1]).all() and np.isnan(got.torque[1]).all()
    alone = loads(delta, k, q[[0, 2]], pose.take(np.array([0, 2])))
    np.testing.assert_allclose(got.tension[[0, 2]], alone.tension, rtol=1e-12)
    np.testing.assert_allclose(got.torque[[0, 2]], alone.torque, rtol=1e-12)
