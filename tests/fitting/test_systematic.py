"""What a fit takes up of an instrument whose metre is not a metre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import plan as plans
from bench import simulate, truth
from bench.instrument import Instrument
from pcalib import compensation, prediction, workspace
from pcalib.data import measurement
from pcalib.data.joining import join
from pcalib.errors import InputError
from pcalib.fitting import identification
from pcalib.model import Conditions
from pcalib.uncertainty import assessed, expect

PPM = 10.0


def measured(robot, seed=3, frame="base"):
    errors = truth.draw_errors(robot, 1e-4, np.radians(0.05), seed)
    real = truth.Truth(robot, errors, Instrument(kind="pose", frame=frame))
    plan = plans.make(robot, "random", 60, tools=[(0.0, 0.0, 0.0), (0.0, 0.0, -0.15)], seed=seed)
    return real, simulate.run(real, plan, seed).measurements


def longer(data, ppm):
    """The data as an instrument with a metre that is too long reads them."""
    return replace(data, position=data.position * (1 + ppm * 1e-6))


def covariance(model, q, tool):
    return expect(model, q, Conditions.of(len(q), tool)).components["geometry"]


def test_the_tcp_moves_as_the_stated_scale_says(delta):
    data = measured(delta)[1]
    fit = identification.fit(data, delta)
    moved = identification.fit(longer(data, PPM), delta).model
    q, tool = data.q[:8], np.array([0.0, 0.0, -0.3])
    plain = covariance(assessed(fit), q, tool)
    wide = covariance(assessed(identification.fit(replace(data, sigma_scale=PPM * 1e-6), delta)), q, tool)
    at = Conditions.of(len(q), tool)
    shift = prediction.predict(moved, q, at).position - prediction.predict(fit.model, q, at).position
    assert np.linalg.norm(shift, axis=1).max() > 5e-6
    assert wide - plain == pytest.approx(shift[:, :, None] * shift[:, None, :], rel=0.05, abs=1e-12)  # of some 5e-11


def test_u95_holds_an_instrument_with_a_wrong_metre(delta):
    """Without the certificate's statement it does not: the fit has no residual that would show it."""
    real, data = measured(delta)
    machine, rng = real.machine(), np.random.default_rng(0)
    place = workspace.reachable(delta, 60, rng).pose.x
    inside = []
    for sigma in (0.0, PPM * 1e-6):
        model = assessed(identification.fit(replace(longer(data, 1.5 * PPM), sigma_scale=sigma), delta))
        q = compensation.compensate(model, place, limits=False).q
        stated = expect(model, q, Conditions.of(60, np.zeros(3))).u95
        landing = machine.run(simulate.Commands.of(q))
        inside.append(float(np.mean(np.linalg.norm(landing.tcp - place, axis=1) <= stated)))
    assert inside[0] < 0.7 and inside[1] > 0.93


def test_a_file_states_it(delta, tmp_path):
    data = replace(measured(delta)[1], sigma_scale=5e-6)
    measurement.save(tmp_path / "d.csv", data)
    assert "# sigma_scale_ppm = 5\n" in (tmp_path / "d.csv").read_text()
    assert measurement.load(tmp_path / "d.csv").sigma_scale == pytest.approx(5e-6, rel=1e-12)
    assert join([replace(data, sigma_scale=0.0), data]).sigma_scale == 5e-6


@pytest.mark.parametrize("text", ["-1", "ten", "1e5", "nan"])
def test_no_scale_is_refused(delta, tmp_path, text):
    measurement.save(tmp_path / "d.csv", measured(delta)[1])
    (tmp_path / "d.csv").write_text(f"# sigma_scale_ppm = {text}\n" + (tmp_path / "d.csv").read_text())
    with pytest.raises(InputError, match="scale") as error:
        measurement.load(tmp_path / "d.csv")
    assert error.value.line == 1
