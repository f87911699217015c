"""The headline of a fit: what is noise, what is not, and what was not asked."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib.fitting import identification
from pcalib.fitting.identification import Accuracy
from pcalib.fitting.result import Code
from pcalib.model import Model


@pytest.fixture(scope="module")
def truth(delta, perturb):
    return replace(Model.nominal(delta), k=perturb(20))


@pytest.mark.parametrize("level", ["classical", "model24"])
def test_rotations_that_a_level_leaves_out_are_said(truth, measure, level):
    """They do not count for χ²; where only they are off, nobody may read that all is noise."""
    data = measure(truth, 60)
    within = replace(data, sigma=data.sigma * [50, 50, 50, 1, 1, 1])  # positions explained, rotations 10 σ off
    found = identification.fit(within, truth.robot, level)
    turned = data.mask[:, 3]
    assert found.left_out == pytest.approx(np.sqrt(np.mean((found.error[turned, 3:] / data.sigma[turned, 3:]) ** 2)))
    assert found.left_out > 5
    text = found.headline()
    assert f"rotations left out: {1e6 * found.accuracy.rms_rot:.1f} µrad RMS, {found.left_out:.1f}× their σ" in text
    said = [str(w) for w in found.warnings if w.code is Code.ROTATIONS_LEFT_OUT]
    assert len(said) == 1 and f"{found.left_out:.1f}× their σ" in said[0]
    check = np.arange(60) > 50
    turned = replace(data, check=check, mask=data.mask & (check[:, None] | (np.arange(6) < 3)))  # held out alone
    for other, of_level in ((data, "complete"), (turned, level), (measure(truth, 60, rotations=False), level)):
        plain = identification.fit(other, truth.robot, of_level)
        assert np.isnan(plain.left_out) and "rotations" not in plain.headline()
        assert not any("left out" in str(w) for w in plain.warnings)


def test_noise_is_called_what_it_is(truth, measure):
    said = {
        1.0: ("(at the noise)", "(at the assumed noise)"),
        3.0: ("(far below the stated noise: σ overstated?)", "(far below the assumed noise: σ overstated?)"),
        0.5: ("× the stated noise)", "× the assumed noise)"),
    }
    for size, words in said.items():
        data = measure(truth, 120, stated=size)
        assert data.sigma_stated
        for stated, text in zip((True, False), words, strict=True):
            found = identification.fit(replace(data, stated=(stated, stated)), truth.robot)
            assert text in found.headline()


@pytest.mark.parametrize(("ratio", "dof", "noise"), [(1.13, 20, True), (1.13, 660, False), (1.04, 5000, True)])
def test_many_readings_tell_noise_from_a_little_more(ratio, dof, noise):
    """Within three of its own σ, or the five per cent to which nobody knows an instrument's σ."""
    found = Accuracy(2e-5, 5e-5, 1e-4, ratio**2, dof, 100)
    assert found.at_the_noise == noise
