"""Every noise has the covariance that it states, and what it shares with other rows is as its settings say."""

import numpy as np
import pytest

from bench import noises, simulate
from bench import plan as plans
from bench import truth as truths
from bench.instrument import Instrument
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import robot as robots
from pcalib import rotation
from pcalib.data import measurement

N = 3000
RNG = np.random.default_rng(0)
POSITION = RNG.uniform(-0.5, 0.5, (N, 3)) + [0, 0, -0.8]
R = rotation.exp(0.3 * RNG.standard_normal((N, 3)))
TOOL = np.array([0.0, 0.05, -0.2])
ROWS = np.arange(N)
SETTINGS = {"sigma_pos": 2e-5, "sigma_rot": 1e-4, "sigma_distance": 6e-6}


def read(name, rows=ROWS, seed=1, **settings):
    instrument = Instrument(noise=name, **SETTINGS | settings)
    return instrument.read(POSITION[rows], R[rows], seed, rows, TOOL)


def errors(reading, rows=ROWS):
    turn = rotation.log(reading.rotation @ np.swapaxes(R[rows], 1, 2))
    return np.hstack([reading.position - POSITION[rows], turn])


def white(reading):
    """(N, 6) errors divided by the root of the covariance that the instrument knows of."""
    return np.linalg.solve(np.linalg.cholesky(reading.covariance), errors(reading)[:, :, None])[:, :, 0]


@pytest.mark.parametrize("name", noises.names())
def test_errors_have_the_covariance_that_is_known(name):
    z = white(read(name))
    assert np.abs(z.mean(axis=0)).max() < 0.3
    spread = z.T @ z / N
    assert np.abs(spread - np.eye(6)).max() < (0.5 if name == "heavy_tails" else 0.2)  # t3 has no fourth moment


@pytest.mark.parametrize("name", noises.names())
def test_a_row_draws_the_same_in_any_company(name):
    some = np.array([2990, 7, 100])
    assert np.allclose(read(name, some).position, read(name).position[some], rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", noises.names())
def test_the_mean_variance_is_stated(name):
    reading = read(name)
    variance = np.diagonal(reading.covariance, axis1=1, axis2=2).mean(axis=0)
    assert np.mean(reading.sigma_pos**2) == pytest.approx(variance[:3].mean(), rel=1e-9)
    assert np.mean(reading.sigma_rot**2) == pytest.approx(variance[3:].mean(), rel=1e-9)


def test_correlated_noise_fades_over_rows_and_white_noise_has_none():
    for name, share in (("correlated", 0.5), ("white", 0.0)):
        z = white(read(name))
        for lag in (1, 6, 30):
            found = np.mean(z[lag:] * z[:-lag])
            assert found == pytest.approx(share * np.exp(-lag / 6), abs=0.05), (name, lag)


def test_heavy_tails_are_heavy():
    far = np.mean(np.abs(white(read("heavy_tails"))) > 4)
    assert 0.004 < far < 0.012  # of t3 scaled to unit variance 0.65 %; of a normal 0.006 %
    assert np.mean(np.abs(white(read("white"))) > 4) < 0.001


def test_a_tracker_is_sharp_along_its_beam():
    station = np.array([3.0, 0.0, 0.0])
    reading = read("range_angle", position=station, sigma_range=1e-6, sigma_distance=0.0, sigma_angle=1e-5)
    beam = POSITION - station
    distance = np.linalg.norm(beam, axis=1)
    error = errors(reading)[:, :3]
    along = np.sum(error * beam, axis=1) / distance
    across = np.linalg.norm(error - along[:, None] * beam / distance[:, None], axis=1) / distance
    assert along.std() == pytest.approx(1e-6, rel=0.05)
    assert np.sqrt(np.mean(across**2) / 2) == pytest.approx(1e-5, rel=0.05)


def test_reflectors_far_from_the_tool_point_correlate_position_with_rotation():
    near, far = (read("reflectors", reflector_centre=place) for place in (TOOL, TOOL + [0.0, 0.0, 0.2]))
    assert near.sigma_pos[0] == pytest.approx(15e-6 / np.sqrt(3), rel=1e-6)  # the mean of three reflectors
    # Two reflectors turn the plate about any axis in their plane by σ/(r·√1.5), and 200 mm away that moves the tool.
    assert far.sigma_pos[0] > 1.8 * near.sigma_pos[0]
    shared = [np.abs(reading.covariance[:, :3, 3:]).max() for reading in (near, far)]
    assert shared[1] > 0.5 * far.sigma_pos[0] * far.sigma_rot[0] > 5 * shared[0]


@pytest.mark.parametrize("name", noises.names())
@pytest.mark.parametrize("frame", ["base", "tracker"])
def test_a_file_that_describes_its_instrument_has_the_covariance_that_the_noise_has(name, frame, tmp_path, own_tests):
    robot = robots.load(MODELS / "delta.toml")
    settings = SETTINGS | {"sigma_distance": 0.0, "frame": frame, "state_covariance": True}
    truth = truths.Truth(robot, np.zeros(60), Instrument(noise=name, **settings))
    made = simulate.run(truth, plans.make(robot, "random", 6, tools=[TOOL], seed=1), 2)
    measurement.save(tmp_path / "data.csv", made.measurements)
    read = measurement.load(tmp_path / "data.csv", robot)
    if name in own_tests and read.instrument is None:
        return  # no metadata are foreseen for it, and the file states mean σ
    found = read.covariance if read.covariance is not None else read.sigma[:, :, None] ** 2 * np.eye(6)
    size = np.sqrt(np.diagonal(made.covariance, axis1=1, axis2=2))
    assert np.abs((found - made.covariance) / (size[:, :, None] * size[:, None, :])).max() < 0.01
    plain = name in ("white", "heavy_tails", "correlated", "camera")
    assert read.sigma_stated and (name in own_tests or (read.instrument is None) == plain)


def test_a_file_that_does_not_describe_it_states_one_sigma():
    robot = robots.load(MODELS / "delta.toml")
    truth = truths.Truth(robot, np.zeros(60), Instrument(noise="reflectors"))
    data = simulate.run(truth, plans.make(robot, "random", 6, tools=[TOOL], seed=1), 2).measurements
    assert data.covariance is None and data.stated == (True, True) and len(np.unique(data.sigma[:, :3])) == 1


def test_a_noise_is_chosen_in_a_truth_file_and_sealed_with_it():
    truth = truths.parse(
        f'robot = "{MODELS / "delta.toml"}"\n[instrument]\nnoise = "reflectors"\nsigma_reflector_um = 12\n'
        "reflector_centre_mm = [0, 0, 30]\n"
    )
    again = truths.parse(truths.dumps(truth)).instrument
    assert again.values["noise"] == "reflectors" and again.values["sigma_reflector"] == pytest.approx(12e-6)
    assert again.values["reflector_centre"][2] == pytest.approx(0.03)


@pytest.mark.parametrize("kind", ["delta", "linear_delta"])
def test_contacts_touch_the_bed(kind):
    robot = robots.load(MODELS / f"{kind}.toml")
    space = robot.workspace
    bed = 0.5 * (space.z_min + space.z_max)
    errors = truths.draw_errors(robot, 3e-4, 1e-3, 2)
    plan = plans.make(robot, "random", 12, seed=3)
    for sigma in (0.0, 3e-5):
        truth = truths.Truth(robot, errors, Instrument(kind="contact", bed=bed, sigma_pos=sigma))
        data = simulate.run(truth, plan, 5)
        assert np.array_equal(data.measurements.position[:, 2], np.full(len(data.kept), bed))
        assert not data.measurements.mask[:, :2].any() and not data.measurements.mask[:, 3:].any()
        stands = Machine(robot, truth.values).land(data.measurements.q).tcp[:, 2]
        assert len(stands) > 8
        if sigma:
            assert 0.4 * sigma < np.std(stands) < 1.8 * sigma
        else:
            assert np.abs(stands - bed).max() < 1e-9
