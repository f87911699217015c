"""The grid of targets: within workspace and joint range, regular, both ends of the cylinder included."""

from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib.errors import InputError, ReachError
from pcalib.mechanics import kinematics
from pcalib.workspace import workspace_grid

MODELS = Path(__file__).parents[1] / "models"
KINDS = sorted(f.stem for f in MODELS.glob("*.toml") if "." not in f.stem)


@pytest.mark.parametrize("name", KINDS)
def test_every_point_can_be_commanded(name):
    robot = robots.load(MODELS / f"{name}.toml")
    points = workspace_grid(robot)
    found = kinematics.inverse(robot.mechanism, robot.mechanism.nominal, points)
    margin = 0.0099 * (robot.joint_max - robot.joint_min)
    assert found.ok.all() and len(points) > 20
    assert (found.q > robot.joint_min + margin).all() and (found.q < robot.joint_max - margin).all()
    assert robot.workspace.contains(points).all()
    assert len(np.unique(np.round(points, 9), axis=0)) == len(points)


def test_spacing_and_ends(delta):
    points = workspace_grid(delta, 0.1)
    assert np.unique(np.round(points[:, 0], 9)) == pytest.approx(np.arange(-0.4, 0.41, 0.1), abs=1e-9)
    assert np.unique(np.round(points[:, 2], 9))[[0, -1]] == pytest.approx([-0.925, -0.675])
    assert len(workspace_grid(delta, 0.05)) > 6 * len(points)


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf, 1e-6])
def test_spacing_that_makes_no_sense(delta, spacing):
    with pytest.raises(InputError):
        workspace_grid(delta, spacing)


def test_a_workspace_out_of_reach_is_said_so(delta):
    text = delta.text.replace("z_min_mm = -", "z_min_mm = -2").replace("z_max_mm = -", "z_max_mm = -2")
    with pytest.raises(ReachError, match="reaches no point"):
        workspace_grid(robots.parse(text))
