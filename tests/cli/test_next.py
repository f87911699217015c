"""Every command ends with the next one, complete; fits have reports; residuals are a table."""

import shlex
from pathlib import Path

import numpy as np
import pytest

from pcalib import cli
from pcalib.data import table

CASE = Path(__file__).resolve().parents[1] / "cases" / "own_delta"


def following(out: str) -> list[str]:
    """The words of the last line, which is the next command."""
    return shlex.split(out.splitlines()[-1].removeprefix("Next: "))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a blank in its name: paths come back quoted."""
    path = tmp_path_factory.mktemp("a folder")
    for name in ("robot.toml", "plain.csv"):
        (path / name).write_text((CASE / name).read_text())
    return path


def test_one_command_leads_to_the_next(folder, monkeypatch, capfd):
    """From a data file to commands by pasting what each command ends with."""
    monkeypatch.setenv("COLUMNS", "80")
    words = ["pcalib", "inspect", str(folder / "plain.csv"), "--robot", str(folder / "robot.toml")]
    visited = []
    while words[1] != "compensate":
        visited.append(words[1])
        assert words[0] == "pcalib" and cli.main(words[1:]) == 0
        words = following(capfd.readouterr().out)
        words = [str(folder / w) if w in ("model.toml", "targets.csv", "commands.csv") else w for w in words]
    assert visited == ["inspect", "fit"]
    (folder / "targets.csv").write_text("x_mm,y_mm,z_mm\n0,0,-450\n0,0,-2000\n")
    assert cli.main(words[1:]) == 0
    assert "1 of 2 targets have a command" in capfd.readouterr().out
    assert cli.main([*words[1:-1], str(folder / "again.csv"), "--strict"]) == 1


def test_a_model_of_another_day_leads_to_what_changed_and_one_of_these_data_to_a_refit(tmp_path, monkeypatch, capfd):
    """Tower 2 slipped between two sessions; and a bound kept the true length of a rod out of a fit."""
    monkeypatch.setenv("COLUMNS", "80")
    session = CASE.parent / "second_session_one_tower"
    for command in ("compare", "diagnose"):
        assert cli.main([command, str(session / "second.csv"), "--model", str(session / "first.model.toml")]) == 0
        out = capfd.readouterr().out
        assert f"pcalib changed {session / 'second.csv'} --model" in out and "compensate" not in out
    bounded, model = CASE.parent / "bound_excludes_truth", tmp_path / "m.toml"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "delta.toml").write_text((bounded / "delta.toml").read_text())
    fit = ["fit", str(bounded / "data.csv"), "--robot", "delta.toml", "--bound", "l11=-0.5,0.5mm"]
    assert cli.main([*fit, "-o", str(model)]) == 0
    capfd.readouterr()
    assert cli.main(["diagnose", str(bounded / "data.csv"), "--model", str(model)]) == 0
    out = capfd.readouterr().out
    assert "the bound on l11 may prevent a better fit" in out
    [line] = [line for line in out.splitlines() if line.startswith("  pcalib fit ")]
    assert cli.main(shlex.split(line)[1:]) == 0
    assert "at the noise" in capfd.readouterr().out


def test_a_fit_has_a_report_of_its_own(folder, capfd):
    report = folder / "fit.html"
    fit = ["fit", str(folder / "plain.csv"), "--robot", str(folder / "robot.toml"), "--report", str(report)]
    assert cli.main(fit) == 0
    page = report.read_text(encoding="utf-8")
    assert page.count("<svg") == 4 and "Calibration of mydelta" in page and "How far off a landing may be" in page
    assert all(f">{name}<" in page for name in ("a31", "b11", "l12", "q2: beta2, p2"))  # on the robot's figure
    assert "http://" not in page and "https://" not in page


def test_residuals_are_a_table_in_units_and_in_noise(folder, capfd):
    model, out = folder / "model2.toml", folder / "r.csv"
    assert cli.main(["fit", str(folder / "plain.csv"), "--robot", str(folder / "robot.toml"), "-o", str(model)]) == 0
    assert cli.main(["compare", str(folder / "plain.csv"), "--model", str(model), "--residuals", str(out)]) == 0
    found = table.read(out)
    size = np.stack([found.numbers(f"residual_{c}_um") for c in "xyz"], axis=1)
    whitened = np.stack([found.numbers(f"residual_{c}_sigmas") for c in ("x", "y", "z", "rx", "ry", "rz")], axis=1)
    np.testing.assert_allclose(whitened[:, :3] * 15.0, size, rtol=0.2)  # σ stated: 15 µm
    np.testing.assert_allclose(found.numbers("times_noise"), np.sqrt(np.mean(whitened**2, axis=1)), rtol=1e-9)
    assert len(found) == 60 and 15 < np.sqrt(np.mean(np.sum(size**2, axis=1))) < 30
