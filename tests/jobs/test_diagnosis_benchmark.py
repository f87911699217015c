"""The benchmark of the diagnosis: what it asks, that it repeats itself, and how it counts."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.jobs import blind
from bench.jobs.diagnosis_benchmark import cells as asked
from bench.jobs.diagnosis_benchmark import figures, report, trial
from bench.jobs.diagnosis_benchmark.cells import Cell
from bench.jobs.diagnosis_benchmark.results import Results
from bench.jobs.diagnosis_benchmark.trial import Trial
from bench.jobs.hidden.catalogue import CATALOGUE, UNLISTED
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import Answer, Facts, Grade
from pcalib import effects
from pcalib import robot as robots
from pcalib.cli import main as pcalib

ROOT = Path(__file__).resolve().parents[2]
ROBOT = robots.load(ROOT / "models" / "delta.toml")


def test_everything_is_asked():
    cells = asked.cells(ROBOT)
    assert [c.number for c in cells] == list(range(len(cells)))
    for part in ("single", "add"):
        assert {CATALOGUE[n].effect for c in cells if c.part == part for n in c.what} == set(effects.names()), part
    assert {n for c in cells if c.part == "outside" and not c.without for n in c.what} == set(UNLISTED)
    assert {c.design for c in cells if c.part == "none"} == set(DESIGNS)
    curves = [set(c.sizes) for c in cells if c.part == "single" and c.design == "rich"]
    assert curves and all(sizes == {3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0} for sizes in curves)
    assert sum(c.trials for c in cells if c.part == "none") >= 600
    assert sum(c.trials for c in cells if c.part == "pair") >= 100


def test_a_cell_repeats_itself():
    cell = Cell(5, "single", "rich", ("thermal_rods",), (12.0,))
    one, two = ([t.to_json() | {"seconds": 0} for t in trial.run(ROBOT, 1, cell)] for _ in range(2))
    assert one == two and one[0]["s"] == pytest.approx(12.0, rel=0.04)
    assert [t.to_json()["cell"] for t in trial.run(ROBOT, 2, cell)] == [5]


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark")
    code = report.main(["--quick", "--workers", "1", "--json", str(folder / "b.json"), "--out", str(folder)])
    return code, json.loads((folder / "b.json").read_text())


def test_a_quick_run_asks_every_bound(quick):
    code, found = quick
    assert code == 0 and found["schema"] == "pcbench.diagnosis_benchmark/1"
    assert [b["name"] for b in found["bounds"]] == [
        "false_alarms", "false_alarms_misstated", "inside", "found_at_6", "false_established", "pairs", "outside",
        "taken_out", "held_out", "landed",
    ]  # fmt: skip
    assert all(b["n"] > 0 for b in found["bounds"])
    assert found["data_sets"] == len(found["trials"]) == sum(c.trials for c in asked.cells(ROBOT, quick=True))


def test_large_effects_are_named_and_an_added_one_leaves_noise(quick):
    found = quick[1]
    large = [t for t in found["trials"] if t["part"] == "single" and t["wanted"] == 12.0]
    assert len(large) == 3 and all(t["truth"] in t["adequate"] for t in large)
    rod = found["added"]["rod_compliance"]
    assert rod["held_out"] < 1.1 < 1.5 and rod["held_out"] < rod["held_out_before"]
    assert 0.9 < rod["floor"] < 1.1 and rod["landed"] < 1.5


def hand_made(part, truth, verdict, adequate=(), size=6.0, design="rich", faults=None, **more):
    cell = Cell(0, part, design, ("drive_compliance",), (size,))
    facts = Facts(tuple(truth), tuple(truth if faults is None else faults), size, size)
    established = adequate[0] if verdict == "established" else ()
    return Trial(cell, size, Grade(facts, Answer(verdict, tuple(established), tuple(map(tuple, adequate)))), **more)


def made_by_hand():
    drive, bend = ("drive_compliance",), ("arm_bending",)
    return Results(
        (
            hand_made("none", (), "nothing_missing", [()], 0.0),
            hand_made("none", (), "ambiguous", [drive, bend], 0.0, "rich-understated"),
            hand_made("single", drive, "established", [drive]),
            hand_made("single", drive, "ambiguous", [bend, drive]),
            hand_made("single", drive, "established", [bend]),
            hand_made("single", drive, "nothing_missing", [()]),
            hand_made("single", drive, "established", [drive], 12.0),
            hand_made("outside", (), "unexplained", (), 12.0, faults=["hose"]),
            hand_made("add", drive, "established", [drive], 20.0, held_out=1.02, landed=1.6),
            hand_made("add", drive, "established", [drive], 20.0, held_out=1.06, landed=1.2),
            hand_made("add", bend, "established", [bend], 20.0, held_out=1.2, landed=1.2),
        ),
        seed=0,
    )


def test_rates_count_what_they_say():
    counted = {line.name: (line.hits, line.n) for line in made_by_hand().lines}
    assert counted == {
        "false_alarms": (0, 1), "false_alarms_misstated": (1, 1), "inside": (3, 4), "found_at_6": (2, 4),
        "false_established": (1, 8), "pairs": (0, 0), "outside": (1, 1), "taken_out": (0, 0), "held_out": (1, 2),
        "landed": (2, 2),
    }  # fmt: skip


def test_power_and_confusion_share_rivals_out():
    found = made_by_hand()
    assert found.power(["rich"]) == [(0.0, 0.0, 0.0, 1), (6.0, 0.75, 0.5, 4), (12.0, 1.0, 1.0, 1)]
    assert found.power(["rich"], "arm_bending") == []
    c = found.confusion()
    drive = c.share[c.rows.index("drive_compliance")]
    assert c.count[c.rows.index("drive_compliance")] == 5
    assert drive[c.columns.index("drive_compliance")] == pytest.approx((1 + 0.5 + 1) / 5)
    assert drive[c.columns.index("arm_bending")] == pytest.approx((0.5 + 1) / 5)
    assert drive[c.columns.index("nothing")] == pytest.approx(1 / 5)
    assert c.share[c.rows.index("hose"), c.columns.index("unexplained")] == 1.0
    asked_rows = c.count > 0
    assert np.allclose(c.share[asked_rows].sum(axis=1), 1.0) and not c.share[~asked_rows].any()


def test_figures_are_drawn_and_small(tmp_path):
    paths = figures.save(made_by_hand(), tmp_path)
    assert [p.name for p in paths] == ["diagnosis_power.png", "diagnosis_confusion.png"]
    for path in paths:
        assert path.read_bytes()[:4] == b"\x89PNG" and 10_000 < path.stat().st_size < 300_000


def test_what_cannot_be_run_is_refused(capsys):
    assert report.main(["--part", "nobody"]) == 2
    assert "accepted: none, single, pair, outside, add" in capsys.readouterr().err
    assert report.main(["--workers", "0"]) == 2


def test_a_blind_set_goes_through_the_commands(tmp_path):
    """From sealed data to a score by nothing but the two programs."""
    folder = tmp_path / "blind"
    assert pcbench("blind", "--seed", "4", "-n", "1", "-o", str(folder)).returncode == 0
    data, model, answer = (str(folder / f"001.{suffix}") for suffix in ("csv", "toml", "diagnosis.json"))
    assert pcalib(["fit", data, "--robot", str(folder / "robot.toml"), "-o", model]) == 0
    assert pcalib(["diagnose", data, "--model", model, "--json", answer]) == 0
    facts = blind.facts_of(json.loads((folder / "sealed" / "001.json").read_text()))
    ended = pcbench("score", str(folder), "--json", str(tmp_path / "score.json"))
    assert ended.returncode in (0, 1) and "Traceback" not in ended.stderr
    [scored] = json.loads((tmp_path / "score.json").read_text())["sets"]
    graded = Grade(facts, Answer.of_json(json.loads(Path(answer).read_text())))
    assert scored["grade"] == graded.words and scored["kind"] == facts.kind


def pcbench(*arguments):
    code = "import sys; from bench.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
