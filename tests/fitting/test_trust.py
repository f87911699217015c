"""Doubts about fits that have effects in them."""

from dataclasses import replace

import numpy as np
import pytest

from bench import plan as plans
from bench import simulate
from bench import truth as truths
from bench.kinds import MODELS
from pcalib import robot as robots
from pcalib.cli.fit import start_effect
from pcalib.fitting import identification, trust
from pcalib.kinds import delta

TRUTH = f"""robot = "{MODELS / "delta.toml"}"
[geometry]
sigma_length_mm = 0.1
sigma_angle_deg = 0.05
[instrument]
sigma_pos_mm = 0.02
sigma_rot_deg = 0.005
[faults.thermal_arms]
expansion_ppm_K = 200
[faults.drive_compliance]
compliance_urad_Nm = 60
"""


def test_effects_see_the_conditions_of_the_data():
    """Warm arms and loads are in the columns: doubts are weighed where the data were taken."""
    truth = truths.parse(TRUTH)
    data = simulate.run(truth, plans.make(truth.robot, "rich", 60, seed=1)).measurements
    names = "thermal_arms", "drive_compliance"
    chosen = [start_effect(name, truth.robot, data) for name in names]
    fit = identification.fit(data, truth.robot, effects=chosen)
    assert fit.accuracy.chi2_dof < 1.5 and trust.doubts(fit, data) == []


@pytest.mark.parametrize(
    ("held", "said"),
    [
        (36e-6, "yet with it held there the RMS would be 36 µm instead of 35 µm: so small an error"),
        (216e-6, "and with it held there the RMS would be 216 µm instead of 35 µm: the data do not fit"),
    ],
)
def test_a_change_that_the_data_ask_for_is_no_small_error(held, said):
    doubt = trust.Doubt("radius", 12e-3, 1e-3, "m", 35e-6, held, "", 1e-3)
    assert said in doubt.sentence()


def test_a_kind_with_other_names_is_doubted_alike(monkeypatch):
    """Heights alone leave the scale open; the length of a rod and the motions of base and plate are known by role."""
    truth = truths.parse(TRUTH)
    data = simulate.run(truth, plans.make(truth.robot, "rich", 40, seed=2)).measurements
    data = replace(data, mask=data.mask & (np.arange(6) == 2))

    def said():
        robot = robots.parse(truth.robot.text)
        fit = identification.fit(data, robot)
        return robot.mechanism.parameters[0], [(d.name, d.sigma, d.remedy) for d in trust.doubts(fit, data)]

    def build(dimensions):
        mechanism = delta.build(dimensions)
        other = tuple(f"x{i}" for i in range(60))
        complete = replace(mechanism.levels["complete"], columns=other)
        return replace(mechanism, parameters=other, levels={"complete": complete}, combinations={})

    first, doubts = said()
    monkeypatch.setattr(delta, "KIND", replace(delta.KIND, build=build))
    other, renamed = said()
    assert (first, other) == ("p1.x", "x0") and doubts
    assert [d[1:] for d in renamed] == [d[1:] for d in doubts]
