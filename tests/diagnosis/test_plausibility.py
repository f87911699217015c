"""Sizes that working robots have, and arms that are alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcalib import effects
from pcalib.diagnosis import plausibility
from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.diagnosis.plausibility import Oddity
from pcalib.diagnosis.verdict import Explanation, decide


def judged(spec: str, theta, sigma, delta, **widened):
    effect = effects.parse(spec, delta)
    values = np.asarray(theta, float)
    return plausibility.judge([Hypothesis.of(effect)], [values], [np.broadcast_to(sigma, values.shape)], widened)


@pytest.mark.parametrize("name", effects.names())
def test_the_usual_size_is_plausible_and_a_plausible_one_is_possible(name, delta):
    """Zero is plausible too: an effect that is not there is none that is odd."""
    for p in effects.parse(name, delta).parameters:
        low, high = p.plausible
        assert low <= 0 and p.low <= low < high <= p.high, p.name
        assert 2 * p.prior <= high, p.name


def test_a_size_far_beyond_what_robots_have_is_said_with_both_figures(delta):
    arcsec = np.radians(1 / 3600)
    [odd] = judged("encoder_eccentricity:arm", [0, 0, 872 * arcsec, 0, 0, 0], 1 * arcsec, delta)
    assert odd.oddity is Oddity.FAR
    assert "872 arcsec" in odd.words and "330 arcsec" in odd.words and "q3" in odd.words
    assert not judged("encoder_eccentricity:arm", [0, 0, 872 * arcsec, 0, 0, 0], 300 * arcsec, delta)  # hardly known
    assert not judged("encoder_eccentricity:arm", [0, 0, 872 * arcsec, 0, 0, 0], arcsec, delta, encoder_eccentricity=3)


def test_rods_of_one_material_do_not_shrink_on_two_arms_and_grow_on_the_third(delta):
    """Carbon fibre shrinks by up to 2 ppm/K, so that none of these values is odd by itself."""
    [odd] = judged("thermal_rods:arm", [-1.7e-6, 2.1e-6, -1.7e-6], 2e-7, delta)
    assert odd.oddity is Oddity.UNLIKE and "expansion" in odd.words
    assert not judged("thermal_rods:arm", [1.1e-5, 1.2e-5, 1.3e-5], 2e-7, delta)
    assert not judged("thermal_rods:arm", [-1.7e-6, 2.1e-6, -1.7e-6], 3e-6, delta)  # within the doubt of the fit


def test_arms_that_share_a_value_are_called_unlike_at_the_stated_chance():
    rng = np.random.default_rng(5)
    n, alike = 4000, 0.3
    sigma = rng.uniform(0.02, 0.3, (n, 4))
    values = 1.0 + alike * rng.standard_normal((n, 4)) + sigma * rng.standard_normal((n, 4))
    said = np.mean([plausibility.chance_of_alike(t, s, alike) < 0.05 for t, s in zip(values, sigma, strict=True)])
    assert 0.01 < said < 0.06  # the common value is chosen to suit them, which makes the test a little cautious


def test_what_is_implausible_is_never_established(delta):
    effect = effects.parse("thermal_rods", delta)
    sure = Explanation((Hypothesis.of(effect),), (np.array([1e-5]),), (np.array([1e-6]),), 0.0)
    assert decide([sure])[0] == "established"
    odd = replace(sure, theta=(np.array([9e-5]),))
    odd = replace(odd, implausible=plausibility.judge(odd.members, odd.theta, odd.sigma))
    assert odd.implausible and decide([odd]) == ("ambiguous", ())
