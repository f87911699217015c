"""Recordings, read back: geometry as computed, the same scale in every step, whole files, hostile names."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import view
from pcalib.errors import InputError
from pcalib.ladder import CandidateBar, ErrorMap, Expected, Ladder, ResidualPlot, Step
from pcalib.model import Model
from pcalib.view.scene import Style, gain_of
from pcalib.view.skeleton import rest, skeleton

STEPS = 3


@pytest.fixture(scope="module")
def ladder(delta, perturb) -> Ladder:
    """Errors that fall by a factor of 30 from step to step; one target that the last step does not reach."""
    rng = np.random.default_rng(0)
    steps = tuple(Step(f"s{s}", f"Step {s}", Model(delta, perturb(s)), text=f"Text {s}.") for s in range(STEPS))
    maps = []
    for h in (0.0, 0.3):
        targets = rng.uniform([-0.2, -0.2, -0.9 - h], [0.2, 0.2, -0.7 - h], (20, 3))
        errors = (3e-3 + 5e-3 * h) * 30.0 ** -np.arange(STEPS)[:, None, None] * rng.standard_normal((STEPS, 20, 3))
        status = np.full((STEPS, 20), "ok", "<U20")
        status[-1, 7], errors[-1, 7] = "unreachable", np.nan
        maps.append(ErrorMap(np.array([0.0, 0.0, -h]), targets, errors, status))
    return Ladder(delta, steps, tuple(maps), "measured", 2e-5)


@pytest.fixture(scope="module")
def written(ladder, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("view") / "run.rrd"
    view.write(path, ladder)
    return path


def test_the_file_is_whole(written):
    """With its footer, as the viewer's own check sees it."""
    import rerun_cli

    program = Path(rerun_cli.__file__).parent / "rerun"
    done = subprocess.run([program, "rrd", "verify", written], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "warn" not in (done.stdout + done.stderr).lower()


def test_arrows_in_every_step_on_one_scale(written, ladder, read):
    gain = Style.of(ladder, 1.0).gain
    for tool, field in zip(("tool_0_mm", "tool_300_mm"), ladder.maps, strict=True):
        found = read(written, f"scene/{tool}/error")
        assert sorted(found) == list(range(STEPS))
        for s in range(STEPS):
            good = field.status[s] == "ok"
            assert np.array(found[s]["origins"]) == pytest.approx(field.targets[good], abs=1e-6)
            assert np.array(found[s]["vectors"]) == pytest.approx(gain * field.errors[s, good], rel=1e-6, abs=1e-9)
        assert len(read(written, f"scene/{tool}/missed")[STEPS - 1]["positions"]) == 1


def test_arrows_of_a_step_have_a_scale_of_their_own_that_the_title_says(written, ladder, read):
    """However small a step's errors are, its largest arrows are as long as targets are apart."""
    radius = ladder.robot.workspace.radius
    for tool, field in zip(("tool_0_mm", "tool_300_mm"), ladder.maps, strict=True):
        found, titles = read(written, f"scene/{tool}/error_of_step"), read(written, f"scene/{tool}/title")
        for s in range(STEPS):
            good = field.status[s] == "ok"
            own = gain_of(field.distance[s], radius)
            assert np.array(found[s]["vectors"]) == pytest.approx(own * field.errors[s, good], rel=1e-6, abs=1e-9)
            longest = np.linalg.norm(found[s]["vectors"], axis=1).max()
            assert 0.1 * radius < longest < 0.5 * radius and f"arrows ×{own:g}" in titles[s]["labels"][0]


def test_colours_are_of_one_scale(written, ladder, read):
    colours = Style.of(ladder, 1.0).colours
    for s, row in read(written, "scene/tool_300_mm/target").items():
        good = ladder.maps[1].status[s] == "ok"
        expected = colours.rgb(ladder.maps[1].distance[s, good])
        packed = [(c >> 24 & 255, c >> 16 & 255, c >> 8 & 255) for c in row["colors"]]
        assert packed == [tuple(c) for c in expected.tolist()]


def test_large_errors_are_drawn_about_as_long_as_targets_are_apart(ladder):
    style = Style.of(ladder, 1.0)
    largest = max(np.nanmax(m.distance) for m in ladder.maps)
    assert 0.02 < style.gain * largest < 0.2
    assert style.gain in [m * 10.0**e for m in (1, 2, 5) for e in range(-3, 7)]


def test_what_models_expect_is_drawn_as_ellipsoids_on_one_scale(ladder, tmp_path, read):
    """The last step's model states a miss of 30 µm along z and 10 µm across; the others state none."""
    covariance = np.full((STEPS, 20, 3, 3), np.nan)
    covariance[-1] = np.diag([1e-5, 1e-5, 3e-5]) ** 2
    u95 = np.where(np.isfinite(covariance[:, :, 0, 0]), 6e-5, np.nan)
    expected = Expected(covariance, u95, np.array([np.nan, np.nan, 6e-5]))
    maps = (replace(ladder.maps[0], expected=expected), ladder.maps[1])
    view.write(tmp_path / "e.rrd", replace(ladder, maps=maps))
    found = read(tmp_path / "e.rrd", "scene/tool_0_mm/may_miss")
    half = np.array(found[STEPS - 1]["half_sizes"])
    assert len(half) == 20 and sorted(half[0] / half[0].min()) == pytest.approx([1, 1, 3], rel=1e-5)
    assert not found[0].get("half_sizes")
    [title] = read(tmp_path / "e.rrd", "scene/tool_0_mm/may_miss_title")[STEPS - 1]["labels"]
    assert "95 % of landings within 60.0 µm" in title
    assert "expected, 95 % within" in str(read(tmp_path / "e.rrd", "text/step")[STEPS - 1])


def test_the_robot_is_drawn_where_it_stands(written, ladder, delta, read):
    s = skeleton(ladder.steps[0].model, rest(delta))
    rods = read(written, "scene/robot/rods")[None]
    starts, lengths, turns = (np.array(rods[n]) for n in ("translations", "lengths", "quaternions"))
    x, y, z, w = turns.T
    along = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    assert starts == pytest.approx(s.rods[:, 0], abs=1e-6)
    assert starts + lengths[:, None] * along == pytest.approx(s.rods[:, 1], abs=1e-6)
    tip = read(written, "scene/tool_300_mm/tcp")[None]["positions"][0]
    assert tip == pytest.approx(s.pose.tcp(np.array([0, 0, -0.3]))[0], abs=1e-6)


def test_figures_are_kept_in_micrometres(written, ladder, read):
    for s in range(STEPS):
        for name, value in (("rms", ladder.maps[1].rms[s]), ("max", ladder.maps[1].max[s])):
            found = read(written, f"curves/tool_300_mm/{name}_um")[s]["scalars"][0]
            assert found == pytest.approx(value * 1e6, rel=1e-12)


def test_every_step_has_its_text(written, read):
    pages = read(written, "text/step")
    for s in range(STEPS):
        assert f"{s} · Step {s}" in pages[s]["text"][0] and f"Text {s}." in pages[s]["text"][0]
    assert len(read(written, "text/parameters")[0]["text"][0].splitlines()) == 62  # a header and 60 parameters


def test_each_tool_has_entities_of_its_own(written, entities):
    tops = {path.split("/")[2] for path in entities(written) if path.startswith("/scene/")}
    assert tops == {"robot", "tool_0_mm", "tool_300_mm"}


def test_evidence_is_drawn_where_there_is_some(ladder, tmp_path, read, entities):
    x = np.linspace(0.0, 3.0, 30)
    scatter = ResidualPlot("payload [kg]", x, 2 * x, "actuator 2", np.stack([x, 2 * x], axis=1))
    candidates = (CandidateBar("arm_bending", 4.0), CandidateBar("drive_compliance", 9.0, True))
    steps = (replace(ladder.steps[0], scatter=scatter, candidates=candidates), *ladder.steps[1:])
    view.write(tmp_path / "e.rrd", replace(ladder, steps=steps))
    bars = read(tmp_path / "e.rrd", "candidates/bars")
    ends = [strip[1][0] - strip[0][0] for strip in bars[0]["strips"]]
    assert ends[0] / ends[1] == pytest.approx(9 / 4) and bars[1].get("strips", []) == []
    assert read(tmp_path / "e.rrd", "candidates/names")[0]["labels"] == ["drive_compliance", "arm_bending"]
    ticks = read(tmp_path / "e.rrd", "candidates/x_ticks")
    assert ticks[0]["labels"] == ["0σ", "3σ", "6σ", "9σ"] and ticks[1].get("labels", []) == []
    points = np.array(read(tmp_path / "e.rrd", "scatter/residual")[0]["positions"])
    assert np.ptp(points[:, 0]) > 100 and (np.diff(points[:, 1]) < 0).all()  # scene y points down
    plain = tmp_path / "plain.rrd"
    view.write(plain, ladder)
    assert not {path for path in entities(plain) if path.startswith(("/scatter", "/candidates"))}


def test_bars_of_noise_are_short(ladder, tmp_path, read):
    steps = (replace(ladder.steps[0], candidates=(CandidateBar("backlash", 0.2),)), *ladder.steps[1:])
    view.write(tmp_path / "n.rrd", replace(ladder, steps=steps))
    (bar,) = read(tmp_path / "n.rrd", "candidates/bars")[0]["strips"]
    assert bar[1][0] - bar[0][0] < 10  # of 170
    assert read(tmp_path / "n.rrd", "candidates/x_ticks")[0]["labels"] == ["0σ", "2σ", "4σ", "6σ"]


def test_hostile_names_do_no_harm(ladder, hostile, tmp_path, read):
    odd = ErrorMap(np.array([0.1, 0.0, -0.3]), ladder.maps[1].targets, ladder.maps[1].errors, ladder.maps[1].status)
    steps = tuple(replace(s, name=hostile, label=hostile, text=hostile) for s in ladder.steps)
    path = tmp_path / "hostile.rrd"
    view.write(path, replace(ladder, steps=steps, maps=(*ladder.maps, odd), source=hostile), identity=hostile)
    text = read(path, "text/step")[0]["text"][0]
    assert "<script>" not in text and "\\<script\\>" in text
    assert len(read(path, "scene/tool_100_0_300_mm_2/error")) == STEPS


def test_nothing_is_left_behind_where_writing_fails(ladder, tmp_path, monkeypatch):
    from pcalib.view import panels

    def fail(*_):
        raise RuntimeError("stop")

    monkeypatch.setattr(panels, "log_curves", fail)
    with pytest.raises(RuntimeError, match="stop"):
        view.write(tmp_path / "half.rrd", ladder)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="cannot write"):
        view.write(tmp_path / "absent" / "run.rrd", ladder)


def test_the_viewer_is_imported_only_when_needed():
    code = "import sys, pcalib.view, pcalib.cli.view; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, cwd=Path(__file__).parents[2]).returncode == 0
