"""How many poses reach an accuracy, against the misses of robots that are measured and calibrated."""

import json

import numpy as np
import pytest

from pcalib import cli, compensation, planning, prediction, workspace
from pcalib.fitting import identification
from pcalib.model import Conditions, Model
from pcalib.uncertainty.poses import reach

SIGMA = np.r_[np.full(3, 2e-5), np.full(3, np.radians(0.005))]
TOOL = np.array([0.0, 0.0, -0.3])


def test_the_predicted_rms_is_realised(delta, perturb, measure):
    found = reach(delta, 30e-6, TOOL, np.zeros((1, 3)), SIGMA)
    q, _ = planning.plan(delta, 40, sigma_pos=SIGMA[0], sigma_rot=SIGMA[3], candidates=400)
    wanted = workspace.reachable(delta, 40, np.random.default_rng(3)).pose.x + TOOL
    conditions, square = Conditions.of(40, TOOL), []
    for seed in range(24):
        truth = Model.nominal(delta).with_geometry(perturb(seed))
        model = identification.fit(measure(truth, seed=seed, q=q), delta, prior_scale=1.0).model
        made = compensation.compensate(model, wanted, conditions=conditions, limits=False).q
        square.append(np.sum((prediction.predict(truth, made, conditions).position - wanted) ** 2, axis=1).mean())
    assert np.sqrt(np.mean(square)) == pytest.approx(found.rms[found.counts.index(40)], rel=0.1)


def test_no_number_of_positions_at_the_plate_reaches_a_long_tool(delta, tmp_path, capfd):
    robot, out = str(tmp_path / "r.toml"), tmp_path / "p.csv"
    (tmp_path / "r.toml").write_text(delta.text)
    ask = ["plan", "--robot", robot, "--within", "30um", "--position-only", "-o", str(out)]
    assert cli.main([*ask, "--tool", "0,0,0mm", "--json", str(tmp_path / "p.json")]) == 0  # at the plate it does
    said = json.loads((tmp_path / "p.json").read_text())
    assert said["poses"] == said["poses_needed"] and out.exists()
    sigma = np.r_[SIGMA[:3], np.full(3, np.inf)]
    found = reach(delta, 30e-6, TOOL, np.zeros((1, 3)), sigma)
    assert found.poses is None and found.limit > 500e-6 and found.sigma is None and found.with_rotations
    assert cli.main([*ask, "--sigma-pos", "5mm"]) == 1
    assert "No number of poses" in capfd.readouterr().out
