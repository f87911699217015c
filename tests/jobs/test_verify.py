"""A model judged by landing the robot: known truths give known figures; checks decide the exit code."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench import cli, faults, simulate
from bench import truth as truths
from bench.commands import Commands
from bench.instrument import Instrument
from bench.jobs import verify
from bench.plan import Plan
from bench.truth import Truth
from pcalib import compensation, effects, modelfile
from pcalib.errors import InputError, ReachError
from pcalib.mechanics import kinematics
from pcalib.model import FittedEffect, Model

TOOL = np.array([0.0, 0.0, -0.3])


@pytest.fixture(scope="module")
def truth(delta) -> Truth:
    return Truth(delta, truths.draw_errors(delta, 3e-4, np.radians(0.1), 2), Instrument())


@pytest.fixture(scope="module")
def task(delta) -> verify.Task:
    full = verify.grid_task(delta, TOOL)
    rows = np.arange(0, len(full.position), 9)
    return verify.Task(full.position[rows], None, full.conditions.take(rows))


def perfect(truth: Truth, **more) -> Model:
    return Model(truth.robot, truth.values, "complete", **more)


def test_the_true_model_lands_exactly(truth, task):
    done = verify.run(perfect(truth), truth, task)
    assert done.accuracy.max < 1e-12 and done.alike and done.failed == 0
    assert done.attained.shape == (1, len(task.position), 3)


def test_the_nominal_model_misses_as_the_forward_kinematics_say(truth, task, delta):
    done = verify.run(Model.nominal(delta), truth, task)
    nominal = delta.mechanism.nominal
    commanded = kinematics.inverse(delta.mechanism, nominal, task.position, tool=TOOL)
    landed = kinematics.forward(delta.mechanism, truth.values, commanded.q).pose.tcp(TOOL)
    assert done.attained[0] == pytest.approx(landed, abs=1e-10)
    expected = np.linalg.norm(landed - task.position, axis=1)
    assert done.accuracy.rms == pytest.approx(np.sqrt(np.mean(expected**2)))
    assert done.accuracy.ap == pytest.approx(expected, abs=1e-10)


def test_first_order_is_as_good_as_its_order(delta, task):
    """Five times the errors leave 25 times the rest (paper eqs 29–33)."""
    rest = []
    for size in (1.0, 5.0):
        truth = Truth(delta, truths.draw_errors(delta, size * 1e-4, size * 1e-3, 2), Instrument())
        rest.append(verify.run(perfect(truth), truth, task, method="first-order").accuracy.rms)
    assert rest[1] / rest[0] == pytest.approx(25, rel=0.15)


def test_drives_that_do_not_repeat_show_in_rp_as_their_jacobian_says(truth, task, delta):
    sigma = np.radians(0.002)
    noisy = replace(truth, instrument=Instrument(sigma_joint=sigma))
    done = verify.run(perfect(truth), noisy, task, cycles=30)
    again = verify.run(perfect(truth), noisy, task, cycles=30)
    assert np.array_equal(done.attained, again.attained)
    assert done.attained.shape[0] == 30 and not done.alike
    # Covariance of the TCP by central differences of the forward kinematics.
    q = kinematics.inverse(delta.mechanism, truth.values, task.position, tool=TOOL).q
    J = np.stack([
        (at(delta, truth.values, q + h) - at(delta, truth.values, q - h)) / 2e-6 for h in 1e-6 * np.eye(3)
    ], axis=-1)  # fmt: skip
    variance = sigma**2 * np.sum(J**2, axis=(1, 2))
    assert done.accuracy.rms == pytest.approx(np.sqrt(variance.mean()), rel=0.05)
    assert 2 < np.median(done.accuracy.rp / np.sqrt(variance)) < 2.6  # 2.09 for 3D noise alike in all directions


def test_drives_do_not_repeat_what_they_did_while_measuring(truth, task):
    """With one seed for both, a model fitted to few poses would be judged by the very noise in its data."""
    noisy = replace(truth, instrument=Instrument(sigma_joint=1e-4))
    done = verify.run(perfect(truth), noisy, task, cycles=1, seed=3)
    q = compensation.compensate(perfect(truth), task.position, conditions=task.conditions).q
    measured = simulate.run(noisy, Plan(Commands.of(q, TOOL), np.full(len(q), -1), np.zeros(len(q), bool), "x"), seed=3)
    miss = [(found - task.position).ravel() for found in (done.attained[0], measured.landing.tcp)]
    assert miss[0].std() == pytest.approx(miss[1].std(), rel=0.3)
    assert abs(np.corrcoef(miss)[0, 1]) < 0.4


def at(delta, k, q):
    return kinematics.forward(delta.mechanism, k, q).pose.tcp(TOOL)


def test_an_effect_in_the_model_takes_its_fault_out(truth, task):
    """Backlash of 0.4 mrad: a model that knows it is told from which side a target is approached."""
    gap = 4e-4
    loose = replace(truth, faults=(faults.make(truth.robot, "backlash", {"gap_mrad": gap * 1e3}),))
    effect = effects.parse("backlash", truth.robot)
    known = perfect(truth, effects=(FittedEffect(effect, np.full(len(effect.parameters), gap)),))
    without, with_effect = (verify.run(m, loose, task, cycles=6).accuracy for m in (perfect(truth), known))
    assert without.rms > 5e-5 and without.rp.mean() > 5e-5
    assert with_effect.rms < 2e-8 and with_effect.rp.max() < 1e-7


def test_temperature_is_told_to_both(truth, task):
    warm = replace(truth, faults=(faults.make(truth.robot, "thermal_rods", {"expansion_ppm_K": 12.0}),))
    effect = effects.parse("thermal_rods", truth.robot)
    known = perfect(truth, effects=(FittedEffect(effect, np.full(len(effect.parameters), 12e-6)),))
    assert verify.run(perfect(truth), warm, task, cycles=1).accuracy.max < 1e-9
    assert verify.run(perfect(truth), warm, task, cycles=1, temperature=30.0).accuracy.rms > 5e-5
    assert verify.run(known, warm, task, cycles=1, temperature=30.0).accuracy.max < 1e-8


def test_what_is_not_reached_is_counted_and_left_out(truth, task):
    position = np.vstack([task.position, [[0.0, 0.0, -3.0]]])
    far = verify.Task(position, None, verify.Conditions.of(len(position), TOOL))
    done = verify.run(perfect(truth), truth, far)
    assert done.failed == 1 and done.reasons == {"outside_workspace": 1}
    assert done.accuracy.max < 1e-12
    with pytest.raises(ReachError, match="no target was reached"):
        verify.run(perfect(truth), truth, verify.Task(far.position[-1:], None, verify.Conditions.of(1, TOOL)))


def test_a_model_of_another_robot_is_refused(truth, task, delta):
    from pcalib import robot as robots

    other = robots.load(Path(__file__).parents[2] / "models" / "delta_small.toml")
    with pytest.raises(InputError, match="nominal dimensions differ"):
        verify.run(Model.nominal(other), truth, task)


@pytest.fixture
def files(truth, tmp_path) -> list[str]:
    """A model that is 0.1 mm short in one rod, its truth, and targets with a tool column."""
    k = truth.values.copy()
    k[truth.robot.mechanism.index("l11")] += 1e-4
    modelfile.save(tmp_path / "m.toml", Model(truth.robot, k, "complete"))
    (tmp_path / "t.toml").write_text(truths.dumps(truth))
    near = "x_mm,y_mm,z_mm\n0,0,-1100\n100,-50,-1150\n"
    (tmp_path / "near.csv").write_text(near)
    (tmp_path / "targets.csv").write_text(near + "0,0,-3000\n")
    return [str(tmp_path / "m.toml"), str(tmp_path / "t.toml")]


def test_command_figures_and_exit_codes(files, tmp_path, capsys):
    out = tmp_path / "v.json"
    targets = ["--targets", str(tmp_path / "targets.csv"), "--tool", "0,0,-300mm"]
    assert cli.main(["verify", *files, *targets, "--json", str(out)]) == 0
    text = capsys.readouterr().out
    found = json.loads(out.read_text())
    (tool,) = found["tools"]
    assert found["schema"] == "pcbench.verify/1" and found["held"] and found["checks"] == []
    assert (tool["targets"], tool["failed"], tool["tool"]) == (3, 1, "tool 300 mm")
    assert 10 < tool["rms_um"] < 500 and tool["rp_max_um"] == 0
    assert "1× outside_workspace" in text and text.startswith("By model m.toml the TCP lands within")
    rms = tool["rms_um"]
    targets[1] = str(tmp_path / "near.csv")
    assert cli.main(["verify", *files, *targets, "--max-rms", f"{1.01 * rms}um", "--max", "1.5mm"]) == 0
    said = capsys.readouterr().out
    assert f"- rms ≤ {1.01 * rms:.4g} µm: holds, found {rms:.4g} µm\n- max ≤ 1.5 mm: holds, found " in said
    assert cli.main(["verify", *files, *targets, "--max-rms", f"{0.99 * rms}um", "--json", str(out)]) == 1
    assert "µm: DOES NOT HOLD, found" in capsys.readouterr().out
    checks = json.loads(out.read_text())["checks"]
    assert [(c["name"], c["unit"], c["held"]) for c in checks] == [
        ("rms", "um", False), ("targets not attained", "1", True)
    ]  # fmt: skip
    assert checks[0]["limit"] == pytest.approx(0.99 * rms) and checks[0]["found"] == pytest.approx(rms)
    assert cli.main(["verify", *files, *targets, "--max-rms-um", str(0.99 * rms)]) == 1  # its former name


def test_a_limit_does_not_hold_where_targets_were_refused(files, tmp_path, capsys):
    """However good the others are, unless they may fail."""
    verify_far = ["verify", *files, "--targets", str(tmp_path / "targets.csv"), "--tool", "0,0,-300mm"]
    for limit in (["--max-rms", "1mm"], ["--max-failed", "0"]):
        assert cli.main([*verify_far, *limit]) == 1
        line = capsys.readouterr().out.splitlines()[-1]
        assert line == "- targets not attained ≤ 0: DOES NOT HOLD, found 1 (1× outside_workspace)"
    assert cli.main([*verify_far, "--max-rms", "1mm", "--max-failed", "1"]) == 0
    assert "targets not attained ≤ 1: holds, found 1 (1× outside_workspace)" in capsys.readouterr().out


def test_command_on_the_grid_with_several_tools(files, capsys):
    assert cli.main(["verify", *files, "--tool", "0,0,0mm", "--tool", "0,0,-100mm", "--max-rp", "0um"]) == 0
    out = capsys.readouterr().out
    assert "tool 0 mm" in out and "tool 100 mm" in out and "one stands for all" in out


def test_bad_input_is_one_message(files, tmp_path, capsys):
    with_tool = tmp_path / "with.csv"
    with_tool.write_text("x_mm,y_mm,z_mm,tool_x_mm,tool_y_mm,tool_z_mm,payload_kg\n0,0,-1100,0,0,-300,1\n")
    for arguments, said in [
        ([files[0], files[0]], "unknown key"),
        ([files[1], files[1]], "not a model file"),
        ([*files, "--cycles", "0"], "Must be >= 1"),
        ([*files, "--tool", "300mm"], "needs 3 numbers"),
        ([*files, "--method", "guess"], "unknown method 'guess'"),
        ([*files, "--payload", "-1kg"], "cannot be negative"),
        ([*files, "--max", "-5um"], "max ≤ -5 µm cannot hold"),
        ([*files, "--max", "5"], "no unit"),
        ([*files, "--max-failed", "-1"], "--max-failed -1 cannot hold"),
        ([*files, "--json", "/no/such/folder/v.json"], "no such folder"),
        ([*files, "--targets", str(with_tool), "--tool", "0,0,-1mm"], "keep one"),
        ([*files, "--targets", str(with_tool), "--payload", "1kg"], "keep one"),
        ([*files, "--targets", str(tmp_path / "none.csv")], "no such file"),
    ]:
        assert cli.main(["verify", *arguments]) == 2
        error = capsys.readouterr().err
        assert said in error and error.startswith("error: "), error
