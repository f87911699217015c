"""The benchmark of the diagnosis: what it asks, that it repeats itself, and how it counts."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench import noises
from bench.jobs import blind
from bench.jobs.diagnosis_benchmark import cells as asked
from bench.jobs.diagnosis_benchmark import figures, report, rows, trial
from bench.jobs.diagnosis_benchmark.cells import Cell
from bench.jobs.diagnosis_benchmark.results import Results
from bench.jobs.diagnosis_benchmark.rows import noise
from bench.jobs.diagnosis_benchmark.trial import Trial
from bench.jobs.hidden.catalogue import CATALOGUE, UNLISTED
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import Answer, Facts, Grade
from pcalib import effects
from pcalib import robot as robots
from pcalib.cli import main as pcalib

ROOT = Path(__file__).resolve().parents[2]
ROBOT = robots.load(ROOT / "models" / "delta.toml")


def test_everything_is_asked(own_tests):
    cells = asked.cells(ROBOT)
    assert [c.number for c in cells] == list(range(len(cells)))
    for part in ("single", "add"):
        hidden = {CATALOGUE[n].effect for c in cells if c.part == part for n in c.what}
        assert hidden <= set(effects.names()) <= hidden | own_tests, part
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
    options = ["--quick", "--workers", "1", "--json", str(folder / "b.json"), "--out", str(folder)]
    code = report.main([*options, "--rows", *report.PARTS])
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
    assert report.main(["--rows", "nobody"]) == 2
    assert "unknown row 'nobody'" in capsys.readouterr().err
    assert report.main(["--rows", "noise.pink"]) == 2
    assert "unknown variant of row noise 'pink'" in capsys.readouterr().err
    assert report.main(["--replay", "noise.white"]) == 2
    assert report.main(["--workers", "0"]) == 2


# -- rows beside hidden faults -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", rows.names())
def test_a_row_asks_its_bounds_and_repeats_itself(name):
    """One set of one variant; the others differ by their settings."""
    row = rows.get(name)
    assert sum(row.variants.values()) >= 200
    [task] = replace(row, variants=dict(list(row.variants.items())[:1])).tasks(1)
    one, two = (rows.run(task, 3)[0].to_json() | {"seconds": 0} for _ in range(2))
    assert one == two and one["set"] == f"{task.name}#0" and one["said"] and set(one["hits"]) <= set(row.bounds)
    again = rows.replay(one["set"], 3)
    assert again.about == one["about"]


def test_noise_of_every_sort_is_asked_on_every_kind():
    asked_noises = {v.design.instrument_settings.get("noise", "white") for v in noise.VARIANTS.values()}
    assert asked_noises == set(noises.names())
    kinds = {robots.load(path).kind for path in (ROOT / "models").glob("*.toml")}
    assert {kind for v in noise.VARIANTS.values() for kind in v.kinds} == kinds


@pytest.mark.parametrize("variant", noise.VARIANTS)
def test_every_variant_of_noise_makes_data(variant):
    task = rows.Task("noise", variant, 0, 1)
    [made] = list(rows.get("noise").sets(task, task.generator(0)))
    assert len(made.data) >= 8 and made.data.sigma_stated


def test_lines_count_the_sets_that_were_asked():
    outcomes = [
        rows.Outcome("noise.white/0#0", "", "", {"alarm": True, "wrong": False}, 0.0),
        rows.Outcome("noise.white/0#1", "", "", {"alarm": False, "wrong": False}, 0.0),
        rows.Outcome("noise.heavy_tails/0#0", "", "", {}, 0.0),
        rows.Outcome("steps.motor_slip/0#0", "", "", {"row": True}, 0.0),
    ]
    counted = {line.name: (line.hits, line.n) for line in rows.lines(outcomes)}
    assert counted == {"noise.white.alarm": (1, 2), "noise.white.wrong": (0, 2), "steps.motor_slip.row": (1, 1)}


def test_a_set_is_written_by_its_name(tmp_path):
    assert report.main(["--replay", "noise.few_contacts/1#2", "--out", str(tmp_path)]) == 0
    model, data = str(tmp_path / "model.toml"), str(tmp_path / "data.csv")
    assert pcalib(["inspect", data, "--robot", str(tmp_path / "robot.toml")]) == 0
    assert pcalib(["compare", data, "--model", model]) == 0


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
