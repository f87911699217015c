"""docs/instruments.md: its commands run, its forms exist, and its semicolon file leads to a compensated robot."""

import re
import shlex
import subprocess
from pathlib import Path

import numpy as np

from bench import simulate
from bench import truth as truths
from bench.plan import make
from pcalib import fit, load_measurements, recordings, rotation
from pcalib.cli import main
from pcalib.data.orientation import to_euler

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "instruments.md").read_text(encoding="utf-8")


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
