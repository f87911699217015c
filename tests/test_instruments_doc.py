"""docs/instruments.md: its commands run, its forms exist, and its semicolon file leads to a compensated robot."""

import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bench import simulate
from bench import truth as truths
from bench.plan import make
from pcalib import fit, load_measurements, recordings, rotation, sensors, stations
from pcalib import robot as robots
from pcalib.cli import main
from pcalib.data.orientation import to_euler
from pcalib.fitting.identifiability import THRESHOLD
from pcalib.mechanics import kinematics
from pcalib.stations import Asked
from pcalib.workspace import reachable

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "instruments.md").read_text(encoding="utf-8")
RANKS = (ROOT / "docs" / "robots.md").read_text(encoding="utf-8").split("### By instrument")[1].split("\n## ")[0]


def test_the_commands_run(tmp_path, monkeypatch):
    (tmp_path / "models").symlink_to(ROOT / "models")
    (tmp_path / "targets.csv").write_text("x_mm,y_mm,z_mm\n0,0,-1100\n100,50,-1080\n")
    monkeypatch.chdir(tmp_path)
    [block] = re.findall(r"```sh\n(.*?)```", TEXT, re.S)
    for line in block.strip().splitlines():
        program, *arguments = shlex.split(line, comments=True)
        done = subprocess.run([ROOT / ".venv/bin" / program, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == 0, (line, done.stderr)
        if "inspect" in arguments:
            assert "120 distances" in done.stdout and "120 tilts" in done.stdout
        if "fit" in arguments:
            assert "at the noise" in " ".join(done.stdout.split())
    assert (tmp_path / "commands.csv").read_text().count(",ok,") == 2


def test_every_form_is_named():
    for name in recordings.FORMS.names():
        assert f"| `{name}` |" in TEXT


def test_a_table_with_semicolons_leads_to_commands(tmp_path, delta):
    [head] = re.findall(r"```\n(# euler.*?\n)q1_deg", TEXT, re.S)
    [header] = re.findall(r"(q1_deg;.*)\n", TEXT)
    truth = truths.parse(
        f'robot = "{ROOT / "models/delta.toml"}"\n[geometry]\nsigma_length_mm = 0.1\nsigma_angle_deg = 0.05\n'
        '[instrument]\nsigma_pos_um = 20\nsigma_rot_urad = 60\nframe = "tracker"\n'
    )
    seen = simulate.run(truth, make(delta, "random", 50), 1).measurements
    angles = np.degrees(to_euler("ZYX", seen.rotation))
    rows = np.column_stack([np.degrees(seen.q), 1e3 * seen.position, angles])
    lines = [";".join(f"{v:.6f}".replace(".", ",") for v in row) for row in rows]
    (tmp_path / "export.csv").write_text("\n".join([head.strip(), header, *lines]))
    data = load_measurements(tmp_path / "export.csv", delta)
    assert np.abs(rotation.log(data.rotation @ rotation.transposed(seen.rotation))).max() < 1e-6
    found = fit(data, delta)
    assert found.status == "converged" and found.accuracy.at_the_noise
    (tmp_path / "targets.csv").write_text("x_mm,y_mm,z_mm\n0,0,-1100\n")
    options = ["--robot", "delta", "-o", str(tmp_path / "m.toml")]
    assert main(["fit", str(tmp_path / "export.csv"), *options]) in (0, None)
    options = ["--model", str(tmp_path / "m.toml"), "--tool", "0,0,-300mm", "-o", str(tmp_path / "c.csv")]
    assert main(["compensate", str(tmp_path / "targets.csv"), *options]) in (0, None)


@pytest.mark.parametrize("name", ["delta", "hexapod", "planar"])
def test_the_ranks_are_those_of_the_table(name):
    robot = robots.load(ROOT / "models" / f"{name}.toml")
    [row] = re.findall(rf"^\| {name} \| (.*) \|$", RANKS, re.M)
    parameters, _, *ranks = [int(cell) for cell in row.split("|")]
    distance, tilt, height = (Asked(sensors.get(n), s) for n, s in SIGMA.items())
    one, two = np.zeros((1, 3)), np.array([[0, 0, 0], [0, 0, -0.15]])
    asked = ([distance], one), ([distance], two), ([distance, tilt], one), ([distance, tilt], two), ([height], one)
    found = [rank(robot, *each) for each in (*asked, ([height, tilt], one))]
    assert parameters == len(robot.mechanism.levels["complete"].columns)
    assert np.abs(np.array(found) - ranks).max() <= 1  # a direction at the threshold may count or not


SIGMA = {"distance": 2e-6, "inclinometer": 20e-6, "probe": 5e-6}


def rank(robot, asked, tools, n=150):
    rng = np.random.default_rng(0)
    q = reachable(robot, n, rng).q
    tool = tools[rng.integers(0, len(tools), n)]
    x = kinematics.forward(robot.mechanism, robot.mechanism.nominal, q).pose.tcp(tool)
    far, low = 0.5 * robot.workspace.radius, x[:, 2].min() - 0.2 * robot.workspace.radius
    around = zip("ABC", (0.3, 2.4, 4.5), strict=True)
    places = {name: np.array([far * np.cos(a), far * np.sin(a), low]) for name, a in around}
    to = np.array(list("ABC"), object)[rng.integers(0, 3, n)]
    if asked[0].sensor.to != "station":
        places, to = {}, np.full(n, "", object)
    blocks, free = stations._blocks(stations._There(robot, q, tool, x), asked, to, places, "complete")
    J = stations._beside(blocks.reshape(-1, blocks.shape[-1]), free)
    return int(np.sum(np.linalg.svd(J, compute_uv=False) > THRESHOLD))
