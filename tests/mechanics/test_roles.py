"""What parameters are for: motor zeros, rigid motions and parts do to the loops what they say, whatever their names."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib import rotation
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.workspace import reachable

MODELS = sorted((Path(__file__).parents[2] / "models").glob("*.toml"))


@pytest.fixture(params=MODELS, ids=[m.stem for m in MODELS])
def robot(request):
    return robots.load(request.param)


@pytest.fixture
def stand(robot):
    found = reachable(robot, 6, np.random.default_rng(0))
    return found.q, found.pose


def slope(function, h=1e-6):
    """Central difference at 0."""
    return (function(h) - function(-h)) / (2 * h)


def test_zero_of_a_motor_acts_as_an_offset_of_its_command(robot, stand):
    mechanism, (q, pose) = robot.mechanism, stand
    k, nq = mechanism.nominal, len(mechanism.actuators)
    for i in range(nq):
        through_k = slope(lambda h, i=i: kinematics.closure(mechanism, k + h * mechanism.motor_zeros[:, i], q, pose).f)
        through_q = slope(lambda h, i=i: kinematics.closure(mechanism, k, q + h * np.eye(nq)[i], pose).f)
        np.testing.assert_allclose(through_k, through_q, atol=2e-9)


def test_rigid_motions_leave_the_loops_closed(robot, stand):
    """A base that moves takes the plate with it; a plate whose joints move on it stands the other way round."""
    mechanism, (q, pose) = robot.mechanism, stand
    k, G = mechanism.nominal, mechanism.rigid_motions
    assert G.any(axis=0).all() or len(mechanism.plate_dofs) < 6
    for j in np.flatnonzero(G.any(axis=0)):
        axis = np.eye(3)[j % 3]

        def left(h, j=j, axis=axis):
            turn = rotation.exp(h * axis) if j % 6 > 2 else np.eye(3)
            move = np.zeros(3) if j % 6 > 2 else h * axis
            if j < 6:
                there = Pose(pose.x @ turn.T + move, turn @ pose.R, pose.phi)
            else:
                there = Pose(pose.x - pose.R @ turn.T @ move, pose.R @ turn.T, pose.phi)
            return kinematics.closure(mechanism, k + h * G[:, j], q, there).f

        assert np.abs(slope(left)).max() < 2e-9


def test_every_parameter_belongs_to_a_part_and_no_two_parts_are_the_same(robot):
    parts = robot.mechanism.parts
    assert len({p.name for p in parts}) == len({p.basis.tobytes() for p in parts}) == len(parts)
    assert all(np.linalg.matrix_rank(p.basis) == p.basis.shape[1] > 0 for p in parts)
    assert np.any(np.hstack([p.basis for p in parts]), axis=1).all()
    assert all(p.words and "_" not in p.words for p in parts)


def test_roles_do_not_read_names(robot):
    """A kind may name its parameters as it likes."""
    mechanism = robot.mechanism
    other = replace(mechanism, parameters=tuple(f"x{i}" for i in range(len(mechanism.nominal))))
    np.testing.assert_array_equal(other.rigid_motions, mechanism.rigid_motions)
    np.testing.assert_array_equal(other.motor_zeros, mechanism.motor_zeros)
    assert list(other.rod_lengths) == list(mechanism.rod_lengths)
    named = [p.name for p in mechanism.parts if p.name not in mechanism.parameters]
    assert set(named) <= {p.name for p in other.parts}


def test_parts_of_the_usual_robots():
    def names(kind):
        return {p.name: p.words for p in robots.load(next(m for m in MODELS if m.stem == kind)).mechanism.parts}

    delta = names("delta")
    assert {"q1.zero", "motor1", "arm1", "a11", "b11", "l11", "pair1", "plate"} <= set(delta)
    assert delta["b21"] == "the ball joint of rod 21 on the plate" and delta["l21"] == "rod 21"
    assert {"leg1.zero", "leg1.scale", "a1", "b1", "plate"} <= set(names("hexapod"))
    assert {"hinge1", "hinge2"} <= set(names("h4")) and "q1.scale" in names("linear_delta")
