"""Rotations against SciPy's, which was written by others, and against finite differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from pcalib import rotation

vectors = arrays(float, 3, elements=st.floats(-1, 1, allow_subnormal=False))


@st.composite
def turns(draw, largest=np.pi):
    """Rotation vectors of any angle up to `largest`, tiny ones and ones near π included."""
    axis = draw(vectors.filter(lambda v: np.linalg.norm(v) > 1e-3))
    angle = draw(st.one_of(st.floats(0, largest), st.floats(0, 1e-6), st.floats(largest - 1e-6, largest)))
    return axis / np.linalg.norm(axis) * angle


@given(turns(7.0))
def test_exp_is_scipys(v):
    np.testing.assert_allclose(rotation.exp(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-14)


@given(turns())
def test_log_inverts_exp(v):
    back = rotation.log(rotation.exp(v))
    if np.linalg.norm(v) > np.pi - 1e-7:  # both axes stand for a half turn
        np.testing.assert_allclose(rotation.exp(back), rotation.exp(v), atol=1e-13)
        assert np.linalg.norm(back) <= np.pi + 1e-12
    else:
        np.testing.assert_allclose(back, v, atol=1e-8 if np.linalg.norm(v) > 3 else 1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-4, 0.00999, 0.01001, 1.0, 3.0, np.pi - 1e-3])
def test_log_keeps_small_and_large_angles(angle):
    v = angle * np.array([2.0, -1.0, 2.0]) / 3
    np.testing.assert_allclose(rotation.log(rotation.exp(v)), v, rtol=1e-12, atol=1e-17)


@given(turns(), turns())
def test_quaternions_compose_as_matrices_do(a, b):
    for v in (a, b):
        q = rotation.to_quaternion(rotation.exp(v))
        theirs = Rotation.from_rotvec(v).as_quat(scalar_first=True)
        np.testing.assert_allclose(q * np.sign(q @ theirs), theirs, atol=1e-14)
        np.testing.assert_allclose(rotation.from_quaternion(q), rotation.exp(v), atol=1e-14)
    theirs = (Rotation.from_rotvec(a) * Rotation.from_rotvec(b)).as_matrix()
    np.testing.assert_allclose(rotation.exp(a) @ rotation.exp(b), theirs, atol=1e-14)


@settings(deadline=None)
@given(turns(3.0))
def test_left_jacobian_is_the_derivative(v):
    h = 1e-6
    numeric = np.empty((3, 3))
    for i, d in enumerate(np.eye(3)):
        forward, backward = (rotation.exp(v + s * h * d) @ rotation.exp(v).T for s in (1, -1))
        numeric[:, i] = (rotation.log(forward) - rotation.log(backward)) / (2 * h)
    np.testing.assert_allclose(rotation.left_jacobian(v), numeric, atol=1e-9)


@given(vectors, vectors)
def test_cross_products(a, b):
    np.testing.assert_allclose(rotation.cross(a, b), np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(rotation.hat(a) @ b, np.cross(a, b), atol=1e-15)


def test_batches_are_loops():
    v = np.random.default_rng(0).normal(size=(4, 5, 3))
    R = rotation.exp(v)
    q = rotation.to_quaternion(R)
    for i in np.ndindex(4, 5):
        np.testing.assert_array_equal(R[i], rotation.exp(v[i]))
        np.testing.assert_array_equal(rotation.log(R)[i], rotation.log(R[i]))
        np.testing.assert_array_equal(q[i], rotation.to_quaternion(R[i]))
        np.testing.assert_array_equal(rotation.left_jacobian(v)[i], rotation.left_jacobian(v[i]))
    np.testing.assert_allclose(rotation.cross(v, v[0, 0]), np.cross(v, v[0, 0]))


def test_about_turns_by_hand():
    R = rotation.about(np.array([0.0, 0.0, 1.0]), np.array([np.pi / 2, 0.0]))
    np.testing.assert_allclose(R[0] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(R[1], np.eye(3))


def test_renormalise_brings_back_a_drifted_rotation():
    R = rotation.exp(np.array([0.3, -0.2, 0.5])) + 1e-7 * np.random.default_rng(0).normal(size=(3, 3))
    fixed = rotation.renormalise(R)
    np.testing.assert_allclose(fixed @ fixed.T, np.eye(3), atol=1e-12)
    assert np.abs(rotation.renormalise(R) - R).max() < 1e-6


def test_laying_is_the_best_rotation():
    """SciPy's solution of Wahba's problem is the same."""
    rng = np.random.default_rng(0)
    a, noise = rng.standard_normal((5, 20, 3)), 0.3 * rng.standard_normal((5, 20, 3))
    true = rotation.exp(rng.standard_normal((5, 3)))
    b = a @ np.swapaxes(true, 1, 2) + noise
    got = rotation.laying(a, b)
    for one, x, y in zip(got, a, b, strict=True):
        np.testing.assert_allclose(one, Rotation.align_vectors(y, x)[0].as_matrix(), atol=1e-9)
