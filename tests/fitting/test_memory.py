"""Noise that is correlated in time is recognised and measured, with readings made by a recursion of its own."""

from __future__ import annotations

import numpy as np
import pytest

from bench.jobs.diagnosis_benchmark import rows
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.problem import problem
from pcalib.fitting import identification, noise_level
from pcalib.fitting import memory as memories
from pcalib.fitting.linearisation import linearise

ROWS, RHO, TAU = 150, 0.5, 6.0


def readings(rng, rho, n=ROWS) -> np.ndarray:
    """(n·6,) scalars of unit variance, row by row; `rho` of it in a first-order recursion from row to row."""
    keep = np.exp(-1.0 / TAU)
    slow = rng.standard_normal((n, 6))
    for i in range(1, n):
        slow[i] = keep * slow[i - 1] + np.sqrt(1 - keep**2) * slow[i]
    return (np.sqrt(1 - rho) * rng.standard_normal((n, 6)) + np.sqrt(rho) * slow).ravel()


def basis_of(rng, columns, n=ROWS) -> np.ndarray:
    """(n·6, columns) orthonormal directions that a model of poses in no order takes up."""
    return np.linalg.qr(rng.standard_normal((6 * n, columns)))[0]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


@pytest.fixture
def where():
    return np.repeat(np.arange(ROWS), 6), np.tile(np.arange(6), ROWS)


@pytest.fixture
def data(delta, rng) -> Measurements:
    return Measurements.create(delta, rng.uniform(-0.5, 0.5, (ROWS, 3)), np.zeros((ROWS, 3)))


def found(data, y, rng, where):
    U = basis_of(rng, 40)
    slow = np.linalg.qr(np.hstack([U, basis_of(rng, 120)]))[0]
    return memories.memory(data, y - U @ (U.T @ y), U, slow, *where)


def test_share_and_duration_are_measured(data, rng, where):
    seen = [found(data, readings(rng, RHO), rng, where) for _ in range(8)]
    assert all(seen)
    assert np.mean([m.share for m in seen]) == pytest.approx(RHO, abs=0.07)
    assert all(2 <= m.rows <= 16 for m in seen)


def test_white_noise_has_no_memory(data, rng, where):
    assert not any(found(data, readings(rng, 0.0), rng, where) for _ in range(12))


def test_a_slow_cause_that_may_be_missing_is_no_memory(data, rng, where):
    """A drift is correlated in time; only what is left beside everything slow speaks for noise."""
    drift = np.repeat(np.linspace(-1.5, 1.5, ROWS), 6)
    U = basis_of(rng, 40)
    slow = np.linalg.qr(np.hstack([U, drift[:, None], basis_of(rng, 60)]))[0]
    y = readings(rng, 0.0) + drift
    assert memories.memory(data, y - U @ (U.T @ y), U, slow, *where) is None


def test_whitened_readings_are_white(data, rng):
    memory = memories.Memory(TAU, TAU, (RHO, RHO))
    factors = memory.whitener(data)[:1] if data.mask[:, 0].any() else []
    turned = np.array([factors[0] @ readings(rng, RHO).reshape(ROWS, 6) for _ in range(40)])
    flat = turned.transpose(1, 0, 2).reshape(ROWS, -1)
    covariance = flat @ flat.T / flat.shape[1]
    assert np.mean(np.diag(covariance)) == pytest.approx(1.0, abs=0.05)
    assert np.abs(np.mean([covariance[i, i + lag] for lag in (1, 3) for i in range(ROWS - lag)])) < 0.03


@pytest.mark.parametrize("number", ["0#3", "21#4"])
def test_replicates_that_follow_on_each_other_speak_for_correlation(number, monkeypatch):
    """Outside slow patterns such noise shows by 1.8–2.2 standard errors here, and replicates scatter less by 2.5."""
    made = rows.replay(f"noise.correlated/{number}", 1)
    found = problem(made.model, made.data).noise
    assert found.excess > 2 and found.memory is not None
    monkeypatch.setattr(noise_level, "excess", lambda *_: 0.0)
    assert problem(made.model, made.data).noise.memory is None


def test_what_a_fit_leaves_over_is_correlated_or_is_not(data, rng, where):
    U = basis_of(rng, 40)
    slow, white = ([memories.of_residuals(data, y - U @ (U.T @ y), U, *where) for y in many] for many in (
        [readings(rng, RHO) for _ in range(8)], [readings(rng, 0.0) for _ in range(40)],
    ))  # fmt: skip
    assert all(slow) and np.mean([m.share for m in slow]) == pytest.approx(RHO, abs=0.07)
    assert not any(white)


def test_sums_over_correlated_readings_scatter_as_is_said(data, rng):
    """The covariance that correlation adds, against the scatter of many draws."""
    columns = rng.standard_normal((ROWS, 6, 2)) + 1.0  # what all rows have in common gains most
    said = memories.Memory(TAU, TAU, (RHO, RHO)).added_covariance(data, columns)
    sums = np.array([np.tensordot(readings(rng, RHO).reshape(ROWS, 6), columns, axes=2) for _ in range(4000)])
    plain = np.einsum("nca,ncb->ab", columns, columns)
    assert np.cov(sums.T) == pytest.approx(plain + said, rel=0.1)
    assert said[0, 0] > plain[0, 0]


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_fit_is_as_uncertain_as_correlated_noise_makes_it(number):
    """The posterior of a fit to correlated noise is wider than that of its weights, which take rows as independent."""
    made = rows.replay(f"noise.correlated_apart/{number}#0", 1)
    fit = identification.fit(made.data, made.start)
    seen = linearise(fit.candidate, made.data, fit.unknowns).jacobian
    g = fit.unknowns.n_geometry
    wider = np.sum((seen[:, :g] @ fit.model.posterior.factor[:g]) ** 2) / np.sum(seen @ fit.covariance * seen)
    assert 1.1 < wider < 3
