"""Doubts about fits that have effects in them."""

from bench import plan as plans
from bench import simulate
from bench import truth as truths
from bench.kinds import MODELS
from pcalib.cli.fit import start_effect
from pcalib.fitting import identification, trust

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
    assert fit.fit.chi2_dof < 1.5 and trust.doubts(fit, data) == []
