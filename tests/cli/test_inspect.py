"""`pcalib inspect` as a user runs it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pcalib import planning, robot
from pcalib.data.measurement import Measurements, save
from pcalib.mechanics import kinematics

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "models" / "delta.toml"
PROGRAM = Path(sys.executable).parent / "pcalib"


def pcalib(*argv):
    if not PROGRAM.exists():
        pytest.skip("pcalib is not installed beside this Python")
    return subprocess.run([str(PROGRAM), *map(str, argv)], capture_output=True, text=True)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """20 poses measured twice."""
    delta = robot.load(ROBOT)
    rng = np.random.default_rng(0)
    q = np.repeat(planning.reachable(delta, 20, rng).q, 2, axis=0)
    x = kinematics.forward(delta.mechanism, delta.mechanism.nominal, q).pose.x
    payload = np.repeat(rng.integers(0, 3, 20), 2)
    data = Measurements.create(
        delta, q, x + 2e-5 * rng.standard_normal(x.shape), payload=payload, pose_id=np.arange(40) // 2, sigma_pos=2e-5
    )
    path = tmp_path_factory.mktemp("data") / "data.csv"
    save(path, data)
    return path


def test_a_table_and_json(file, tmp_path):
    out = tmp_path / "out.json"
    done = pcalib("inspect", file, "--robot", ROBOT, "--json", out)
    assert done.returncode == 0 and done.stderr == ""
    counts = ("40 (40 fit, 0 check)", "40 position only", "40 rows in 20 groups")
    for text in (*counts, "20.0 µm (stated)", "q3", "- note: No time"):
        assert text in done.stdout
    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["schema"] == "pcalib.inspect/1" and content["rows"] == 40
    assert content["replicates"]["ratio_pos"] == pytest.approx(1, abs=0.3)
    assert {f["code"] for f in content["findings"]} == {
        "no_check_rows", "position_only", "no_direction", "no_temperature", "no_time",
    }  # fmt: skip


def test_sigma_is_said_per_kind_and_millimetres_as_such(tmp_path):
    """5 mm is no '5e+03 µm'."""
    delta = robot.load(ROBOT)
    q = np.repeat(planning.reachable(delta, 12, np.random.default_rng(0)).q, 2, axis=0)
    pose = kinematics.forward(delta.mechanism, delta.mechanism.nominal, q).pose
    x = pose.x + 5e-3 * np.random.default_rng(1).standard_normal(pose.x.shape)
    data = Measurements.create(delta, q, x, pose.R, pose_id=np.arange(24) // 2, sigma_pos=5e-3)
    save(tmp_path / "d.csv", data)
    said = pcalib("inspect", tmp_path / "d.csv").stdout
    assert "5.00 mm (stated), 60.0 µrad (not stated, assumed)" in said and "e+03" not in said


def test_without_a_robot_and_as_parquet(file, tmp_path):
    assert pcalib("inspect", file).returncode == 0
    from pcalib.data.measurement import load

    save(tmp_path / "data.parquet", load(file))
    assert pcalib("inspect", tmp_path / "data.parquet", "--robot", ROBOT).returncode == 0


def test_bad_input_is_one_message_and_2(file, tmp_path):
    broken = tmp_path / "broken.csv"
    lines = file.read_text().splitlines()
    cells = lines[9].split(",")
    cells[4] = "nan"
    broken.write_text("\n".join([*lines[:9], ",".join(cells), *lines[10:]]))
    out = tmp_path / "out.json"
    done = pcalib("inspect", broken, "--robot", ROBOT, "--json", out)
    assert done.returncode == 2 and done.stdout == "" and not out.exists()
    assert done.stderr.startswith(f"error: {broken}:10: column 'y_mm': 'nan' is not a finite number\n  ")
    assert len(done.stderr.splitlines()) == 2

    for argv in ([tmp_path / "absent.csv"], [tmp_path], [file, "--robot", file], [file, "--robot", "no.toml"], []):
        done = pcalib("inspect", *argv)
        assert done.returncode == 2 and done.stderr.startswith("error: ") and "Traceback" not in done.stderr


def test_swapped_columns_are_bad_input(file, tmp_path):
    swapped = tmp_path / "swapped.csv"
    swapped.write_text(file.read_text().replace("q1_deg,q2_deg", "q2_deg,q1_deg"))
    out = tmp_path / "out.json"
    done = pcalib("inspect", swapped, "--robot", ROBOT, "--json", out)
    assert done.returncode == 2
    assert "q1 is what stands in q2" in done.stderr
    assert json.loads(out.read_text())["findings"][0]["code"] == "swapped_columns"
