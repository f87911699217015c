"""The story on the command line: compare, diagnose, explain, add, drop, log, next, effect, join."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.instrument import Instrument
from pcalib import effects, modelfile
from pcalib import robot as robots
from pcalib.cli import main
from pcalib.data import measurement

ROBOT_FILE = Path(__file__).parents[2] / "models" / "delta.toml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data set with soft drives and the model fitted to it."""
    where = tmp_path_factory.mktemp("story")
    robot = robots.load(ROBOT_FILE)
    errors = truths.draw_errors(robot, 1e-4, np.radians(0.05), 3)
    truth = truths.Truth(
        robot, errors, Instrument(sigma_pos=15e-6, sigma_rot=60e-6), (faults.typical(robot, "drive_compliance", 2.0),)
    )
    tools = [np.zeros(3), np.array([0.06, 0.0, -0.2])]
    data = simulate.run(truth, plans.make(robot, "rich", 100, check=25, tools=tools, seed=3), 3).measurements
    measurement.save(where / "data.csv", data)
    assert main(["fit", str(where / "data.csv"), "--robot", str(ROBOT_FILE), "-o", str(where / "m.toml")]) == 0
    return where


@pytest.fixture
def run(folder, monkeypatch, capsys):
    """A function that runs a command in the folder: (code, stdout, stderr)."""
    monkeypatch.chdir(folder)
    capsys.readouterr()

    def call(*argv):
        code = main([str(a) for a in argv])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


def test_compare(run, folder):
    code, out, _ = run(
        "compare", "data.csv", "--model", "m.toml", "--json", "c.json", "--report", "c.html", "--rrd", "c.rrd"
    )
    assert code == 0
    assert out.splitlines()[0].startswith("Model and measurements differ by") and "motor angles by torque" in out
    assert " -0 " not in out and " −0 " not in out
    found = json.loads((folder / "c.json").read_text())
    assert found["schema"] == "pcalib.comparison/1" and found["times_noise"] > 1.05
    assert found["heatmap"][0]["channel"] == "actuator" and len(found["worst"]) == 5
    page = (folder / "c.html").read_text()
    assert page.count("<svg") == 1 and "://" not in page
    assert "<h2>Worst poses</h2>" in page and "rotation RMS" in page and ">z mm</th>" in page
    assert (folder / "c.rrd").stat().st_size > 10_000


def test_compare_lists_only_what_is_more_than_noise(run, folder):
    assert run("add", "drive_compliance", "data.csv", "-m", "m.toml", "-o", "quiet.toml")[0] == 0
    code, out, _ = run("compare", "data.csv", "-m", "quiet.toml")
    assert code == 0 and "No place stands out." in out and "payload × q" not in out


def test_diagnose(run, folder):
    code, out, _ = run("diagnose", "data.csv", "-m", "m.toml", "--json", "d.json", "--report", "d.html")
    assert code == 0
    found = json.loads((folder / "d.json").read_text())
    assert found["schema"] == "pcalib.diagnosis/1" and found["verdict"] in ("established", "ambiguous")
    assert ["drive_compliance"] in found["adequate"]
    soft = next(c for c in found["candidates"] if c["effect"] == "drive_compliance")["parameters"]["compliance"]
    assert (soft["unit"], soft["shown_in"]) == ("rad_Nm", "urad_Nm") and 1e-5 < soft["value"] < 1e-4
    assert out.splitlines()[0] == found["sentence"] or found["sentence"].startswith(out.splitlines()[0])
    page = (folder / "d.html").read_text()
    assert page.count("<svg") == 2 and "Orange: it stands in an explanation" in page
    assert 'class="left text">drives give way under load' in page  # long cells wrap, and none is cut
    assert "…" not in page.partition("All candidates")[2].partition("</table>")[0]


def test_explain(run, folder):
    code, out, _ = run("explain", "drive_compliance", "data.csv", "-m", "m.toml", "--plot", "e.svg", "--json", "e.json")
    assert code == 0 and "drive_compliance explains all there is" in out
    assert (folder / "e.svg").read_text().startswith("<svg xmlns")
    assert json.loads((folder / "e.json").read_text())["in_physical_range"]
    code, out, _ = run("explain", "thermal_rods", "data.csv", "-m", "m.toml")
    assert code == 0 and ("Nothing speaks for" in out or "not enough" in out)


def test_add_log_drop_and_back(run, folder):
    code, out, _ = run("add", "drive_compliance", "data.csv", "-m", "m.toml", "-o", "m2.toml", "--json", "a.json")
    assert code == 0 and "confirmed" in out.splitlines()[0]
    step = json.loads((folder / "a.json").read_text())
    assert step["schema"] == "pcalib.add/1" and step["effect"] == "drive_compliance"
    (soft,) = step["after"]["effects"][0]["parameters"].values()
    assert (soft["unit"], soft["shown_in"]) == ("rad_Nm", "urad_Nm") and 1e-5 < soft["value"] < 1e-4
    assert step["after"]["check"]["rms_pos_um"] < 0.8 * step["before"]["check"]["rms_pos_um"]
    assert step["before"]["schema"] == step["after"]["schema"] == "pcalib.fit/1"

    code, out, _ = run("log", "m2.toml", "--json", "l.json")
    assert code == 0 and out.startswith("2 steps led to m2.toml")
    assert [s["action"] for s in json.loads((folder / "l.json").read_text())["steps"]] == ["fit", "add"]

    code, out, _ = run("drop", "drive_compliance", "data.csv", "-m", "m2.toml", "-o", "m3.toml")
    assert code == 0 and "it was needed" in out
    first, dropped = modelfile.load(folder / "m.toml"), modelfile.load(folder / "m3.toml")
    np.testing.assert_allclose(dropped.k, first.k, atol=2e-7)
    assert len(dropped.history) == 3

    code, _, _ = run("log", "m3.toml", "--back-to", 2, "-o", "m4.toml")
    assert code == 0
    back, then = modelfile.load(folder / "m4.toml"), modelfile.load(folder / "m2.toml")
    np.testing.assert_array_equal(back.k, then.k)
    assert [f.spec for f in back.effects] == ["drive_compliance"] and len(back.history) == 4
    code, _, err = run("log", "m3.toml", "--back-to", 9)
    assert code == 2 and "steps 1 to 3" in err


def test_add_in_place_keeps_the_way_back(run, folder):
    (folder / "copy.toml").write_bytes((folder / "m.toml").read_bytes())
    assert run("add", "backlash", "data.csv", "-m", "copy.toml")[0] == 0
    assert len(modelfile.load(folder / "copy.toml").history) == 2


def test_an_effect_without_a_trace_is_refused(run, folder):
    text = (folder / "data.csv").read_text().splitlines()
    header = next(i for i, line in enumerate(text) if not line.startswith("#"))
    tools = [i for i, name in enumerate(text[header].split(",")) if name.startswith("tool_")]
    rows = [line.split(",") for line in text[header:]]
    kept = [[v for i, v in enumerate(row) if i not in tools] for row in rows if row is rows[0] or not any(
        float(row[i]) for i in tools)]  # fmt: skip
    (folder / "bare.csv").write_text("\n".join([*text[:header], *map(",".join, kept)]) + "\n")
    assert run("fit", "bare.csv", "--robot", ROBOT_FILE, "--level", "model24", "-o", "bare.toml")[0] == 0
    code, _, err = run("add", "tool_bending", "bare.csv", "-m", "bare.toml", "-o", "none.toml")
    assert code == 2 and "it moves nothing" in err and not (folder / "none.toml").exists()
    code, _, err = run("add", "gravity_tilt", "bare.csv", "-m", "bare.toml", "-o", "none.toml")
    assert code == 2 and "add a compliance first" in err


def test_a_level_is_not_dropped_but_gone_back_from(run, folder):
    assert run("fit", "data.csv", "--robot", ROBOT_FILE, "--level", "model24", "-o", "low.toml")[0] == 0
    assert run("add", "complete", "data.csv", "-m", "low.toml")[0] == 0
    code, _, err = run("drop", "complete", "data.csv", "-m", "low.toml")
    assert code == 2 and "complete is the model's geometry level" in err and "--back-to 1'" in err
    code, _, err = run("drop", "complete", "data.csv", "-m", "m.toml")
    assert code == 2 and "pcalib fit … --level" in err


def test_the_model_is_written_before_anything_is_printed(run, folder, monkeypatch):
    def gone(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("pcalib.cli._steps.say", gone)
    assert run("add", "drive_compliance", "data.csv", "-m", "m.toml", "-o", "piped.toml")[0] == 130
    assert [f.spec for f in modelfile.load(folder / "piped.toml").effects] == ["drive_compliance"]


@pytest.mark.parametrize(
    ("command", "written"),
    [
        ("compare data.csv -m m.toml", "--report --rrd"),
        ("diagnose data.csv -m m.toml", "--report --json"),
        ("explain backlash data.csv -m m.toml", "--plot --json"),
        ("next data.csv -m m.toml --between backlash,gear_ratio -n 2", "-o --json"),
    ],
)
def test_files_are_written_before_anything_is_printed(run, folder, monkeypatch, command, written):
    """Whoever reads the first line only, and closes the pipe, has them all."""

    def gone(*_):
        raise KeyboardInterrupt

    name, *argv = command.split()
    suffix = {"--report": ".html", "--rrd": ".rrd", "--json": ".json", "--plot": ".svg", "-o": ".csv"}
    files = [folder / f"{name}{option.strip('-')}{suffix[option]}" for option in written.split()]
    for option, file in zip(written.split(), files, strict=True):
        argv += [option, file]
    monkeypatch.setattr(f"pcalib.cli.{name}.say", gone)
    assert run(name, *argv)[0] == 130
    assert all(file.stat().st_size > 100 for file in files)


def test_next_plans_what_tells_rivals_apart(run, folder):
    argv = (
        "next",
        "data.csv",
        "-m",
        "m.toml",
        "--between",
        "drive_compliance,nothing",
        "-n",
        4,
        "--payload",
        "0kg",
        "--payload",
        "3kg",
    )
    code, out, _ = run(*argv, "-o", "plan.csv", "--json", "n.json")
    assert code == 0 and out.startswith("Between drive_compliance and nothing")
    lines = (folder / "plan.csv").read_text().splitlines()
    assert lines[1].startswith("q1_deg,q2_deg,q3_deg") and "payload_kg" in lines[1] and len(lines) == 6
    plan = json.loads((folder / "n.json").read_text())
    assert len(plan["s_after"]) == 4 and max(plan["rows"]["payload_kg"]) == 3.0
    truth = truths.Truth(robots.load(ROBOT_FILE), np.zeros(60), Instrument(sigma_pos=15e-6, sigma_rot=60e-6))
    more = simulate.run(truth, plans.make(truth.robot, folder / "plan.csv"), 1).measurements
    measurement.save(folder / "more.csv", more)
    assert "125 rows of 1 file written" in run("join", "data.csv", "-o", "one.csv")[1]
    code, out, _ = run("join", "data.csv", "more.csv", "-o", "all.csv", "--json", "j.json")
    assert code == 0 and out.startswith("129 rows of 2 files")
    joined = measurement.load(folder / "all.csv", truth.robot)
    said = json.loads((folder / "j.json").read_text())
    assert said["schema"] == "pcalib.join/1" and said["rows"] == 129 and said["files"] == ["data.csv", "more.csv"]
    assert said["left_out"][0] == "expected_x_mm"
    assert len(joined) == 129 and set(joined.pose_id[-4:]) == {-1}
    assert run("next", "data.csv", "-m", "m.toml", "--between", "backlash")[0] == 2
    assert "did you mean" in run("next", "data.csv", "-m", "m.toml", "--between", "backlsh,nothing")[2]


def test_what_a_diagnosis_advises_runs(run, folder):
    run("fit", "data.csv", "--robot", ROBOT_FILE, "--level", "model24", "-o", "m24.toml")
    code, out, _ = run("diagnose", "data.csv", "-m", "m24.toml", "--json", "d24.json")
    assert code == 0 and "Something is missing: complete in any case, and with it" in out
    commands = [shlex.split(line)[1:] for line in out.splitlines() if line.startswith("  pcalib ")]
    assert [words[0] for words in commands] == ["add", "next"] and "…" not in out.split("Next,", 1)[1]
    items = json.loads((folder / "d24.json").read_text())["next"]
    assert [item["do"] for item in items][:2] == ["add", "next"] and items[0]["effect"] == "complete"
    between = ",".join(items[1]["between"])
    assert "complete" not in between
    assert commands[1][commands[1].index("--between") + 1] == between
    for words in commands:
        assert run(*words)[0] == 0, words


def test_rivals_may_take_geometry_with_them(run):
    run("fit", "data.csv", "--robot", ROBOT_FILE, "--level", "model24", "-o", "m24.toml")
    both = "complete+drive_compliance,arm_bending+complete"
    code, out, _ = run("next", "data.csv", "-m", "m24.toml", "--between", both, "-n", 2)
    assert code == 0 and out.startswith("Both take geometry of level complete")
    assert "Between drive_compliance and arm_bending" in out
    code, out, _ = run("next", "data.csv", "-m", "m24.toml", "--between", "complete,drive_compliance", "-n", 2)
    assert code == 0 and "should tell them apart already" in out
    code, _, err = run("next", "data.csv", "-m", "m.toml", "--between", "complete,drive_compliance", "-n", 2)
    assert code == 2 and "of level complete already" in err


def test_a_rival_that_the_model_has_is_none(run):
    assert run("add", "drive_compliance", "data.csv", "-m", "m.toml", "-o", "has.toml")[0] == 0
    code, _, err = run("next", "data.csv", "-m", "has.toml", "--between", "drive_compliance,arm_bending", "-n", 2)
    assert code == 2 and "in the model already" in err and "pcalib drop drive_compliance" in err


def test_an_effect_of_the_users_own(run, folder):
    code, out, _ = run("effect", "new", "SoftDrive")
    assert code == 0 and "soft_drive.py" in out
    assert run("effect", "new", "SoftDrive")[0] == 2  # never overwritten
    file = folder / "soft_drive.py"
    text = (
        file.read_text()
        .replace("np.sin(40 * at.q)", "at.torque")
        .replace('"urad"', '"urad_Nm"')
        .replace("1e-4", "2e-5")
    )
    file.write_text(text)
    code, out, _ = run("effect", "check", "soft_drive.py:SoftDrive", "--robot", ROBOT_FILE, "--json", "k.json")
    assert code == 0 and "no different from drive_compliance" in out
    checked = json.loads((folder / "k.json").read_text())
    assert checked["channels"] == ["actuator"]
    assert checked["parameters"] == {"amplitude": {"unit": "rad_Nm", "shown_in": "urad_Nm"}}
    code, out, _ = run("diagnose", "data.csv", "-m", "m.toml", "--effect", "soft_drive.py:SoftDrive")
    assert code == 0 and "soft_drive" in out.split("Candidates")[0]
    code, out, _ = run("add", "soft_drive.py:SoftDrive", "data.csv", "-m", "m.toml", "-o", "own.toml")
    assert code == 0 and "confirmed" in out
    code, _, err = run("compare", "data.csv", "-m", "own.toml")
    assert code == 2 and "add --effect soft_drive.py:SoftDrive" in err  # code runs only where it is named
    code, out, _ = run("compare", "data.csv", "-m", "own.toml", "--effect", "soft_drive.py:SoftDrive")
    assert code == 0 and "No pattern stands out" in out
    assert (
        run(
            "drop",
            "soft_drive",
            "data.csv",
            "-m",
            "own.toml",
            "-o",
            "x.toml",
            "--effect-file",
            "soft_drive.py:SoftDrive",
        )[0]
        == 0
    )
    file.write_text(text.replace("theta[0] *", "theta[1] *"))
    code, _, err = run("diagnose", "data.csv", "-m", "m.toml", "--effect-file", "soft_drive.py:SoftDrive")
    assert code == 2 and "soft_drive.py:" in err and "IndexError" in err and "Traceback" not in err


def test_effect_list(run, folder):
    code, out, _ = run("effect", "list", "--robot", ROBOT_FILE, "--json", "list.json")
    assert code == 0 and "play in the drives" in out
    found = json.loads((folder / "list.json").read_text())
    assert found["schema"] == "pcalib.effect/1" and [e["effect"] for e in found["effects"]] == effects.names()
    assert {"effect", "title", "variants", "wants", "unsuited"} == set(found["effects"][0])


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("diagnose", "data.csv", "-m", "none.toml"), "no such file"),
        (("diagnose", "none.csv", "-m", "m.toml"), "no such file"),
        (("diagnose", "data.csv", "-m", "m.toml", "--most", "7"), "1, 2 or 3"),
        (("explain", "backlsh", "data.csv", "-m", "m.toml"), "did you mean 'backlash'"),
        (("explain", "gravity_tilt", "data.csv", "-m", "m.toml"), "compliance"),
        (("explain", "backlash", "data.csv", "-m", "m.toml", "--plot", "e.png"), "drawings are SVG"),
        (("add", "backlsh", "data.csv", "-m", "m.toml"), "did you mean 'backlash'"),
        (("drop", "backlash", "data.csv", "-m", "m.toml"), "no effects to drop"),
        (("diagnose", "data.csv", "-m", "m.toml", "--effect", "backlash"), "names no file"),
        (("effect", "change"), "unknown action"),
        (("effect", "check", "x.py:Y"), "--robot is needed"),
    ],
)
def test_bad_input_is_one_message(run, argv, message):
    code, _, err = run(*argv)
    assert code == 2 and message in err and "Traceback" not in err
