"""The planar parallelogram as a robot kind: its rows, Jacobians and inverse, against geometry and differences."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcalib import robot as robots
from pcalib import rotation
from pcalib.mechanics import kinematics

MODEL = Path(__file__).parents[2] / "models" / "planar.toml"
MECHANISM = robots.load(MODEL).mechanism
Q = np.radians(np.linspace(-45, 45, 31))[:, None]
TOOL = np.array([0.0, -0.2, 0.0])

errors = st.lists(st.floats(-1, 1), min_size=9, max_size=9).map(
    lambda e: MECHANISM.nominal + np.array([0.05, *[4e-3] * 8]) * e
)


def solve(k, q=Q):
    found = kinematics.forward(MECHANISM, k, q, tolerance=1e-14)
    assert found.ok.all()
    return found.pose


def test_parameters_are_those_of_the_paper():
    assert MECHANISM.parameters == ("q0", "a1x", "a2x", "a2y", "b1x", "b2x", "b2y", "l1", "l2")
    assert MECHANISM.nominal[1:3] == pytest.approx(0.125)
    assert MECHANISM.nominal[7:] == pytest.approx(0.95)


@settings(max_examples=40, deadline=None)
@given(k=errors)
def test_forward_poses_keep_both_rods_and_the_drive_angle(k):
    v, pose = dict(zip(MECHANISM.parameters, k, strict=True)), solve(k)
    B1, B2 = (pose.tcp(np.array(b)) for b in ([-v["b1x"], 0, 0], [v["b2x"], v["b2y"], 0]))
    rod1, rod2 = B1 - [-v["a1x"], 0, 0], B2 - [v["a2x"], v["a2y"], 0]
    assert np.linalg.norm(rod1, axis=1) == pytest.approx(v["l1"], abs=1e-12)
    assert np.linalg.norm(rod2, axis=1) == pytest.approx(v["l2"], abs=1e-12)
    assert np.arctan2(rod1[:, 0], -rod1[:, 1]) == pytest.approx(Q[:, 0] + v["q0"], abs=1e-12)
    assert not pose.x[:, 2].any()
    assert pose.R[:, 2, 2] == pytest.approx(1.0, abs=1e-14)


@settings(max_examples=40, deadline=None)
@given(k=errors, h=st.floats(0, 0.3))
def test_inverse_needs_x_only_and_undoes_forward(k, h):
    tool = np.array([0.0, -h, 0.0])
    pose = solve(k)
    wanted = pose.tcp(tool)
    wanted[:, 1] = np.nan  # not commanded: whatever stands there must not matter
    found = kinematics.inverse(MECHANISM, k, wanted, tool=tool)
    assert found.ok.all()
    assert found.q == pytest.approx(Q, abs=1e-10)
    assert found.pose.x == pytest.approx(pose.x, abs=1e-10)
    again = kinematics.inverse(MECHANISM, k, wanted, tool=tool, start=found)
    assert again.iterations == 0 and np.array_equal(again.q, found.q)


def test_inverse_takes_a_tool_per_pose_and_more_poses_than_a_chunk():
    n = kinematics.CHUNK + 7
    q = np.linspace(-0.7, 0.7, n)[:, None]
    tools = np.stack([np.zeros(n), -np.linspace(0, 0.3, n), np.zeros(n)], axis=-1)
    k = MECHANISM.nominal + np.array([0.02, *[3e-3, -2e-3] * 4])
    start = kinematics.forward(MECHANISM, k, q + 0.01)
    for guess in (None, start):
        found = kinematics.inverse(MECHANISM, k, solve(k, q).tcp(tools), tool=tools, start=guess)
        assert found.ok.all()
        assert found.q == pytest.approx(q, abs=1e-10)


def test_a_target_beyond_the_rod_is_reported_not_raised():
    found = kinematics.inverse(MECHANISM, MECHANISM.nominal, np.array([[0.1, 0, 0], [1.2, 0, 0]]))
    assert list(found.ok) == [True, False]


@settings(max_examples=25, deadline=None)
@given(k=errors)
def test_sensitivity_against_differences(k):
    S, e = kinematics.sensitivity(MECHANISM, k, Q, solve(k), TOOL), 2e-4

    def reading(k):
        pose = solve(k)
        return np.hstack([pose.tcp(TOOL)[:, :2], rotation.log(pose.R)[:, 2:]])

    for j in range(9):
        step = e * np.eye(9)[j]
        slope = sum(c * (reading(k + n * step) - reading(k - n * step)) for n, c in [(1, 2 / 3), (2, -1 / 12)])
        assert S[:, :, j] == pytest.approx(slope / e, abs=1e-7)


def test_jacobians_of_drive_and_state_against_differences():
    k, e = MECHANISM.nominal + np.array([0.03, *[3e-3, -2e-3, 1e-3, 2e-3] * 2]), 1e-5
    pose = solve(k)
    at = kinematics.closure(MECHANISM, k, Q, pose, TOOL)
    slope = (solve(k, Q + e).tcp(TOOL) - solve(k, Q - e).tcp(TOOL))[:, :1] / (2 * e)
    assert kinematics.task_jacobian(MECHANISM, at, pose)[:, 0] == pytest.approx(slope, abs=1e-8)
    up, down = (kinematics.closure(MECHANISM, k, Q + s, pose).f for s in (e, -e))
    assert kinematics.jacobian_actuators(MECHANISM, at)[..., 0] == pytest.approx((up - down) / (2 * e), abs=1e-9)


def test_levels_are_those_of_the_paper():
    classical = MECHANISM.levels["classical"]
    k = MECHANISM.nominal + classical.basis @ [0.02, 3e-3]
    pose = solve(k)  # the simplified model is the complete one of a perfect parallelogram
    assert pose.x[:, 0] == pytest.approx(0.953 * np.sin(Q[:, 0] + 0.02), abs=1e-13)
    assert np.abs(pose.R - np.eye(3)).max() < 1e-12
    assert MECHANISM.levels["nominal"].basis.shape == (9, 0)
    assert np.array_equal(MECHANISM.levels["complete"].basis, np.eye(9))


def test_columns_that_one_derivative_would_take_from_another_are_refused():
    """A column of the actuation that stands in for a coordinate which does not exist would read 0 in every Jacobian."""
    columns = MECHANISM.plate_columns.copy()
    columns[1, 2] = MECHANISM.index("a2x")
    with pytest.raises(ValueError, match="a2x stands twice among the columns of rod 2"):
        replace(MECHANISM, plate_columns=columns)
