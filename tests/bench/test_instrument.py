"""The instrument's noise has the size it states, in the right frame, and depends on seed and row alone."""

import numpy as np
import pytest

from bench.instrument import Instrument
from pcalib import rotation

N = 4000
RNG = np.random.default_rng(0)
TCP = RNG.uniform(-0.5, 0.5, (N, 3)) + [0, 0, -0.8]
R = rotation.exp(0.3 * RNG.standard_normal((N, 3)))
ROWS = np.arange(N)


def read(rows=ROWS, seed=1, **settings):
    instrument = Instrument(**settings)
    return instrument.read(*instrument.frame(TCP[rows], R[rows]), seed, rows)


def test_without_noise_the_truth():
    reading = read()
    assert np.array_equal(reading.position, TCP) and np.array_equal(reading.rotation, R)
    assert not reading.lost.any() and not reading.outlier.any()


def test_noise_is_white_in_position_and_left_multiplied_in_rotation():
    reading = read(sigma_pos=2e-5, sigma_rot=1e-4)
    for noise, sigma in ((reading.position - TCP, 2e-5), (rotation.log(reading.rotation @ np.swapaxes(R, 1, 2)), 1e-4)):
        covariance = noise.T @ noise / N / sigma**2
        assert np.abs(covariance - np.eye(3)).max() < 0.09
        assert np.abs(noise.mean(axis=0)).max() < 4 * sigma / np.sqrt(N)
    assert (reading.sigma_pos == 2e-5).all() and (reading.sigma_rot == 1e-4).all()


def test_a_row_draws_the_same_in_any_company():
    everything = read(sigma_pos=1e-5, sigma_rot=1e-4, missing_components=0.1, outliers=0.1)
    some = np.array([3990, 7, 100])
    alone = read(rows=some, sigma_pos=1e-5, sigma_rot=1e-4, missing_components=0.1, outliers=0.1)
    assert np.array_equal(alone.position, everything.position[some], equal_nan=True)
    assert np.array_equal(alone.rotation, everything.rotation[some])
    other = read(seed=2, sigma_pos=1e-5)
    assert not np.isclose(other.position, read(sigma_pos=1e-5).position, atol=1e-12).any(axis=1).all()


def test_tracker_frame_is_a_rigid_motion_by_its_settings():
    place, turn = np.array([2.0, 1.0, 0.5]), np.array([0.1, 0.2, -1.0])
    reading = read(frame="tracker", position=place, rotation=turn)
    Rt = rotation.exp(turn)
    assert np.allclose(reading.position @ Rt.T + place, TCP, atol=1e-14)
    assert np.allclose(Rt @ reading.rotation, R, atol=1e-14)


def test_tracker_noise_grows_with_distance():
    place = np.array([3.0, 0.0, 0.0])
    reading = read(frame="tracker", position=place, rotation=np.zeros(3), sigma_pos=1e-5, sigma_distance=6e-6)
    distance = np.linalg.norm(TCP - place, axis=1)
    assert np.allclose(reading.sigma_pos, np.hypot(1e-5, 6e-6 * distance))
    noise = (reading.position - (TCP - place)) / reading.sigma_pos[:, None]
    assert abs(noise.std() - 1) < 0.03


def test_kinds_see_what_they_can():
    assert np.isnan(read(kind="position").rotation).all() and np.isfinite(read(kind="position").position).all()
    probe = read(kind="probe")
    assert np.isnan(probe.position[:, :2]).all() and np.array_equal(probe.position[:, 2], TCP[:, 2])
    assert np.isnan(probe.rotation).all()


@pytest.mark.parametrize("share", [0.05, 0.4])
def test_what_goes_missing(share):
    def close_to(found):
        return abs(found - share) < 4 * np.sqrt(share * (1 - share) / N)

    reading = read(missing_components=share)
    assert close_to(np.isnan(reading.position).mean())
    assert close_to(np.isnan(read(missing_rotations=share).rotation[:, 0, 0]).mean())
    assert close_to(read(missing_rows=share).lost.mean())


def test_outliers_are_gross_and_told():
    reading = read(sigma_pos=1e-5, outliers=0.1, outlier_size=2e-3)
    error = np.linalg.norm(reading.position - TCP, axis=1)
    assert abs(reading.outlier.mean() - 0.1) < 0.02
    assert np.median(error[reading.outlier]) > 50 * error[~reading.outlier].max() / 5
    assert error[~reading.outlier].max() < 7e-5


def test_resolution():
    reading = read(sigma_pos=1e-5, resolution_pos=1e-4, resolution_rot=1e-3)
    assert np.allclose(np.round(reading.position / 1e-4) * 1e-4, reading.position, atol=1e-15)
    vector = rotation.log(reading.rotation)
    assert np.allclose(np.round(vector / 1e-3) * 1e-3, vector, atol=1e-12)


def test_joint_repeatability():
    q = np.zeros((N, 3))
    noise = Instrument(sigma_joint=1e-5).joint_noise(q, "angle", 3, ROWS)
    assert abs(noise.std() - 1e-5) < 3e-7 and not Instrument().joint_noise(q, "angle", 3, ROWS).any()
    assert not Instrument(sigma_joint=1e-5).joint_noise(q, "length", 3, ROWS).any()
    assert np.array_equal(Instrument(sigma_joint=1e-5).joint_noise(q[5:8], "angle", 3, ROWS[5:8]), noise[5:8])
