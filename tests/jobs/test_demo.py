"""The demo through its entry point: the ladder falls, every file is there, the same seed gives the same."""

import json
from pathlib import Path

import numpy as np
import pytest

from bench import cli
from bench import truth as truths
from bench.jobs import demo
from pcalib import modelfile
from pcalib import robot as robots
from pcalib.data import measurement

SMALL = ["--spacing", "200mm", "--tool", "0,0,0mm", "--tool", "0,0,-300mm"]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("demo")
    assert cli.main(["demo", *SMALL, "-o", str(folder / "out"), "--json", str(folder / "demo.json")]) == 0
    return folder / "out", json.loads((folder / "demo.json").read_text())


def test_the_ladder_falls_to_the_noise_with_every_tool(run):
    _, found = run
    steps = {s["name"]: s for s in found["steps"]}
    assert list(steps) == ["nominal", "classical", "model24", "paper", "complete"]
    rms = {name: np.array(s["rms_um"]) for name, s in steps.items()}
    assert 3000 < rms["nominal"][1] < 5000
    assert rms["classical"][0] < 0.5 * rms["nominal"][0] and rms["model24"][0] < 0.5 * rms["classical"][0]
    assert (rms["model24"][1], rms["classical"][1]) > (1000, 1000)  # blind to tilt: the tool shows it
    assert (rms["complete"] < 35).all() and rms["paper"][1] < 100
    assert rms["complete"][1] < 2 * rms["complete"][0]  # flat in the tool's length
    assert all(s["not_reached"] == [0, 0] for s in found["steps"])
    assert found["schema"] == "pcbench.demo/1" and found["sentence"].startswith("With a 300 mm tool")


def test_the_files_are_what_they_say(run, delta):
    folder, found = run
    data = measurement.load(folder / "data.csv", delta)
    assert len(data) == 60 and data.check.sum() == 20 and data.sigma_stated
    truth = truths.load(folder / "data.truth.toml")
    for step in found["steps"][1:]:
        model = modelfile.load(folder / f"{step['name']}.toml")
        assert model.robot.name == "delta" and len(model.history) == 1 and model.uncertainty is not None
    assert "expected, 95 %" in (folder / "report.html").read_text(encoding="utf-8")  # a row of the maps
    # Truth and data belong together: what was measured is where this robot stands, to the noise.
    landing = truth.machine().land(data.q, data.tool)
    assert np.sqrt(np.mean((landing.tcp - data.position) ** 2)) == pytest.approx(2e-5, rel=0.2)
    assert (folder / "demo.rrd").read_bytes()[:4] == b"RRF2"
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert found["sentence"] in text
    # How to get it again, with the very options.
    again = "pcbench demo --seed 5 --poses 40 --length-error 0.3mm --angle-error 0.12deg --spacing 200mm"
    assert again + " --tool 0,0,0mm --tool 0,0,-300mm" in text


def test_verify_agrees_with_the_demo(run, capsys, tmp_path):
    folder, found = run
    out = tmp_path / "v.json"
    arguments = [str(folder / "complete.toml"), str(folder / "data.truth.toml"), "--tool", "0,0,-300mm"]
    assert cli.main(["verify", *arguments, "--max-rms", "35um", "--json", str(out)]) == 0
    complete = next(s for s in found["steps"] if s["name"] == "complete")
    assert json.loads(out.read_text())["tools"][0]["rms_um"] == pytest.approx(complete["rms_um"][1], rel=0.4)
    assert cli.main(["verify", str(folder / "model24.toml"), *arguments[1:], "--max-rms", "35um"]) == 1


def test_the_same_seed_gives_the_same_and_another_another(delta):
    settings = demo.Settings(spacing=0.4, tools=((0.0, 0.0, 0.0),), poses=30, check=0)
    one, two = (demo.run(delta, settings) for _ in range(2))
    assert np.array_equal(one.ladder.rms, two.ladder.rms)
    other = demo.run(delta, demo.Settings(spacing=0.4, tools=((0.0, 0.0, 0.0),), poses=30, check=0, seed=6))
    assert not np.allclose(one.ladder.rms, other.ladder.rms)


@pytest.mark.parametrize("name", ["hexa", "linear_delta"])
def test_other_robots_climb_what_they_have(name):
    robot = robots.load(Path(__file__).parents[2] / "models" / f"{name}.toml")
    settings = demo.Settings(1e-4, 1e-3, spacing=robot.workspace.radius, tools=((0.0, 0.0, -0.1),))
    ticks = []
    done = demo.run(robot, settings, lambda: ticks.append(1))
    assert done.ladder.steps[-1].name == "complete"
    assert done.ladder.rms[-1, 0] < 0.1 * done.ladder.rms[0, 0]
    assert done.ladder.rms[-1, 0] < 4e-5
    assert all(s.fit is None or robot.mechanism.levels[s.model.level].text in s.text for s in done.ladder.steps)
    assert len(ticks) <= demo.stages(settings)


@pytest.mark.parametrize(("name", "tip"), [("delta", (0, 0, -0.3)), ("hexapod", (0, 0, 0.3)), ("planar", (0, -0.3, 0))])
def test_tools_point_away_from_the_drives(name, tip):
    robot = robots.load(Path(__file__).parents[2] / "models" / f"{name}.toml")
    assert demo.straight(robot)[-1] == pytest.approx(tip)


def test_the_command_to_do_it_again_names_the_robot():
    from bench.jobs.demo_report import again

    assert "--robot" not in again(demo.Settings())
    assert " --robot 'my robots/h4.toml'" in again(demo.Settings(robot_file=Path("my robots/h4.toml")))


def test_bad_input_is_one_message_and_leaves_no_files(tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    for arguments, said in [
        (["--poses", "0"], "Must be >= 1"),
        (["--poses", "2", "-o", str(tmp_path / "out")], "too few poses"),
        (["--tool", "0,-1mm"], "needs 3 numbers"),
        (["--length-error", "2"], "no unit"),
        (["--length-error", "-1mm"], "makes no sense"),
        (["--spacing", "0mm"], "is not a positive length"),
        (["--robot", str(tmp_path / "none.toml")], "no such file"),
        (["--spacing", "400mm", "-o", str(blocked)], "cannot make this folder"),
    ]:
        assert cli.main(["demo", *arguments]) == 2, arguments
        error = capsys.readouterr().err
        assert said in error and error.startswith("error: "), error
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]
