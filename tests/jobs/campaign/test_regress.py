"""Regressions: what is injected is caught and named, what is not there is not."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bench.cli import main
from bench.jobs.campaign import regress, regress_report, spec
from bench.jobs.campaign.regress import CampaignFigure, FigureChange

ROOT = Path(__file__).parents[3]


@pytest.fixture
def held(written, tmp_path) -> list[str]:
    """Arguments of `pcbench` that compare the small campaign with a fresh baseline of it, accuracy only."""
    spec_file = written(robots="robots = 3", poses="poses = 30")
    arguments = ["regress", str(spec_file), "--baseline", str(tmp_path / "base.json"), "--no-speed"]
    assert main([*arguments, "--update", "--reason", "first"]) == 0
    return arguments


def patched(code: str, arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """`pcbench` in a process of its own, with a fault put into the real code first."""
    program = f"import sys\n{code}\nfrom bench.cli import main\nsys.exit(main())"
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_nothing_changed(held, capsys):
    capsys.readouterr()
    assert main(held) == 0
    assert capsys.readouterr().out == "small: 20 figures, all as in the baseline\n"


SIGN_IN_A_JACOBIAN = """
import os
os.environ["PCALIB_NATIVE"] = "0"
from pcalib.mechanics.actuation import RotaryArms
right = RotaryArms.rows
def wrong(*given):
    rows = right(*given)
    rows[..., 6:9] *= -1
    return rows
RotaryArms.rows = wrong
"""
"""∂f/∂β of the NumPy path with the wrong sign: motor axes are turned the wrong way."""

A_SHORTER_TOOL = """
from bench.jobs.campaign import trial
right = trial.compensation.compensate
def wrong(model, position, tool=0.0, **more):
    conditions = more["conditions"]
    more["conditions"] = type(conditions)(conditions.tool * [1, 1, 0.999], conditions.payload, conditions.columns)
    return right(model, position, **more)
trial.compensation.compensate = wrong
"""
"""Commands for tools that are 0.1 % shorter."""


def test_a_sign_in_a_jacobian(held, tmp_path):
    files = {"--junit": "j.xml", "--json": "r.json", "--markdown": "s.md"}
    reports = [word for option, name in files.items() for word in (option, str(tmp_path / name))]
    ended = patched(SIGN_IN_A_JACOBIAN, [*held, *reports])
    assert ended.returncode == 1, ended.stderr
    named = [line for line in ended.stdout.splitlines() if "worse" in line]
    assert any("complete, tool 300 mm" in line for line in named)
    cases = ElementTree.parse(tmp_path / "j.xml").getroot().findall(".//testcase")
    failures = [case.get("classname", "") for case in cases if case.find("failure") is not None]
    assert len(cases) == 20 and any("complete" in name for name in failures)
    content = json.loads((tmp_path / "r.json").read_text())
    assert content["regressions"] == len(failures) == sum(f["verdict"] == "worse" for f in content["figures"])
    assert "❌ worse" in (tmp_path / "s.md").read_text() and "| figure | baseline |" in (tmp_path / "s.md").read_text()


def test_only_what_got_worse_is_named(held):
    ended = patched(A_SHORTER_TOOL, held)
    assert ended.returncode == 1
    worse = [line for line in ended.stdout.splitlines() if "worse" in line]
    assert worse and all("tool 300 mm" in line for line in worse)  # the flange itself is as it was


def test_what_got_slower_is_named(written, tmp_path, capsys):
    spec_file, base = written(robots="robots = 1"), tmp_path / "base.json"
    arguments = ["regress", str(spec_file), "--baseline", str(base)]
    assert main([*arguments, "--update", "--reason", "first"]) == 0
    content = json.loads(base.read_text())
    times = {name: figure for name, figure in content["figures"].items() if figure["kind"] == "time"}
    for name, figure in times.items():  # far from what any machine's noise does, both ways
        figure["value"] *= 0.001 if name.startswith("model24") else 1000.0
    base.write_text(json.dumps(content))
    capsys.readouterr()
    assert main(arguments) == 1
    named = [line for line in capsys.readouterr().out.splitlines() if "worse" in line]
    assert times and named and all(line.strip().startswith("model24") and "time" in line for line in named)


def test_an_update_without_speed_keeps_the_times(written, tmp_path):
    spec_file, base = written(robots="robots = 1"), tmp_path / "base.json"
    arguments = ["regress", str(spec_file), "--baseline", str(base), "--update", "--reason", "so"]
    assert main(arguments) == 0
    before = json.loads(base.read_text())["figures"]
    assert main([*arguments, "--no-speed"]) == 0
    assert json.loads(base.read_text())["figures"] == before and any(f["kind"] == "time" for f in before.values())
    written(robots="robots = 1", poses="poses = 15")  # times of another spec are no measure
    assert main([*arguments, "--no-speed"]) == 0
    assert all(f["kind"] != "time" for f in json.loads(base.read_text())["figures"].values())


def test_update_keeps_the_reasons(held, tmp_path, capsys):
    base = tmp_path / "base.json"
    content = json.loads(base.read_text())
    assert [entry["reason"] for entry in content["history"]] == ["first"]
    for figure in content["figures"].values():
        if figure["kind"] == "error":
            figure["value"] *= 1.5  # as if it had been worse
    base.write_text(json.dumps(content))
    capsys.readouterr()
    assert main(held) == 0
    assert "12 better" in capsys.readouterr().out
    assert main([*held, "--update", "--reason", "better priors"]) == 0
    history = json.loads(base.read_text())["history"]
    assert [entry["reason"] for entry in history] == ["first", "better priors"]
    assert len(history[1]["moved"]) == 12
    capsys.readouterr()
    assert main(held) == 0 and "all as in the baseline" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--update"], "--update needs a reason"),
        (["--update", "--reason", "  "], "--update needs a reason"),
        (["--reason", "because"], "--reason goes with --update"),
    ],
)
def test_reasons(held, capsys, more, message):
    assert main([*held, *more]) == 2
    assert message in capsys.readouterr().err


def test_baselines_that_cannot_be_used(held, written, tmp_path, capsys):
    base = tmp_path / "base.json"
    written(robots="robots = 4", poses="poses = 30")
    assert main(held) == 2
    assert "another spec: robots: 3 → 4" in capsys.readouterr().err
    written(written.small + "[regress]\naccuracy = 0.5\n", robots="robots = 3", poses="poses = 30")
    assert main(held) == 0  # tolerances may change
    base.write_text('{"schema": "something else"}')
    assert main(held) == 2
    assert "is no baseline" in capsys.readouterr().err
    base.unlink()
    assert main(held) == 2
    assert 'make one with --update --reason "first baseline"' in capsys.readouterr().err


def test_verdicts(written):
    campaign = spec.load(written(written.small + "[regress]\naccuracy = 0.02\nfloor_um = 0.01\nspeed = 1.5\n"))

    def verdict(kind: str, before: float | None, now: float | None) -> str:
        old, new = ({} if value is None else {"x": CampaignFigure("x", kind, value)} for value in (before, now))
        (change,) = regress.compare(old, new, campaign)
        return change.verdict

    assert verdict("error", 1e-4, 1.019e-4) == "same" and verdict("error", 1e-4, 1.03e-4) == "worse"
    assert verdict("error", 1e-4, 0.97e-4) == "better"
    assert verdict("error", 1e-12, 5e-9) == "same"  # below the floor
    assert verdict("error", 1e-4, math.nan) == "worse" and verdict("error", math.nan, 1e-4) == "better"
    assert verdict("failed", 0, 1) == "worse" and verdict("failed", 2, 1) == "better"
    assert verdict("reached", 1.0, 0.99) == "worse" and verdict("reached", 0.9, 1.0) == "better"
    assert verdict("time", 1.0, 1.49) == "same" and verdict("time", 1.0, 1.6) == "worse"
    assert verdict("time", 1.0, 0.6) == "better" and verdict("time", 0.01, 0.09) == "same"
    assert verdict("error", None, 1.0) == "new" and verdict("error", 1.0, None) == "gone"


def test_tools_that_differ_by_little_have_figures_of_their_own(written):
    text = written.small.replace('[[method]]\nname = "complete"\n', "")
    campaign = spec.load(written(text, robots="robots = 1", tools_mm="tools_mm = [300.0001, 300.0002]"))
    assert len(regress.measure(campaign, speed=False)) == 10


def test_figures_of_one_name_do_not_pass(written, monkeypatch):
    monkeypatch.setattr(regress, "_name", lambda group, paths: group.method)  # of two tools
    with pytest.raises(AssertionError, match="hide each other"):
        regress.measure(spec.load(written(robots="robots = 1")), speed=False)


def test_a_figure_that_is_gone_is_a_regression():
    changes = [FigureChange("a: RMS", "error", 1e-4, None, "gone"), FigureChange("b: RMS", "error", None, 1e-4, "new")]
    assert changes[0].regression and not changes[1].regression
    assert regress_report.headline(changes) == "2 figures, 1 regression, 1 new"
    assert [row[4] for row in regress_report.table(changes)] == ["gone", "new"]


def test_the_worst_comes_first():
    small = FigureChange("a: RMS", "error", 1e-4, 1.1e-4, "worse")
    large = replace(small, name="b: RMS", now=2e-4)
    better = replace(small, name="c: RMS", now=1e-6, verdict="better")
    rows = regress_report.table([better, small, large])
    assert [row[0][0] for row in rows] == ["b", "a", "c"]
    assert rows[0][1:] == ["100 µm", "200 µm", "+100.0 %", "worse"]


def test_the_workflow_for_users_runs(written, tmp_path, monkeypatch):
    """Its commands, in a folder like that of a user."""
    yaml = pytest.importorskip("yaml")
    steps = yaml.safe_load((ROOT / "docs" / "ci-regression.yml").read_text())["jobs"]["regress"]["steps"]
    (compare,) = [step["run"] for step in steps if "pcbench" in step.get("run", "")]
    (tmp_path / "accuracy").mkdir()
    written(robots="robots = 2").rename(tmp_path / "accuracy" / "spec.toml")
    monkeypatch.chdir(tmp_path)
    words = compare.split()[1:]
    at = words.index("--workers")
    assert main([*words[:at], *words[at + 2 :], "--update", "--reason", "first"]) == 0
    assert main([*words[:at], *words[at + 2 :]]) == 0
    assert all((tmp_path / f"regress.{kind}").stat().st_size for kind in ("xml", "json", "md"))
