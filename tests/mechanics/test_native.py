"""The extension in C against NumPy: the same poses and commands, and the same status of every one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcalib import compensation, prediction, rotation
from pcalib import robot as robots
from pcalib.mechanics import extension, kinematics, native
from pcalib.mechanics.loops import Deviation
from pcalib.model import Conditions, Model
from pcalib.workspace import reachable

FILES = sorted((Path(__file__).parents[2] / "models").glob("*.toml"))
N = 2000
AGREE = 1e-13
"""[m or rad] asked for over the workspace."""
ALL = ("actuator", "rod", "elbow", "plate")
built = pytest.mark.skipif(extension.library() is None, reason=f"no extension: {extension.about()}")


@pytest.fixture(params=FILES, ids=lambda f: f.stem)
def case(request):
    """A robot with errors in all of its geometry, and commands in and far beyond its joint range."""
    robot = robots.load(request.param)
    mechanism, rng = robot.mechanism, np.random.default_rng(1)
    k = mechanism.nominal + np.where(np.array(mechanism.units) == "m", 2e-4, 1e-3) * rng.standard_normal(
        len(mechanism.nominal)
    )
    middle, half = 0.5 * (robot.joint_max + robot.joint_min), 0.5 * (robot.joint_max - robot.joint_min)
    q = middle + half * rng.uniform(-1.5, 1.5, (N, len(mechanism.actuators)))
    return robot, k, q, rng


def compare(mine: kinematics.Solution, known: kinematics.Solution) -> None:
    np.testing.assert_array_equal(mine.status, known.status)
    ok = known.ok
    assert ok.any()
    for a, b in ((mine.q, known.q), *((getattr(mine.pose, p), getattr(known.pose, p)) for p in ("x", "R", "phi"))):
        apart = np.abs(a[ok] - b[ok]).reshape(ok.sum(), -1).max(axis=1, initial=0.0)
        # near a singular pose the loops close to rounding over a stretch, of which either end is right
        assert np.quantile(apart, 0.99) <= AGREE and apart.max() <= 1e-10


@built
def test_the_extension_knows_every_kind(case, own_tests):
    """A kind with a test of its own may be of a shape that native/ does not have, and is then left to NumPy."""
    mechanism = case[0].mechanism
    assert native.knows(mechanism) or mechanism.kind in own_tests - {"planar"}


@built
def test_forward_says_what_numpy_says(case):
    robot, k, q, _ = case
    compare(kinematics.forward(robot.mechanism, k, q), kinematics._forward(robot.mechanism, k, q))
    if native.knows(robot.mechanism):
        found = native.forward(robot.mechanism, k, q, None)
        assert found is not None and found.solved.any()


@built
def test_inverse_says_what_numpy_says(case):
    robot, k, _, rng = case
    mechanism, w = robot.mechanism, robot.workspace
    height = w.z_max - w.z_min
    x = np.column_stack([
        *rng.uniform(-1.5 * w.radius, 1.5 * w.radius, (2, N)), rng.uniform(w.z_min - height, w.z_max + height, N)
    ])  # fmt: skip
    commanded = [a for a in (3, 4, 5) if a in mechanism.task]
    turn = np.zeros((N, 3))
    turn[:, [a - 3 for a in commanded]] = 0.3 * rng.standard_normal((N, len(commanded)))
    R = rotation.exp(turn) if commanded else None
    tools = 0.1 * mechanism.tool_direction + 0.02 * rng.standard_normal((N, 3))
    for tool in (tools, tools[0]):
        known = kinematics._inverse(mechanism, k, x, R, tool)
        compare(kinematics.inverse(mechanism, k, x, R, tool), known)
    if mechanism.kind != "planar" and native.knows(mechanism):
        found = native.inverse(mechanism, k, x, R, tools)
        assert found is not None and found.solved.any()


@built
def test_a_start_is_kept_to(case):
    robot, k, q, _ = case
    near = kinematics._forward(robot.mechanism, robot.mechanism.nominal, q)
    q, start = q[near.ok], near.pose.take(near.ok)
    compare(kinematics.forward(robot.mechanism, k, q, start), kinematics._forward(robot.mechanism, k, q, start))


@built
@pytest.mark.parametrize("which", [("actuator",), ("rod",), ("elbow",), ("plate",), ALL], ids="+".join)
def test_deviations_are_those_of_numpy(case, which):
    """What effects move: as large as soft drives and warm rods make it."""
    robot, k, _, rng = case
    mechanism, within = robot.mechanism, reachable(robot, 400, rng)
    q, start = within.q, kinematics._forward(mechanism, k, within.q, within.pose).pose
    n, m = len(q), len(mechanism.rods)
    shapes = {"actuator": (n, q.shape[1]), "rod": (n, m), "elbow": (n, m, 3), "plate": (n, m, 3)}
    deviation = Deviation(**{name: 2e-4 * rng.standard_normal(shapes[name]) for name in which})
    known = kinematics._forward(mechanism, k, q, start, deviation)
    compare(kinematics.forward(mechanism, k, q, start, deviation), known)
    assert np.abs(known.pose.x - start.x).max() > 1e-5
    compare(kinematics.forward(mechanism, k, q, None, deviation), kinematics._forward(mechanism, k, q, None, deviation))

    tool = 0.1 * mechanism.tool_direction
    before = kinematics._inverse(mechanism, k, start.tcp(tool), start.R, tool)
    goal, R = start.tcp(tool)[before.ok], start.R[before.ok]
    before, deviation = before.take(before.ok), deviation.take(before.ok)
    known = kinematics._inverse(mechanism, k, goal, R, tool, before, deviation)
    compare(kinematics.inverse(mechanism, k, goal, R, tool, before, deviation), known)


@built
def test_derivatives_by_parameters_are_those_of_numpy(case):
    robot, k, _, rng = case
    mechanism, model = robot.mechanism, Model.nominal(robot).with_geometry(k)
    q = reachable(robot, 101, rng).q
    tools = 0.1 * mechanism.tool_direction + 0.02 * rng.standard_normal((len(q), 3))
    p = prediction.predict(model, q, Conditions.of(len(q), tools))
    found = native.motion(mechanism, k, q, p.pose, p.tool)
    assert (found is None) == (mechanism.kind in ("planar", "h4") or not native.knows(mechanism))
    if found is not None:
        known = prediction.geometry_motion(model, p, *prediction.closure_of(model, p))
        np.testing.assert_allclose(found, known, rtol=1e-12, atol=1e-12 * np.abs(known).max())


@built
def test_singular_poses_have_no_derivatives():
    """Rods that meet in one point of the plate let it turn about that."""
    robot = robots.load(FILES[0])
    mechanism, k = robot.mechanism, robot.mechanism.nominal.copy()
    k[mechanism.plate_columns] = 0.0
    pose = kinematics._forward(mechanism, mechanism.nominal, np.zeros((5, 3))).pose
    found = native.motion(mechanism, k, np.zeros((5, 3)), pose, np.zeros(3))
    assert found is not None and np.isnan(found).all()


@built
def test_first_order_compensation_is_that_of_numpy(case, monkeypatch):
    robot, k, _, rng = case
    mechanism, model = robot.mechanism, Model.nominal(robot).with_geometry(k)
    within = reachable(robot, 400, rng)
    tool = 0.1 * mechanism.tool_direction + 0.02 * rng.standard_normal((400, 3))
    x = within.pose.tcp(tool)
    x[:3] += 10.0  # legs of commanded length reach even there
    for R in (None, within.pose.R):
        mine = compensation.compensate(model, x, tool, rotation_matrix=R, method="first-order", limits=False)
        with monkeypatch.context() as patch:
            patch.setenv(extension.VARIABLE, "0")
            known = compensation.compensate(model, x, tool, rotation_matrix=R, method="first-order", limits=False)
        np.testing.assert_array_equal(mine.status, known.status)
        assert (known.status[3:] == "ok").all()
        np.testing.assert_allclose(mine.q, known.q, rtol=1e-12, atol=1e-12)


@built
@pytest.mark.parametrize("n", [0, 1, 3, 5])
def test_any_number_of_poses(n):
    robot = robots.load(FILES[0])
    q = np.full((n, len(robot.mechanism.actuators)), 0.1)
    solved = kinematics.forward(robot.mechanism, robot.mechanism.nominal, q)
    assert solved.ok.all() and solved.pose.x.shape == (n, 3)


def test_numpy_does_the_same_without_it(case, monkeypatch):
    robot, k, q, _ = case
    monkeypatch.setenv(extension.VARIABLE, "0")
    assert extension.library() is None and "PCALIB_NATIVE=0" in extension.about()
    assert native.forward(robot.mechanism, k, q, None) is None
    known = kinematics._forward(robot.mechanism, k, q[:20])
    np.testing.assert_array_equal(kinematics.forward(robot.mechanism, k, q[:20]).pose.R, known.pose.R)
