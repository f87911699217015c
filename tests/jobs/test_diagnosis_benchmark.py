"""The benchmark of the diagnosis: what it asks, that it repeats itself, and how it counts."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench import faults, noises
from bench.jobs import blind
from bench.jobs.diagnosis_benchmark import figures, report, rows
from bench.jobs.diagnosis_benchmark.results import Results
from bench.jobs.diagnosis_benchmark.rows import added, hidden, noise, to_tell
from bench.jobs.hidden.catalogue import CATALOGUE, UNLISTED
from bench.jobs.hidden.design import DESIGNS
from bench.jobs.hidden.grading import Answer, Facts, Grade
from pcalib import effects
from pcalib import robot as robots
from pcalib.cli import main as pcalib

ROOT = Path(__file__).resolve().parents[2]
ROBOT = robots.load(ROOT / "models" / "delta.toml")


def test_everything_is_asked():
    asked = hidden.cells()
    by_part = {part: [c for some in asked.values() for c in some if c.part == part] for part in ("single", "outside")}
    assert {CATALOGUE[c.what].effect for c in by_part["single"]} == set(effects.names())
    assert {CATALOGUE[name].effect for name in added.WHAT} == set(effects.names())
    assert {c.what for c in by_part["outside"] if not c.without} == set(UNLISTED)
    assert all(sorted(c.sizes) == [3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0] for c in asked["single_rich"])
    assert {v.design.name for v in noise.VARIANTS.values()} == set(DESIGNS)
    sizes = {name: sum(rows.get(name).variants.values()) for name in rows.names()}
    assert min(rows.get("noise").variants.values()) >= 120 and sizes["random_laws"] >= 400 and sizes["held_out"] >= 500
    assert sizes["agreement"] >= 300 and sum(len(some) for v, some in asked.items() if v.startswith("pair")) >= 100
    tasks = rows.tasks(rows.names())
    assert sum(t.sets for t in tasks) == sum(sizes.values()) and len({t.name for t in tasks}) == len(tasks)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark")
    options = ["--quick", "--workers", "1", "--json", str(folder / "b.json"), "--out", str(folder)]
    some = [f"hidden.{variant}" for variant in ("single_rich", "single_plain", "pair_rich", "outside_rich")]
    code = report.main([*options, "--rows", *some, "added", "noise.plain"])
    return code, json.loads((folder / "b.json").read_text())


def test_a_quick_run_asks_the_bounds_of_its_rows(quick):
    code, found = quick
    assert code == 0 and found["schema"] == "pcbench.diagnosis_benchmark/1"
    bound = [b for b in found["bounds"] if b["verdict"] != "for comparison"]
    assert {b["name"] for b in bound} == {
        "hidden.inside", "hidden.found_at_6", "hidden.false_established", "hidden.pairs", "hidden.outside",
        "added.held_out", "added.landed", "noise.plain.alarm", "noise.plain.wrong",
    }  # fmt: skip
    assert all(b["n"] > 0 for b in found["bounds"]) and found["data_sets"] == len(found["sets"]) == 6


def test_hidden_effects_have_the_size_that_was_wanted_and_an_added_one_leaves_noise(quick):
    found = quick[1]
    single = [s for s in found["sets"] if s["set"].startswith("hidden.single")]
    assert single and all(s["s"] == pytest.approx(s["wanted"], rel=0.04) for s in single)
    drive = found["added"]["drive_compliance"]
    assert drive["held_out"] < 1.1 and drive["held_out"] < drive["held_out_before"]
    assert 0.9 < drive["floor"] < 1.1 and drive["landed"] < 1.5


def hand_made(variant, truth, verdict, adequate=(), size=6.0, faults=None, row="hidden", hits=(), **figures):
    facts = Facts(tuple(truth), tuple(truth if faults is None else faults), size, size)
    established = adequate[0] if verdict == "established" else ()
    grade = Grade(facts, Answer(verdict, tuple(established), tuple(map(tuple, adequate))))
    said = rows.Said(verdict, dict(hits), grade, {"wanted": size} | figures)
    return rows.Outcome(rows.Task(row, variant, 0, 1), 0, "", said)


def made_by_hand():
    drive, bend = ("drive_compliance",), ("arm_bending",)
    quiet = rows.Said("", {"alarm": False, "wrong": False})
    return Results(
        (
            rows.Outcome(rows.Task("noise", "white", 0, 1), 0, "", quiet),
            hand_made("single_rich", drive, "established", [drive]),
            hand_made("single_rich", drive, "ambiguous", [bend, drive]),
            hand_made("single_rich", drive, "established", [bend]),
            hand_made("single_rich", drive, "nothing_missing", [()]),
            hand_made("single_rich", drive, "established", [drive], 12.0),
            hand_made("outside_rich", (), "unexplained", (), 12.0, faults=["hose"]),
            hand_made("rich", drive, "established", [drive], 20.0, row="added", held_out=1.02, landed=1.6),
            hand_made("rich", drive, "established", [drive], 20.0, row="added", held_out=1.06, landed=1.2),
            hand_made("rich", bend, "established", [bend], 20.0, row="added", held_out=1.2, landed=1.2),
        ),
        seed=0,
    )


def test_rates_of_added_effects_are_of_their_means():
    counted = {line.name: (line.hits, line.n) for line in made_by_hand().lines}
    assert counted == {
        "noise.white.alarm": (0, 1), "noise.white.wrong": (0, 1), "added.held_out": (1, 2), "added.landed": (2, 2),
    }  # fmt: skip


def test_a_diagnosis_is_judged_by_what_is_hidden():
    """A set by hand whose diagnosis is known by its size: at 20 noise units the truth is named."""
    task = rows.Task("hidden", "single_rich", 4, 7)
    made = [m for m in rows.get("hidden").sets(task, task.generator(1)) if m.truth["wanted"] in (6.0, 20.0)]
    said = [rows.get("hidden").judge(m) for m in made]
    assert [set(s.hits) >= {"false_established", "inside"} for s in said] == [True, True]
    assert "found_at_6" in said[0].hits and "found_at_6" not in said[1].hits
    assert said[1].grade.inside and said[1].hits["inside"] and not said[1].hits["false_established"]


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
    [task] = replace(row, variants=dict(list(row.variants.items())[:1])).tasks(1)
    one, two = (rows.run(task, 3)[0].to_json() | {"seconds": 0} for _ in range(2))
    assert one == two and one["set"] == f"{task.name}#0" and one["said"] and set(one["hits"]) <= set(row.bounds)
    again = rows.replay(one["set"], 3)
    assert again.about == one["about"]


def test_noise_of_every_sort_is_asked_on_every_kind(own_tests):
    asked_noises = {v.design.instrument_settings.get("noise", "white") for v in noise.VARIANTS.values()}
    assert asked_noises <= set(noises.names()) <= asked_noises | own_tests
    kinds = {robots.load(path).kind for path in (ROOT / "models").glob("*.toml")}
    asked_kinds = {kind for v in noise.VARIANTS.values() for kind in v.kinds}
    assert asked_kinds <= kinds <= asked_kinds | own_tests


@pytest.mark.parametrize("variant", noise.VARIANTS)
def test_every_variant_of_noise_makes_data(variant):
    task = rows.Task("noise", variant, 0, 1)
    [made] = list(rows.get("noise").sets(task, task.generator(0)))
    assert len(made.data) >= 8 and made.data.sigma_stated


def test_lines_count_the_sets_that_were_asked():
    def outcome(name, variant, **hits):
        return rows.Outcome(rows.Task(name, variant, 0, 1), 0, "", rows.Said("", hits))

    outcomes = [
        outcome("noise", "white", alarm=True, wrong=False), outcome("noise", "white", alarm=False, wrong=False),
        outcome("noise", "heavy_tails"), outcome("steps", "motor_slip", row=True),
    ]  # fmt: skip
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
    assert scored["grade"] == graded.mark.value and scored["kind"] == facts.kind


def pcbench(*arguments):
    code = "import sys; from bench.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_usual_sizes_of_the_plan_to_tell_are_those_of_the_effects():
    """A fault of the row `to_tell` moves the readings as the effect of its name does at its usual parameters."""
    for name, table in to_tell.USUAL.items():
        size = [p.prior for p in effects.get(name, None, ROBOT).parameters]
        fault = faults.make(ROBOT, name, table)
        if "amplitude" in fault.values:  # sine and cosine of usual size
            assert np.mean(fault.values["amplitude"]) == pytest.approx(np.hypot(*size))
            turns = {"encoder_eccentricity": 1, "encoder_ovality": 2, "gear_ripple": 1}[name]
            assert turns * np.mean(fault.values["phase"]) == pytest.approx(np.pi / 4)
        else:
            given = np.concatenate([np.unique(fault.values[s]) for s in fault.SIZES or [fault.SETTINGS[0].name]])
            assert sorted(set(given)) == pytest.approx(sorted(set(size)))
