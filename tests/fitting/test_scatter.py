"""Joints that do not repeat and σ that is wrong, against the noise that was put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.jobs import coverage
from pcalib.data import replicates
from pcalib.fitting import identification, scatter
from pcalib.fitting.linearisation import joint_response
from pcalib.fitting.result import Code
from pcalib.fitting.scatter import Source
from pcalib.model import Model


@pytest.mark.parametrize("situation", ["half", "double", "unstated", "joints"])
def test_intervals_cover_whatever_is_stated(delta, situation):
    """The long form is scripts/coverage; here few robots, so that only gross under- or over-coverage shows."""
    shares = np.array([coverage.inside(delta, situation, seed) for seed in range(8)])
    assert (np.abs(shares.mean(axis=0) - 0.95) < [0.035, 0.08]).all()


def test_sigma_of_a_fit_does_not_depend_on_the_stated_level(delta, perturb, measure):
    level = delta.mechanism.levels["classical"]
    data = measure(Model(delta, delta.mechanism.nominal + level.project(perturb(3) - delta.mechanism.nominal)), 60)
    plain = identification.fit(data, delta, "classical", method="base")
    assert plain.scale.source is Source.RESIDUALS and Code.SIGMA_TOO_LARGE not in {w.code for w in plain.warnings}
    for factor in (0.2, 4.0):
        found = identification.fit(replace(data, sigma=factor * data.sigma), delta, "classical", method="base")
        np.testing.assert_allclose(found.covariance, plain.covariance, rtol=1e-3, atol=1e-18)
        assert found.scale.ratio[0] * factor == pytest.approx(plain.scale.ratio[0], rel=1e-4)
        assert (Code.SIGMA_TOO_LARGE in {w.code for w in found.warnings}) == (factor > 1)
    few = identification.fit(measure(Model(delta, perturb(3), "complete"), 10), delta, "classical")
    assert few.scale.source is Source.STATED and (few.scale.ratio == 1).all()


def test_rotations_in_another_unit_are_named(delta, perturb, measure):
    data = measure(Model(delta, perturb(3), "complete"), 60)
    found = identification.fit(replace(data, sigma=data.sigma * [1, 1, 1, 8, 8, 8]), delta)
    said = [str(w) for w in found.warnings if w.code is Code.SIGMA_TOO_LARGE]
    assert len(said) == 1 and said[0].startswith("residuals of rotations are 0.1")
    assert found.scale.ratio[0] == pytest.approx(1, abs=0.15) and 1 / 8 < found.scale.ratio[1] < 1 / 5


def test_replicates_tell_joints_that_do_not_repeat_from_the_instrument(delta, monkeypatch):
    """Over many data sets: σ_q is right, and is not seen where there is none."""
    monkeypatch.setattr(coverage, "REPEATED", 40)
    monkeypatch.setattr(coverage, "SIGMA_JOINT", 60e-6)
    seen = {"joints": [], "right": []}
    for situation, found in seen.items():
        for seed in range(20):
            truth, data = coverage.measured(delta, situation, seed)
            pose = identification.residuals(truth, data)[1].pose
            found.append(scatter.with_joints(data, truth, pose)[1].sigma_q)
    clear = [s for s in seen["joints"] if s]
    assert len(clear) >= 15 and np.mean(clear) == pytest.approx(coverage.SIGMA_JOINT, rel=0.15)
    assert sum(s > 0 for s in seen["right"]) <= 3
    truth, data = coverage.measured(delta, "joints", 0)
    found = identification.fit(data, delta)
    assert found.scale.sigma_q > 3e-5 and found.noise.covariance is not None
    assert "joints repeat to" in found.scale.sentence((True, True), (True, True))
    assert found.accuracy.chi2_dof == pytest.approx(1, abs=0.3)


def test_what_repeats_is_no_noise_of_joints(delta):
    """An error of the motor angles that comes again in every replicate is left to the residual."""
    _truth, data = coverage.measured(delta, "right", 3)
    wrong = replace(data, q=data.q + 1e-4 * np.sin(24 * data.q))
    found = identification.fit(wrong, delta)
    assert found.scale.sigma_q == 0.0 and found.accuracy.chi2_dof > 1.5


def test_scatter_of_replicates_is_that_of_each_group(delta):
    """One group of many rows: the variances are those of a sample of it."""
    truth, data = coverage.measured(delta, "right", 1)
    rows = np.zeros(400, int)
    rng = np.random.default_rng(0)
    many = data.take(rows)
    many = replace(many, position=many.position + 3 * data.sigma[0, 0] * rng.standard_normal((400, 3)))
    group = replicates.groups(replace(many, pose_id=np.zeros(400, int)))
    pose = identification.residuals(truth, many)[1].pose
    found = scatter.repeated(many, group, joint_response(truth, many, pose))
    size = np.sqrt(np.mean(np.var(many.position, axis=0, ddof=1)))
    assert found.ratio[0] == pytest.approx(size / data.sigma[0, 0], rel=0.1)


def test_bounds_effects_and_joints_that_decide_by_themselves_are_warned_of(delta, perturb, measure):
    from pcalib import effects
    from pcalib.model import FittedEffect

    k = perturb(1)
    k[delta.mechanism.index("l11")] = delta.mechanism.nominal[delta.mechanism.index("l11")] + 2e-3
    data = measure(Model(delta, k, "complete"), 60)
    bounded = identification.fit(data, delta, bounds={"l11": (-5e-4, 5e-4)})
    assert [str(w)[:23] for w in bounded.warnings if w.code is Code.AT_BOUND] == ["l11 lies at its bound, "]
    drive = FittedEffect(effects.get("backlash", None, delta), np.zeros(1))
    held = identification.fit(replace(data, sigma=500 * data.sigma), delta, "classical", effects=[drive])
    assert Code.HELD_BY_PRIOR in {w.code for w in held.warnings}
    free = identification.fit(data, delta)
    assert not {Code.HELD_BY_PRIOR, Code.AT_BOUND, Code.NEVER_MOVED} & {w.code for w in free.warnings}
    q = data.q.copy()
    q[:, 1] = q[0, 1]
    still = identification.fit(measure(Model(delta, perturb(1), "complete"), q=0.6 * q), delta)
    said = [str(w) for w in still.warnings if w.code is Code.NEVER_MOVED]
    assert len(said) == 1 and said[0].startswith("q2 never moved")
