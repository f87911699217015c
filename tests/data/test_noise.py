"""The covariance of readings against Monte Carlo of the instrument, and whitening against its definition."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib import rotation
from pcalib.data import joining, measurement
from pcalib.data.instrument import Instrument
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.errors import InputError

DELTA = robots.load(Path(__file__).parents[2] / "models" / "delta.toml")
REFLECTORS = np.array([[0.03, 0.0, -0.01], [-0.02, 0.03, -0.01], [-0.02, -0.03, 0.02]])
TRACKER = Instrument(1e-5, 5e-6, 2e-5, np.array([2.0, -1.0, 0.5]))


def poses(n: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    tool = np.broadcast_to([0.0, 0.05, -0.2], (n, 3)).copy()
    return rng.uniform(-0.3, 0.3, (n, 3)) - [0, 0, 0.8], rotation.exp(rng.normal(0, 0.5, (n, 3))), tool


def kabsch(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rigid motions (S, 3, 3), (S, 3) that lay points a (K, 3) on b (S, K, 3) by least squares."""
    middle = b.mean(axis=1)
    U, _, Vt = np.linalg.svd(np.einsum("ski,kj->sij", b - middle[:, None], a - a.mean(axis=0)))
    D = np.tile(np.eye(3), (len(b), 1, 1))
    D[:, 2, 2] = np.sign(np.linalg.det(U @ Vt))
    R = U @ D @ Vt
    return R, middle - R @ a.mean(axis=0)


@pytest.mark.parametrize("by_tracker", [False, True])
def test_reflectors_make_the_covariance_of_a_rigid_fit(by_tracker):
    x, R, tool = poses(1)
    how = replace(TRACKER if by_tracker else Instrument(sigma_reflector=1e-5), reflectors=REFLECTORS)
    rng = np.random.default_rng(0)
    exact = x[0] + (REFLECTORS - tool[0]) @ R[0].T
    if by_tracker:  # noise along the line of sight and across it, drawn there
        sight = exact - TRACKER.station
        d = np.linalg.norm(sight, axis=1)
        noise = np.empty((20000, 3, 3))
        for k in range(3):
            axes = np.linalg.qr(np.column_stack([sight[k], np.eye(3)[:, :2]]))[0]
            size = [np.hypot(1e-5, 5e-6 * d[k]), 2e-5 * d[k], 2e-5 * d[k]]
            noise[:, k] = (rng.standard_normal((20000, 3)) * size) @ axes.T
    else:
        noise = 1e-5 * rng.standard_normal((20000, 3, 3))
    turn, shift = kabsch(REFLECTORS, exact + noise)
    error = np.concatenate([turn @ tool[0] + shift - x[0], rotation.log(turn @ R[0].T)], axis=1)
    seen, want = np.cov(error.T), how.covariance(x, R, tool)[0]
    size = np.sqrt(np.diag(want))
    np.testing.assert_allclose(seen / np.outer(size, size), want / np.outer(size, size), atol=0.04)
    assert abs(want[0, 4]) > 0.3 * size[0] * size[4]  # position and rotation of a far tool go together


def test_whitening_is_a_square_root_of_the_inverse_covariance():
    x, R, tool = poses()
    x[1, 0] = np.nan
    R[2] = np.nan
    how = replace(TRACKER, reflectors=REFLECTORS)
    data = Measurements.create(DELTA, np.zeros((6, 3)), x, R, tool=tool, instrument=how)
    G = np.random.default_rng(1).normal(size=(6, 6, 3))
    for noise in (Noise.of(data), Noise.of(data).scaled(np.array([2.0, 3.0])), Noise.of(data).with_joints(G, 1e-5)):
        assert noise.covariance is not None
        for n in range(6):
            seen = noise.measured[n]
            eye = np.zeros((6, 6, 6))
            eye[n] = np.eye(6)
            W = noise.whiten(eye)[noise.row == n]
            np.testing.assert_allclose(W @ noise.covariance[n] @ W.T, np.eye(seen.sum()), atol=1e-9)
            assert not W[:, ~seen].any()
        y = np.where(data.mask, 1e-5, np.nan)
        np.testing.assert_allclose(noise.whiten(y), noise.padded(y)[noise.row, noise.component])
    np.testing.assert_allclose(noise.sigma, np.sqrt(data.sigma**2 + np.sum((1e-5 * G) ** 2, axis=-1)))


def test_independent_noise_divides_by_sigma():
    x, R, _ = poses()
    x[3, 2] = np.nan
    data = Measurements.create(DELTA, np.zeros((6, 3)), x, R, sigma_pos=2e-5, sigma_rot=1e-4)
    assert data.covariance is None
    values = np.random.default_rng(2).normal(size=(6, 6, 4))
    noise, eye = Noise.of(data), np.broadcast_to(np.eye(6), (6, 6, 6))
    np.testing.assert_allclose(noise.whiten(values), (values / data.sigma[..., None])[data.mask])
    correlated = Noise.of(replace(data, correlation=eye))
    np.testing.assert_allclose(correlated.whiten(values), noise.whiten(values))


@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
@pytest.mark.parametrize("frame", ["base", "tracker"])
def test_files_keep_what_they_state_of_the_instrument(tmp_path, name, frame):
    x, R, tool = poses()
    station = TRACKER.station if frame == "base" else np.zeros(3)
    for how in (replace(TRACKER, station=station), Instrument(sigma_reflector=2e-5, reflectors=REFLECTORS)):
        data = Measurements.create(
            DELTA, np.zeros((6, 3)), x, R, tool=tool, sigma_rot=5e-5, sigma_pos=np.linspace(1, 2, 6) * 1e-6,
            instrument=how, frame=frame,
        )  # fmt: skip
        measurement.save(tmp_path / name, data)
        again = measurement.load(tmp_path / name)
        assert again.stated == (True, True)
        np.testing.assert_allclose(again.sigma, data.sigma, rtol=1e-9)
        np.testing.assert_allclose(again.correlation, data.correlation, atol=1e-9)
    both = joining.join([data, data])
    assert both.instrument is data.instrument and both.covariance.shape == (12, 6, 6)
    mixed = joining.join([data, Measurements.create(DELTA, np.zeros((6, 3)), x, R, frame=frame)])
    np.testing.assert_array_equal(mixed.correlation[6:], np.broadcast_to(np.eye(6), (6, 6, 6)))
    with pytest.raises(InputError, match="files of their own"):
        measurement.save(tmp_path / name, mixed)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("sigma_range_um = 10", "σ of range and of angle belong together"),
        ("sigma_range_um = 10\n# sigma_angle_urad = 5", "needs the place of the tracker"),
        ("sigma_range_um = -1\n# sigma_angle_urad = 5", "must be a positive number, not '-1'"),
        ("sigma_range_um = 1\n# sigma_range_mm = 1", "'sigma_range' is given twice"),
        ("sigma_reflector_um = 10", "needs the reflectors' places"),
        ("reflectors_mm = 0 0 0; 1 0 0; 0 1 0", "the reflectors have no σ"),
        ("reflectors_mm = 0 0 0; 1 0 0; 2 0 0\n# sigma_reflector_um = 9", "lie on one line"),
        ("reflectors_mm = 0 0; 1 0 0; 2 1 0", "must hold three reflectors"),
        ("tracker_x_mm = far", "must be a number"),
        ("tracker_x_mm = 1", "place is stated without its σ"),
        ("sigma_rang_um = 1", "did you mean 'sigma_range_um'"),
    ],
)
def test_a_statement_that_is_wrong_or_not_complete_names_its_line(tmp_path, head, said):
    path = tmp_path / "a.csv"
    path.write_text(f"# {head}\nq1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n0,0,0,1,2,-800\n")
    with pytest.raises(InputError, match=r"a\.csv:[12]: ") as caught:
        measurement.load(path)
    assert said in str(caught.value)
