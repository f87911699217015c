"""The tracked body on the plate: its place is known as the file says, and its axes are tried where a fit needs them."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import effects, rotation
from pcalib.data import measurement
from pcalib.data.joining import join
from pcalib.data.measurement import TARGET_STATED, TARGET_UNSTATED
from pcalib.fitting import identification
from pcalib.fitting.result import Code
from pcalib.model import FittedEffect, Frame, Model

STANDS = Frame(rotation.exp(np.array([0.3, -0.5, 2.6])), np.array([2.5, -1.0, 0.8]))
TOOLS = np.array([[0.0, 0.0, 0.0], [0.06, 0.0, -0.1], [0.0, -0.06, -0.2]])


@pytest.fixture(scope="module")
def truth(delta, perturb):
    return replace(Model.nominal(delta), k=perturb(5, 0.2, 0.1), frame=STANDS)


def away(found) -> bool:
    return Code.TARGET_AWAY in {w.code for w in found.warnings}


def test_a_target_takes_up_no_missing_effect(truth, measure):
    """Drives that give way turn the plate as a target 5–20 mm off would: commands then miss by three times u95."""
    soft = effects.parse("drive_compliance", truth.robot)
    loaded = replace(truth, effects=(FittedEffect(soft, np.array([4e-5]), "drive_compliance"),))
    payload = np.array([0.0, 1.5, 3.0])[np.arange(72) % 3]
    data = measure(loaded, 72, seed=1, tools=TOOLS, payload=payload)
    found = identification.fit(data, truth.robot)
    assert np.abs(found.model.frame.offset).max() < 2 * TARGET_STATED and away(found)
    anywhere = identification.fit(replace(data, sigma_target=1.0), truth.robot)
    assert np.abs(anywhere.model.frame.offset).max() > 5 * TARGET_STATED
    assert anywhere.accuracy.chi2_dof < found.accuracy.chi2_dof  # the misfit is shown, not taken up


def test_a_target_that_is_not_where_the_file_says_is_named(truth, measure):
    off = np.array([0.02, -0.03, 0.01])
    moved = replace(truth, frame=replace(STANDS, offset=off))
    data = measure(moved, 72, seed=2, tools=TOOLS, noise=0.1, stated=0.1)
    named = identification.fit(data, truth.robot)
    assert away(named) and any("sigma_target_mm" in str(w) for w in named.warnings)
    told = identification.fit(replace(data, sigma_target=0.05), truth.robot)
    assert not away(told) and np.abs(told.model.frame.offset - off).max() < 8e-3
    alarms = [away(identification.fit(measure(truth, 72, seed=s, tools=TOOLS), truth.robot)) for s in range(8)]
    assert not any(alarms)


def test_what_is_stated_of_the_target_is_kept(truth, measure, tmp_path):
    data = measure(truth, 12, tools=TOOLS)
    assert data.target_known == TARGET_STATED
    assert measure(truth, 12).target_known == TARGET_UNSTATED
    told = replace(data, sigma_target=2e-4)
    measurement.save(tmp_path / "d.csv", told)
    assert "# sigma_target_mm = 0.2\n" in (tmp_path / "d.csv").read_text()
    assert measurement.load(tmp_path / "d.csv").target_known == pytest.approx(2e-4)
    assert join([data, told]).target_known == 2e-4


@pytest.mark.parametrize("degrees", [0.15, 0.5, 0.8])
def test_a_body_that_is_turned_a_little_is_found(truth, measure, degrees):
    turn = rotation.exp(np.radians(degrees) * np.array([0.6, -0.64, 0.48]))
    plain = measure(truth, 60, seed=3, tools=TOOLS)
    data = replace(plain, rotation=plain.rotation @ turn)
    found = identification.fit(data, truth.robot)
    assert found.accuracy.chi2_dof < 1.4 and found.model.frame.turn is not None
    left = rotation.log((found.model.frame.turn @ turn.T)[None])[0]
    assert np.abs(left).max() < np.radians(0.1)  # a turn of all plate joints looks alike, and their tolerance is 0.05°
    assert identification.fit(plain, truth.robot).model.frame.turn is None
