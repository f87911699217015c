"""Data sets: what is measured, what is left out, the same bytes always; through the program's entry point."""

import json
import subprocess
import sys

import numpy as np
import pytest

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.cli import main
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import rotation
from pcalib.data import measurement
from pcalib.errors import ReachError

TRUTH = f"""robot = "{MODELS / "delta.toml"}"
[geometry]
sigma_length_mm = 0.5
sigma_angle_deg = 0.2
seed = 3
[instrument]
sigma_pos_mm = 0.02
sigma_rot_deg = 0.005
"""


@pytest.fixture
def truth_file(tmp_path):
    file = tmp_path / "truth.toml"
    file.write_text(TRUTH)
    return file


def test_the_measurements_are_the_true_poses_and_noise():
    truth = truths.parse(TRUTH)
    plan = plans.make(truth.robot, "random", 200, tools=[np.zeros(3), np.array([0, 0, -0.3])])
    data = simulate.run(truth, plan, seed=5)
    landing = Machine(truth.robot, truth.values).land(plan.commands.q, plan.commands.tool)
    m = data.measurements
    assert np.array_equal(m.q, plan.commands.q) and np.array_equal(m.tool, plan.commands.tool) and m.sigma_stated
    noise = (m.position - landing.tcp) / 2e-5
    turn = rotation.log(m.rotation @ np.swapaxes(landing.R, 1, 2)) / np.radians(0.005)
    for values in (noise, turn):
        assert abs(values.std() - 1) < 0.1 and np.abs(values).max() < 5
    # The robot is 3 mm off where it should be: the data are of the true robot, not of the nominal one.
    nominal = Machine(truth.robot).land(plan.commands.q, plan.commands.tool).tcp
    assert np.sqrt(np.mean(np.sum((m.position - nominal) ** 2, axis=1))) > 1e-3


def test_workers_do_not_matter():
    text = TRUTH + 'missing_rows = 0.1\nframe = "tracker"\nsigma_joint_deg = 0.001\n'
    drawn = truths.parse(text)
    everything = tuple(faults.typical(drawn.robot, name) for name in faults.names())
    truth = truths.Truth(drawn.robot, drawn.errors, drawn.instrument, everything)
    plan = plans.make(truth.robot, "rich", 150)
    one, two = (simulate.run(truth, plan, 1, workers) for workers in (1, 2))
    for name in ("q", "position", "rotation", "sigma"):
        assert getattr(one.measurements, name).tobytes() == getattr(two.measurements, name).tobytes()


def test_what_is_missing_and_what_is_left_out():
    truth = truths.parse(TRUTH + "missing_rows = 0.2\nmissing_rotations = 0.3\nmissing_components = 0.1\n")
    plan = plans.make(truth.robot, "random", 200)
    data = simulate.run(truth, plan, 2)
    m = data.measurements
    assert len(m) == 200 - len(data.lost) and 20 < len(data.lost) < 65
    assert 0.15 < 1 - m.mask[:, 3].mean() < 0.45 and 0.05 < 1 - m.mask[:, :3].mean() < 0.15
    assert np.array_equal(m.q, plan.commands.q[data.kept])


def test_replicates_differ_by_noise_alone():
    truth = truths.parse(TRUTH)
    m = simulate.run(truth, plans.make(truth.robot, "rich", 120), 3).measurements
    pairs = [np.flatnonzero(m.pose_id == one) for one in np.unique(m.pose_id[m.pose_id >= 0])]
    spread = np.array([m.position[b] - m.position[a] for a, b in pairs]) / (np.sqrt(2) * 2e-5)
    assert 0.7 < spread.std() < 1.3


def test_joint_repeatability_shows_at_the_tcp():
    text = TRUTH.replace("sigma_pos_mm = 0.02", "sigma_joint_mrad = 0.1").replace("sigma_rot_deg = 0.005", "")
    truth = truths.parse(text)
    plan = plans.make(truth.robot, "random", 60)
    data = simulate.run(truth, plan, 1)
    off = np.linalg.norm(data.measurements.position - truth.machine().land(plan.commands.q).tcp, axis=1)
    assert 1e-5 < np.median(off) < 1e-4 and not data.measurements.sigma_stated
    assert np.array_equal(data.measurements.q, plan.commands.q)


def test_a_sigma_of_positions_alone_is_stated(tmp_path):
    """Rotations are read without noise: theirs cannot be stated, that of positions stays."""
    truth = truths.parse(TRUTH.replace("sigma_rot_deg = 0.005", ""))
    data = simulate.run(truth, plans.make(truth.robot, "random", 8), 1).measurements
    measurement.save(tmp_path / "d.csv", data)
    for each in (data, measurement.load(tmp_path / "d.csv", truth.robot)):
        assert each.stated == (True, False)
        assert each.sigma[:, :3] == pytest.approx(2e-5)


def test_a_robot_that_reaches_nothing_says_so():
    truth = truths.parse(TRUTH)
    plan = plans.make(truth.robot, "random", 4)
    plan.commands.q[:] = 2.0
    message = r"4 of 4 commands cannot be carried out .*\n  .* go from -60 to 45 deg; .* or in another unit"
    with pytest.raises(ReachError, match=message):
        simulate.run(truth, plan)


def test_entry_point_writes_data_and_sealed_truth(truth_file, tmp_path, capsys):
    out = tmp_path / "data.csv"
    arguments = ["simulate", str(truth_file), "--plan", "border", "-n", "20", "--check", "5", "--seed", "7"]
    arguments += ["--tool", "0,0,0mm", "--tool", "0,0,-300mm", "-o", str(out), "--json", str(tmp_path / "s.json")]
    assert main(arguments) == 0
    assert "25 poses, 5 of them held out" in capsys.readouterr().out
    first = out.read_bytes()
    data = measurement.load(out, truths.load(truth_file).robot)
    assert len(data) == 25 and data.check.sum() == 5 and data.mask.all() and len(np.unique(data.tool[:, 2])) == 2
    report = json.loads((tmp_path / "s.json").read_text())
    assert report["schema"] == "pcbench.simulate/1" and report["rows"] == 25 and report["not_reached"] == {}
    sealed = truths.load(tmp_path / "data.truth.toml")
    assert np.array_equal(sealed.errors, truths.parse(TRUTH).errors)
    # Without the robot file at hand the sealed truth repeats the data, byte by byte; but not over itself.
    assert main(["simulate", str(tmp_path / "data.truth.toml"), *arguments[2:]]) == 2
    assert "is read, and would be overwritten" in capsys.readouterr().err
    truth_file.with_name("again.truth.toml").write_bytes((tmp_path / "data.truth.toml").read_bytes())
    assert main(["simulate", str(truth_file.with_name("again.truth.toml")), *arguments[2:]]) == 0
    assert out.read_bytes() == first


def test_d_optimal_poses_and_random_ones_to_check(truth_file, tmp_path):
    arguments = ["simulate", str(truth_file), "-n", "20", "--check", "8", "--tool", "0,0,-100mm"]
    found = {}
    for plan in ("d-optimal", "random"):
        assert main([*arguments, "--plan", plan, "-o", str(tmp_path / f"{plan}.csv")]) == 0
        data = measurement.load(tmp_path / f"{plan}.csv", truths.load(truth_file).robot)
        assert data.check.tolist() == [False] * 20 + [True] * 8 and (data.tool[:, 2] == -0.1).all()
        found[plan] = np.ptp(data.q[:20], axis=0)
    assert (found["d-optimal"] > 1.05 * found["random"]).all()  # what tells most lies far out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--check", "-2"], "Must be >= 0"),
        (["--plan", "d-optimal", "-n", "0"], "Must be >= 1"),
        (["--tool", "0,0mm"], "needs 3 numbers"),
        (["--tool", "0,0,5"], "no unit"),
        (["--plan", "zigzag"], "unknown plan 'zigzag'"),
        (["-n", "0"], "Must be >= 1"),
        (["--workers", "0"], "--workers. Must be >= 1"),
        (["--seed", "-1"], "Must be >= 0"),
        (["-o", "/no/such/folder/data.csv"], "cannot write"),
        (["--json", "/no/such/folder/s.json"], "s.json: cannot write: no such folder"),
        (["--payload", "-1kg"], "cannot be negative"),
    ],
)
def test_bad_usage_is_one_message_and_writes_nothing(truth_file, tmp_path, capsys, change, message):
    arguments = ["simulate", str(truth_file), "-o", str(tmp_path / "data.csv"), "-n", "3"]
    for option, value in zip(change[::2], change[1::2], strict=True):
        if option in arguments:
            arguments[arguments.index(option) + 1] = value
        else:
            arguments += [option, value]
    assert main(arguments) == 2
    assert message in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["truth.toml"]


def test_the_truth_is_not_overwritten(truth_file, capsys):
    before = truth_file.read_bytes()
    assert main(["simulate", str(truth_file), "-o", str(truth_file), "-n", "3"]) == 2
    assert "would be overwritten" in capsys.readouterr().err and truth_file.read_bytes() == before


def test_help_is_quick():
    code = "import sys, bench.cli; bench.cli.main(['simulate', '--help']); sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, cwd=MODELS.parent).returncode == 0
