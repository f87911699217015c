"""The planar five-bar: elementary geometry, round trips and ranks."""

from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib.fitting.identifiability import THRESHOLD, priors
from pcalib.mechanics import kinematics
from pcalib.workspace import reachable

ROBOT = robots.load(Path(__file__).parents[2] / "models" / "five_bar.toml")
MECHANISM = ROBOT.mechanism


def test_a_pose_by_hand():
    """At 30° outwards the elbows are 600 mm apart, 259.8 mm below the motors, and the point is
    √(450² − 300²) = 335.4 mm below them."""
    q = np.radians([[30.0, 30.0]])
    found = kinematics.forward(MECHANISM, MECHANISM.nominal, q)
    assert found.ok.all()
    below = 0.3 * np.cos(np.pi / 6) + np.sqrt(0.45**2 - 0.3**2)
    assert found.pose.x[0] == pytest.approx([0.0, 0.52 - below, 0.0], abs=1e-12)


def test_all_ten_parameters_show_in_positions():
    """An arm's elbow runs on a circle: centre 2, radius 1, zero 1, and its rod 1; twice."""
    found = reachable(ROBOT, 40, np.random.default_rng(0))
    S = kinematics.sensitivity(MECHANISM, MECHANISM.nominal, found.q, found.pose, np.zeros(3))
    J = (S * priors(MECHANISM.units) / 2e-5).reshape(-1, 10)
    assert np.sum(np.linalg.svd(J, compute_uv=False) > THRESHOLD) == 10


def test_inverse_undoes_forward():
    found = reachable(ROBOT, 60, np.random.default_rng(1))
    k = MECHANISM.nominal + 1e-3 * np.random.default_rng(2).standard_normal(10)
    pose = kinematics.forward(MECHANISM, k, found.q).pose
    back = kinematics.inverse(MECHANISM, k, pose.x)
    assert back.ok.all() and back.q == pytest.approx(found.q, abs=1e-9)
