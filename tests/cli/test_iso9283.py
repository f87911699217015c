"""`pcalib iso9283` from the plan of the test to the record."""

import json
from pathlib import Path

import numpy as np
import pytest

from pcalib.cli import main

ROBOT = str(Path(__file__).parents[2] / "models" / "delta.toml")


@pytest.fixture
def cycles(tmp_path, monkeypatch):
    """Commands of the five poses by the nominal inverse, and 30 cycles that attain them 10 µm too far along x."""
    monkeypatch.chdir(tmp_path)
    assert main(["iso9283", "--poses", "--robot", ROBOT, "-o", "targets.csv"]) == 0
    wanted = np.loadtxt("targets.csv", delimiter=",", skiprows=2)
    from pcalib import compensation
    from pcalib import robot as robots
    from pcalib.data.targets import load_targets, save_commands
    from pcalib.model import Model
    from pcalib.prediction import Conditions

    robot = robots.load(ROBOT)
    found = compensation.compensate(
        Model.nominal(robot), wanted * 1e-3, conditions=Conditions(np.zeros((5, 3)), np.zeros(5), {})
    )
    save_commands("commands.csv", robot, load_targets("targets.csv", robot), found.q, found.status.tolist())
    lines = ["# frame = base", "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,path"]
    for i in range(30):
        for q, x in zip(np.degrees(found.q), wanted, strict=True):
            place = x + [0.010 + 0.001 * (-1) ** i, 0, 0]
            lines.append(",".join([*(f"{v:.4f}" for v in q), *(f"{v:.6f}" for v in place), "up" if i % 2 else "down"]))
    Path("measured.csv").write_text("\n".join(lines) + "\n")
    return wanted


def test_from_poses_to_record(cycles, capsys):
    words = ["iso9283", "measured.csv", "--commands", "commands.csv", "--robot", ROBOT]
    assert main([*words, "--report", "record.html", "--json", "i.json"]) == 0
    found = json.loads(Path("i.json").read_text())
    assert found["ap_um"] == pytest.approx([10] * 5, abs=1e-3)
    assert found["rp_um"] == pytest.approx([1] * 5, abs=1e-3)  # every cycle lies 1 µm from the barycentre
    assert found["vap_um"] == pytest.approx([2] * 5, abs=1e-3)
    assert [d["ad_um"] for d in found["distances"]] == pytest.approx([0] * 5, abs=1e-3)
    assert found["remarks"] == []
    page = Path("record.html").read_text()
    assert "SHA-256" in page and "Pose performance of delta" in page
    assert "AP is 10 µm" in capsys.readouterr().out


def test_rows_that_repeat_no_command_are_refused(cycles, capsys):
    text = Path("measured.csv").read_text().splitlines()
    first = text[2].split(",")
    first[0] = f"{float(first[0]) + 0.1:.4f}"
    Path("measured.csv").write_text("\n".join([*text[:2], ",".join(first), *text[3:]]) + "\n")
    assert main(["iso9283", "measured.csv", "--commands", "commands.csv", "--robot", ROBOT]) == 2
    assert "measured.csv:3: this row repeats none of the commands" in capsys.readouterr().err


def test_what_is_missing_is_said(tmp_path, capsys):
    assert main(["iso9283", "--poses", "--robot", ROBOT]) == 2
    assert "-o targets.csv" in capsys.readouterr().err
    assert main(["iso9283", "--robot", ROBOT]) == 2
    assert "--commands" in capsys.readouterr().err
