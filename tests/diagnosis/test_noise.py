"""Noise levels: unbiased from replicates and from what is left over; outliers apart from misfit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcalib import rotation
from pcalib.data import replicates
from pcalib.diagnosis import outliers
from pcalib.diagnosis.problem import problem
from pcalib.diagnosis.screen import NUISANCE
from pcalib.diagnosis.tails import tails_of
from pcalib.fitting import identification
from pcalib.fitting import noise_level as noises
from pcalib.model import Model

N, NQ = 60, 3


def blocks(rng, pos=1.0, rot=1.0, joint=0.0, twice=False):
    """Pure noise of N poses in stated units; with `twice` every pose is measured again."""
    G = rng.standard_normal((N, 6, NQ)) * np.r_[np.full(3, 3e4), np.full(3, 1e2)][:, None]
    if twice:
        G[1::2] = G[::2]
    y = rng.standard_normal((N, 6)) * np.r_[np.full(3, pos), np.full(3, rot)]
    y += (G @ (joint * rng.standard_normal((N, NQ, 1))))[..., 0]
    return noises.Blocks(np.ones((N, 6), bool), y, G)


@pytest.fixture(scope="module")
def data(measured):
    """Sixty rows, thirty commands twice."""
    rows, _ = measured()
    rows = rows.take(~rows.check)
    pick = np.repeat(np.arange(30), 2)
    twice = rows.take(pick)
    return replace(twice, pose_id=pick, columns={})


def replicated(data, made, drift=None):
    V = noises.contrasts(data, made.measured, np.zeros((N, 6, 0)) if drift is None else drift)
    level = noises.from_replicates(data, made, V)
    assert level is not None
    return level


def unfitted(made):
    """The equations of residuals to which nothing was fitted."""
    return noises.left_over(made, np.zeros((N, 6, 0)))


def totals(levels):
    """(n, 2) noise of positions and rotations, all told, in stated units."""
    return np.array([[level.sigma_pos / 15e-6, level.sigma_rot / 60e-6] for level in levels])


class TestVarianceComponents:
    def test_from_replicates(self, data):
        got = [replicated(data, blocks(np.random.default_rng(s), 1.5, 0.7, 0, True)) for s in range(60)]
        np.testing.assert_allclose(np.sqrt(np.mean(totals(got) ** 2, axis=0)), [1.5, 0.7], rtol=0.03)
        assert {tuple(np.round(g.dof)) for g in got if not g.sigma_q} == {(90.0, 90.0)}
        assert np.mean([g.sigma_q > 0 for g in got]) < 0.3

    @pytest.mark.parametrize("true", [(0.1, 1.0), (1.0, 0.05)])
    def test_each_class_has_a_scale_of_its_own(self, data, true):
        """However far the stated σ of one is off; and what is not seen is not made up for by the joints."""
        got = [replicated(data, blocks(np.random.default_rng(s), *true, 0, True)) for s in range(40)]
        np.testing.assert_allclose(np.sqrt(np.mean(totals(got) ** 2, axis=0)), true, rtol=0.04)
        assert np.mean([g.sigma_q > 0 for g in got]) < 0.3

    def test_joint_repeatability_is_told_from_the_instrument(self, data):
        joint = 9e-5  # 2.7 noise units at the plate
        got = [replicated(data, blocks(np.random.default_rng(s), 1, 1, joint, True)) for s in range(40)]
        seen = [g for g in got if g.sigma_q]
        assert len(seen) > 30
        np.testing.assert_allclose(np.mean([g.sigma_q for g in seen]), joint, rtol=0.1)

    def test_where_joints_make_all_the_noise_the_instrument_keeps_a_share(self, data):
        """Else what joints cannot do would be held against the robot with a σ of nothing."""
        for seed in range(10):
            made = blocks(np.random.default_rng(seed), 0.05, 1, 3e-4, True)
            level = replicated(data, made)
            assert level.sigma_q > 0 and level.ratio[0] > 0.1 * level.sigma_pos / 15e-6

    def test_from_what_is_left(self, data):
        rng = np.random.default_rng(0)
        Q = np.linalg.qr(rng.standard_normal((6 * N, 120)))[0].reshape(N, 6, 120)
        got = []
        for s in range(150):
            made = blocks(np.random.default_rng(s), 1.3, 1.3)
            hidden = np.einsum("nid,d->ni", Q, 50 * np.random.default_rng(s).standard_normal(120))
            made = replace(made, y=made.y + hidden)
            level = noises.from_rest(data, made, noises.left_over(made, Q))
            assert level is not None
            got.append(level)
        square = totals(got) ** 2
        np.testing.assert_allclose(np.mean(square, axis=0), 1.69, rtol=0.03)
        # the stated degrees of freedom are those of the scatter: var(σ̂²)/σ⁴ = 2/ν
        plain = next(g for g in got if not g.sigma_q)
        np.testing.assert_allclose(np.var(square, axis=0) / 1.69**2, 2 / plain.dof, rtol=0.4)

    def test_drift_between_replicates_is_no_noise(self, data):
        rng = np.random.default_rng(1)
        made = blocks(rng, twice=True)
        drift = np.einsum("n,ij->nij", np.linspace(0, 60, N), np.eye(6))
        shifted = replace(made, y=made.y + drift @ np.ones(6))
        naive, aware = replicated(data, shifted), replicated(data, shifted, drift)
        assert totals([naive])[0, 0] > 1.1 * totals([aware])[0, 0]
        np.testing.assert_allclose(totals([aware])[0], 1.0, rtol=0.2)
        assert aware.dof[0] == pytest.approx(87, abs=1)

    def test_replicates_and_what_is_left_are_pooled_where_they_agree(self, data):
        few = noises.NoiseLevel("replicates", np.ones(2), np.full(2, 20.0), 0.0, 15e-6, 60e-6, (True, True))
        many = replace(
            few, source="residuals", ratio=np.full(2, 1.2), dof=np.full(2, 200.0), sigma_pos=18e-6, sigma_rot=72e-6
        )
        both = noises.pooled(few, many)
        assert both.pooled and both.verified and both.dof[0] == 220
        assert both.ratio[0] ** 2 == pytest.approx((20 + 200 * 1.44) / 220)
        assert both.sigma_pos == pytest.approx(15e-6 * both.ratio[0])
        far = replace(many, ratio=np.full(2, 2.0), sigma_pos=30e-6, sigma_rot=120e-6)
        assert noises.pooled(few, far) is few
        assert noises.pooled(few, None) is few

    def test_replicates_and_what_is_left_share_nothing(self, data):
        """Else their scatter would count twice, and the noise would seem better known than it is."""
        rng = np.random.default_rng(0)
        span = rng.standard_normal((6 * N, 100))
        V = noises.contrasts(data, np.ones((N, 6), bool), np.zeros((N, 6, 0)))
        both = np.linalg.qr(np.hstack([span, V.reshape(6 * N, -1)]))[0].reshape(N, 6, -1)
        got = []
        for s in range(150):
            made = blocks(np.random.default_rng(s))
            rest = noises.from_rest(data, made, noises.left_over(made, both), enough=20)
            levels = noises.from_replicates(data, made, V), rest
            got.append([totals([level])[0, 0] ** 2 for level in levels])
        assert abs(np.corrcoef(np.transpose(got))[0, 1]) < 0.2
        np.testing.assert_allclose(np.mean(got, axis=0), 1.0, rtol=0.05)

    def test_no_more_freedom_than_there_are_directions(self, measured):
        data, model = measured()
        made = problem(model, data)
        seen = made.screen(n_draws=8)
        assert made.noise.pooled
        known = len(made.y) - np.linalg.matrix_rank(made.nuisance, NUISANCE) - seen.basis.shape[1]
        assert made.noise.dof.sum() < 1.02 * known

    def test_what_was_chosen_to_suit_the_noise_is_made_good(self, data):
        """Of many directions the five that hold most are taken away: what is left looks too quiet by as much."""
        rng = np.random.default_rng(0)
        basis = np.linalg.qr(rng.standard_normal((6 * N, 100)))[0]
        plain, mended = [], []
        for s in range(100):
            made = blocks(np.random.default_rng(s))
            inside = (basis.T @ made.y.ravel()) ** 2
            best = np.argsort(-inside)[:5]
            Q = basis[:, best].reshape(N, 6, 5)
            luck = np.mean([np.sort(np.random.default_rng(i).chisquare(1, 100))[-5:].sum() - 5 for i in range(400)])
            for found, paid in ((plain, 0.0), (mended, float(luck))):
                level = noises.from_rest(data, made, noises.left_over(made, Q, paid))
                assert level is not None
                found.append(totals([level]).mean() ** 2)
        assert np.mean(plain) < 0.97
        np.testing.assert_allclose(np.mean(mended), 1.0, atol=0.012)

    @pytest.mark.parametrize("share", [0.0, 1.0, 10.0])
    def test_the_steps_of_encoders_are_counted_where_the_data_know_them(self, data, share):
        """In noise that is a twentieth of what usual steps do, the data decide; large ones are missing physics."""
        usual = 7e-6
        found = []
        for s in range(20):
            rng = np.random.default_rng(s)
            made = blocks(rng)
            size = 20 / np.sqrt(np.mean(made.per_joint()))
            joint = made.joint * size / usual  # of the usual steps: twenty times the noise
            off = share * usual * np.einsum("nij,nj->ni", joint, rng.standard_normal((N, joint.shape[-1])))
            made = replace(made, joint=joint, y=made.y + off * made.measured)
            level = replace(noises.as_stated(data), source="residuals", dof=np.full(2, 100.0))
            found.append(noises.with_steps(level, made, unfitted(made), usual).steps / usual)
        assert np.mean(found) == pytest.approx(min(share, noises.FINEST), abs=0.15)

    def test_steps_are_the_usual_ones_where_the_data_do_not_know_them(self, data):
        made = blocks(np.random.default_rng(0))
        small = 0.02 / np.sqrt(np.mean(made.per_joint()))
        level = replace(noises.as_stated(data), source="residuals", dof=np.full(2, 100.0))
        rest = unfitted(made)
        got = noises.with_steps(level, made, rest, small)
        assert got.steps == pytest.approx(small, rel=0.05) and got.ratio == pytest.approx(np.ones(2), abs=1e-3)
        assert noises.with_steps(replace(level, sigma_q=1e-5), made, rest, small).steps == 0

    def test_by_how_much_the_rest_exceeds_replicates(self):
        few = noises.NoiseLevel("replicates", np.ones(2), np.full(2, 50.0), 0.0, 1e-5, 1e-5, (True, True))
        more = replace(few, source="residuals", sigma_pos=1.2e-5, sigma_rot=1.2e-5)
        assert noises.excess(few, more) == pytest.approx(np.sqrt(2) * np.log(1.44) / np.sqrt(0.08))
        assert noises.excess(few, few) == noises.excess(few, None) == 0.0
        rng = np.random.default_rng(0)  # a standard normal variable where both are of one noise
        a, b = (np.sqrt(rng.chisquare(50, 2000) / 50) for _ in range(2))
        levels = [[replace(few, sigma_pos=x, sigma_rot=x) for x in one] for one in (a, b)]
        z = [noises.excess(one, other) for one, other in zip(*levels, strict=True)]
        assert np.std(z) / np.sqrt(2) == pytest.approx(1.0, abs=0.08)

    def test_whitening(self):
        rng = np.random.default_rng(0)
        made = blocks(rng)
        level = noises.NoiseLevel("replicates", np.array([1.5, 0.5]), np.full(2, 90.0), 4e-5, 1.0, 1.0, (True, True))
        T = noises.whitener(level, made)
        sigma = np.diag([1.5**2] * 3 + [0.5**2] * 3) + (4e-5) ** 2 * made.joint[7] @ made.joint[7].T
        np.testing.assert_allclose(T[7] @ sigma @ T[7].T, np.eye(6), atol=1e-10)

    def test_a_few_rotations_do_not_cost_the_replicates_of_positions(self, measured):
        """A class of which too little is known keeps its stated σ, and the sentence says so."""
        rows, model = measured()
        group = replicates.groups(rows)
        few = np.flatnonzero((group >= 0) & ~rows.check)[:6]
        mask, turn = rows.mask.copy(), np.full_like(rows.rotation, np.nan)
        mask[:, 3:] = False
        mask[few, 3:], turn[few] = True, rows.rotation[few]
        level = problem(model, replace(rows, mask=mask, rotation=turn)).noise
        assert level.verified and level.dof[0] > 100 and np.isinf(level.dof[1])
        assert level.ratio[0] == pytest.approx(1.0, abs=0.1) and level.ratio[1] == 1.0
        assert "of rotations too few are repeated" in level.sentence()

    @pytest.mark.parametrize(
        ("stated", "said"),
        [
            ((True, True), "60 µrad per component as the file states. "),
            ((False, False), "60 µrad per component assumed, as the file states none. "),
            ((True, False), "60 µrad per component as the file states, that of rotations assumed. "),
            ((False, True), "60 µrad per component as the file states, that of positions assumed. "),
        ],
    )
    def test_the_sentence_says_which_sigma_is_assumed(self, data, stated, said):
        assert (
            f"100 µm and {said}"
            in noises.as_stated(
                replace(data, stated=stated, sigma=np.tile([1e-4] * 3 + [6e-5] * 3, (len(data), 1)))
            ).sentence()
        )

    def test_too_few_replicates_are_none(self, data):
        few = data.take(slice(0, 4))
        small = noises.Blocks(np.ones((4, 6), bool), np.ones((4, 6)), np.zeros((4, 6, 3)))
        V = noises.contrasts(few, small.measured, np.zeros((4, 6, 0)))
        assert noises.from_replicates(few, small, V) is None


class TestOutliers:
    def test_gross_rows_are_found_and_good_ones_kept(self):
        rng = np.random.default_rng(3)
        Q = np.linalg.qr(rng.standard_normal((600, 200)))[0]
        row = np.repeat(np.arange(100), 6)
        y = 2.5 * rng.standard_normal(600) + Q @ rng.standard_normal(200) * 100
        assert len(outliers.find(y, Q, row, 100).rows) == 0
        y[row == 17] += 60
        y[row == 80] -= 40
        found = outliers.find(y, Q, row, 100)
        assert sorted(found.rows) == [17, 80] and not found.too_many

    def test_a_reading_somewhat_off_does_not_hide_a_pose_far_off(self):
        """Per reading the single one is farther off; but one in a thousand is, and never six together."""
        row = np.concatenate([np.repeat(np.arange(50), 6), 50 + np.arange(10)])
        for seed in range(5):
            y = np.random.default_rng(seed).standard_normal(len(row))
            y[row == 3] += 4.0
            y[row == 55] = 4.5
            assert 3 in outliers.find(y, np.zeros((len(y), 0)), row, 60).rows

    def test_many_are_no_outliers(self):
        rng = np.random.default_rng(3)
        Q = np.linalg.qr(rng.standard_normal((600, 50)))[0]
        row = np.repeat(np.arange(100), 6)
        y = rng.standard_normal(600)
        y[row < 12] += 80
        assert outliers.find(y, Q, row, 100).too_many

    def test_they_are_set_aside_and_named_by_line(self, measured):
        data, model = measured()
        position = data.position.copy()
        position[[11, 40]] += 1e-3
        made = problem(model, replace(data, position=position))
        assert sorted(made.set_aside) == [11, 40]
        assert len(made.data) == (~data.check).sum() - 2
        assert made.noise.ratio[0] < 1.2


def test_a_turn_that_moves_the_tool_point_is_told_from_noise_of_its_own(delta, measure, perturb):
    """Rotations err by ω, and positions that are computed from them by ω × t at the lever t of the tool."""
    model = Model(delta, perturb(3), "complete")
    data = measure(model, 120, 4, tools=(0.0, 0.15, 0.3))
    rng = np.random.default_rng(8)
    turn = 2e-4 * rng.standard_normal((len(data), 3))
    arm = (data.rotation @ data.tool[..., None])[..., 0]
    seen = replace(data, position=data.position + np.cross(turn, arm), rotation=rotation.exp(turn) @ data.rotation)
    fitted = identification.fit(seen, delta).model
    level = problem(fitted, seen).noise
    assert level.lever == pytest.approx(2e-4, rel=0.25)
    assert "state the reflectors" in level.sentence()
    assert problem(identification.fit(data, delta).model, data).noise.lever == 0.0


def test_heavy_tails_are_measured_and_a_misfit_of_all_rows_has_none():
    rng = np.random.default_rng(6)
    assert tails_of(rng.standard_normal(600), 600, 4.0) == 1.0
    assert tails_of(3 * rng.standard_normal(600), 600, 4.0) == 1.0
    heavy = rng.laplace(size=(400, 300))  # kurtosis 6: the variance of a square sum is 2.5 times that of normal noise
    assert np.mean([tails_of(z, 300, 0.0) for z in heavy]) == pytest.approx(2.5, abs=0.25)
    square = np.sum(heavy**2, axis=1) / np.var(heavy)
    assert np.var(square) / (2 * 300) == pytest.approx(2.5, rel=0.3)


def test_clipping_keeps_the_signal_and_takes_noise_away(delta, measure, perturb):
    """A drift of the base beside Student noise of three degrees of freedom: what is left of it keeps its size."""
    model = Model(delta, perturb(5), "complete")
    hours = np.linspace(0, 1, 150)
    data = measure(model, 150, 9, tools=(0.0, 0.2), noise=0.0, columns={"time": 3600 * hours})
    rng = np.random.default_rng(4)
    noise = rng.standard_t(3, (150, 3)) / np.sqrt(3)
    moved = data.position + 2e-5 * noise + np.outer(hours, [5e-5, 0, 0])
    turn = rotation.exp(6e-5 * rng.standard_t(3, (150, 3)) / np.sqrt(3))
    seen = replace(data, position=moved, rotation=turn @ data.rotation)
    made = problem(identification.fit(seen, delta).model, seen)
    assert made.tails is not None and made.tails.widened > 1
    drift = next(c for c in made.candidates if c.name == "base_drift")
    theta, _ = made.screen(64).estimate([made.candidates.index(drift)])
    assert 3600 * theta[0][0] == pytest.approx(5e-5, abs=1.5e-5)
