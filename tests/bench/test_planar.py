"""The planar machine against the paper's closed form, and that its plane is one."""

import numpy as np
import pytest

from bench import faults
from bench.commands import Commands
from bench.jobs.savoure2006 import closed_form as paper
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import robot as robots

ROBOT = robots.load(MODELS / "planar.toml")
MECHANISM = ROBOT.mechanism
Q = np.random.default_rng(0).uniform(*ROBOT.joint_range, (300, 1))
TOOL = np.array([0.0, -0.25, 0.0])


def perturbed(seed):
    size = np.where(np.array(MECHANISM.units) == "rad", 4e-3, 2e-3)
    return MECHANISM.nominal + size * np.random.default_rng(seed).standard_normal(len(size))


@pytest.mark.parametrize("seed", range(3))
def test_lands_where_the_paper_says(seed):
    k = perturbed(seed)
    landing, expected = Machine(ROBOT, k).land(Q, TOOL), paper.forward(k, Q[:, 0])
    assert landing.ok.all() and np.ptp(expected.x[:, 0]) > 1.0
    assert np.abs(landing.tcp - expected.tcp(TOOL)).max() <= 1e-10
    assert np.abs(landing.R - expected.R).max() <= 1e-10


def test_the_drive_carries_what_hangs_on_it():
    """Of a perfect parallelogram all moving masses swing along: plate and payload at the tip, rods at half way."""
    compliance, payload = 1e-7, 3.0
    soft = faults.make(ROBOT, "drive_compliance", {"compliance_urad_Nm": 0.1})
    q = Q[:40]
    landing = Machine(ROBOT, None, [soft]).run(Commands.of(q, TOOL, payload))
    hanging = ROBOT.mass["plate"] + payload + 2 * ROBOT.mass["rod"] / 2
    sag = -compliance * hanging * 9.81 * MECHANISM.nominal[7] * np.sin(q[:, 0])
    moved = landing.tcp[:, 0] - Machine(ROBOT).land(q, TOOL).tcp[:, 0]
    expected = sag * MECHANISM.nominal[7] * np.cos(q[:, 0])
    assert np.abs(expected).max() > 1e-6
    assert np.abs(moved - expected).max() <= 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("name", ["bearing_runout", "backlash", "thermal_rods", "encoder_eccentricity"])
def test_faults_keep_to_the_plane(name):
    commands = Commands.of(Q[:20], TOOL, 1.0, temp_rods=30.0, dir1=1.0)
    landing = Machine(ROBOT, perturbed(5), [faults.typical(ROBOT, name)]).run(commands)
    rigid = Machine(ROBOT, perturbed(5)).run(commands)
    assert np.abs(landing.tcp[:, 2]).max() <= 1e-12 < 1e-6 < np.abs(landing.tcp - rigid.tcp)[:, :2].max()
