"""`pcalib view` through its entry point."""

import json
import shutil
from pathlib import Path

import pytest

from pcalib import cli, modelfile
from pcalib.model import Model
from pcalib.view import viewer


@pytest.fixture
def model(delta, perturb, tmp_path) -> Path:
    modelfile.save(tmp_path / "m.toml", Model(delta, perturb(1), "complete"))
    return tmp_path / "m.toml"


@pytest.fixture
def shown(monkeypatch) -> list[tuple[Path, bool]]:
    """What would have been opened."""
    calls: list[tuple[Path, bool]] = []

    def show(recording: Path, browser: bool = False) -> None:
        assert recording.read_bytes()[:4] == b"RRF2"
        calls.append((recording, browser))

    monkeypatch.setattr(viewer, "show", show)
    return calls


def test_a_model_is_drawn_and_saved(model, tmp_path, capsys, shown):
    out, told = tmp_path / "out.rrd", tmp_path / "v.json"
    files = ["--save", str(out), "--json", str(told)]
    assert cli.main(["view", str(model), "--tool", "0,0,-50mm", "--payload", "1kg", *files]) == 0
    assert out.stat().st_size > 10_000 and shown == []
    assert "out.rrd" in capsys.readouterr().out
    said = json.loads(told.read_text())
    assert said["schema"] == "pcalib.view/1" and said["recording"] == str(out) and said["payload_kg"] == 1
    assert said["tools_mm"] == [[0, 0, -50]] and said["steps"][0]["rms_um"][0] > 50


def test_models_recordings_and_folders_open_the_viewer(model, tmp_path, shown):
    assert cli.main(["view", str(model)]) == 0
    run = tmp_path / "run"
    run.mkdir()
    assert cli.main(["view", str(model), "--save", str(run / "a.rrd")]) == 0
    assert cli.main(["view", str(run), "--json", str(tmp_path / "v.json")]) == 0
    assert json.loads((tmp_path / "v.json").read_text())["recording"] == str(run / "a.rrd")
    assert cli.main(["view", str(run / "a.rrd"), "--browser"]) == 0
    assert shown[1:] == [(run / "a.rrd", False), (run / "a.rrd", True)]
    assert not shown[0][0].exists()  # the recording of a model is made for the look only
    assert cli.main(["view", str(run), "--save", str(tmp_path / "copy.rrd")]) == 0
    assert (tmp_path / "copy.rrd").read_bytes() == (run / "a.rrd").read_bytes()


def test_bad_input_is_one_message(model, tmp_path, capsys, shown):
    empty, two = tmp_path / "empty", tmp_path / "two"
    empty.mkdir()
    two.mkdir()
    (tmp_path / "text.rrd").write_text("no recording")
    assert cli.main(["view", str(model), "--save", str(two / "a.rrd")]) == 0
    shutil.copy(two / "a.rrd", two / "b.rrd")
    capsys.readouterr()
    for arguments, said in [
        ([tmp_path / "absent"], "no such file or folder"),
        ([empty], "no recording"),
        ([two], "name one: a.rrd, b.rrd"),
        ([tmp_path / "text.rrd"], "this is no recording"),
        ([two / "a.rrd", "--tool", "0,0,-1mm"], "for model files"),
        ([model, "--tool", "0,-1mm"], "needs 3 numbers"),
        ([model, "--save", tmp_path / "no" / "where.rrd"], "cannot write"),
    ]:
        assert cli.main(["view", *map(str, arguments)]) == 2
        error = capsys.readouterr().err
        assert said in error and error.startswith("error: ") and "Traceback" not in error
    assert shown == []


def test_without_a_screen_it_says_what_to_do(model, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert cli.main(["view", str(model)]) == 2
    assert "--browser" in capsys.readouterr().err
