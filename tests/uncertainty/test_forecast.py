"""What data would tell before a fit: against what robots calibrated with such data then miss in MuJoCo."""

import numpy as np
import pytest

from bench import plan, simulate
from bench import truth as truths
from bench.jobs import instruments
from bench.kinds import MODELS
from pcalib import inspection
from pcalib import robot as robots
from pcalib.uncertainty import forecast as forecasts
from pcalib.uncertainty.forecast import forecast

ROBOTS = 6


def measured(instrument, seed, n=40, robot="delta"):
    truth = truths.parse(
        f'robot = "{MODELS / robot}.toml"\n[geometry]\nsigma_length_mm = 0.1\nsigma_angle_deg = 0.05\nseed = {seed}\n'
        f"[instrument]\n{instrument}"
    )
    return truth, simulate.run(truth, plan.make(truth.robot, "random", n, seed=seed), seed).measurements


POSES = "sigma_pos_um = 20\nsigma_rot_urad = 60\n"
POSITIONS = 'kind = "position"\nsigma_pos_um = 20\n'


@pytest.mark.parametrize("instrument, unseen", [(POSES, False), (POSITIONS, True)], ids=["poses", "positions"])
def test_robots_land_a_long_tool_as_forecast(instrument, unseen):
    """The radius that contains 95 % is 1.6 times the RMS where errors are alike in three directions, 2 in one."""
    rms, said = [], []
    for seed in range(ROBOTS):
        truth, data = measured(instrument, seed)
        found = forecast(data, truth.robot)
        assert found.tilts_unseen == unseen
        rms.append(instruments.landed(truth, data, seed))
        said.append(dict(found.u95)[0.3])
    assert 1.2 < np.mean(said) / np.sqrt(np.mean(np.square(rms))) < 2.6


def test_some_of_many_rows_tell_as_much_as_all(monkeypatch):
    truth, data = measured(POSES, 0)
    many = data.take(np.repeat(np.arange(len(data)), 60))
    assert len(many) > 2 * forecasts.ROWS
    some = forecast(many, truth.robot)
    monkeypatch.setattr(forecasts, "ROWS", len(many))
    every = forecast(many, truth.robot)
    assert np.array(some.u95) == pytest.approx(np.array(every.u95), rel=0.02)
    assert every.u95[0][1] < forecast(data, truth.robot).u95[0][1] / 4


@pytest.mark.parametrize("robot", ["planar", "linear_delta", "hexapod"])
def test_every_sort_of_robot_has_one(robot):
    truth, data = measured(POSES, 1, robot=robot)
    found = inspection.inspect(data, truth.robot)
    radii = [row["u95_um"] for row in found.facts["forecast"]["landings"]]
    assert 1 < radii[0] < 60 and radii == sorted(radii)


def test_nothing_is_forecast_of_data_that_are_far_off():
    truth, data = measured(POSES, 2)
    other = robots.load(MODELS / "delta.toml")
    shifted = data.take(np.arange(len(data)))
    shifted.position[:] = shifted.position[:, [1, 2, 0]]
    assert inspection.inspect(shifted, other).facts["forecast"] is None
    assert forecast(data.take(np.zeros(0, int)), truth.robot) is None
