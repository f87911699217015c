"""Laws and plans that tell effects apart, as a user runs them: `propose`, `diagnose`, `plan --to-tell`."""

import json
from pathlib import Path

import pytest

from pcalib.cli import main

ROOT = Path(__file__).parents[2]
CASES = ROOT / "tests" / "cases" / "own_delta"


def test_a_plan_says_which_effects_it_tells_apart(tmp_path, capsys):
    plan, out, plot = tmp_path / "plan.csv", tmp_path / "s.json", tmp_path / "s.svg"
    asked = ["plan", "--to-tell", "backlash", "drive_compliance", "arm_bending", "-n", "30", "-o", str(plan)]
    beside = ["--json", str(out), "--plot", str(plot)]
    assert main([*asked, "--robot", str(ROOT / "models" / "delta.toml"), *beside]) == 0
    said = capsys.readouterr().out
    assert "arm_bending and drive_compliance do the same" in said or "drive_compliance and arm_bending do" in said
    content = json.loads(out.read_text())
    assert content["schema"] == "pcalib.separation/1" and len(content["separation"]) == 3
    header = plan.read_text().splitlines()[1].split(",")
    assert {"payload_kg", "dir1", "pose_id", "time_s"} <= set(header)
    assert len(plan.read_text().splitlines()) == 32
    assert plot.read_text().startswith("<?xml") or "<svg" in plot.read_text()


def test_conditions_of_a_plan_to_tell_are_refused_elsewhere(tmp_path, capsys):
    robot = str(ROOT / "models" / "delta.toml")
    assert main(["plan", "--robot", robot, "-n", "8", "-o", str(tmp_path / "p.csv"), "--payload", "2kg"]) == 2
    assert "belongs to --to-tell" in capsys.readouterr().err


@pytest.mark.parametrize("unit", ["kg", "degC"])
def test_quantities_carry_their_unit(tmp_path, capsys, unit):
    option = {"kg": "--payload", "degC": "--temperature"}[unit]
    robot = str(ROOT / "models" / "delta.toml")
    words = ["plan", "--to-tell", "--robot", robot, "-n", "30", "-o", str(tmp_path / "p.csv"), option, "2"]
    assert main(words) == 2
    assert unit in capsys.readouterr().err


def test_a_proposed_law_is_written_and_added(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data, robot = str(CASES / "elbow.csv"), str(CASES / "robot.toml")
    assert main(["fit", data, "--robot", robot, "-o", "m.toml"]) == 0
    capsys.readouterr()
    assert main(["propose", data, "--model", "m.toml", "-o", "laws", "--json", "p.json"]) == 0
    said = capsys.readouterr().out
    command = next(line for line in said.splitlines() if line.startswith("Next: pcalib add "))
    assert "elbows along their arm by the next arm's angle" in said
    spec = json.loads(Path("p.json").read_text())["laws"][0]["spec"]
    assert command == f"Next: pcalib add {spec} {data} --model m.toml"
    assert main(["effect", "check", spec, "--robot", robot]) == 0
    assert main(command.removeprefix("Next: pcalib ").split()) == 0
    assert "107" in capsys.readouterr().out


def test_a_diagnosis_names_the_law_that_no_effect_stands_for(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data, robot = str(CASES / "elbow.csv"), str(CASES / "robot.toml")
    assert main(["fit", data, "--robot", robot, "-o", "m.toml"]) == 0
    capsys.readouterr()
    assert main(["diagnose", data, "--model", "m.toml", "--json", "d.json"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "The simplest law that explains what is left: elbows along their arm by the next arm's angle" in said
    assert f"Next: pcalib propose {data} --model m.toml -o laws" in said
    found = json.loads(Path("d.json").read_text())
    assert found["verdict"] == "unexplained" and found["laws"][0]["channel"] == "elbow"


def test_no_law_is_searched_for_where_nothing_is_missing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data, robot = str(CASES / "plain.csv"), str(CASES / "robot.toml")
    assert main(["fit", data, "--robot", robot, "-o", "m.toml"]) == 0
    assert main(["diagnose", data, "--model", "m.toml", "--json", "d.json"]) == 0
    found = json.loads(Path("d.json").read_text())
    assert found["verdict"] == "nothing_missing" and found["laws"] == []
