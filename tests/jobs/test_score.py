"""Grades of diagnoses written by hand, and rates against bounds."""

import json

import pytest
from scipy.stats import binom

from bench import cli
from bench.jobs import blind
from bench.jobs.hidden.grading import Answer, Facts, Grade, Line, Mark, lines
from bench.jobs.score import score
from pcalib.errors import InputError

DRIVE, BEND = ("drive_compliance",), ("arm_bending",)
PAIR = ("backlash", "drive_compliance")


def grade(effects, verdict, established=(), adequate=(), faults=None, size=8.0, distance=8.0):
    return Grade(
        Facts(tuple(effects), tuple(effects if faults is None else faults), size, distance),
        Answer(verdict, tuple(established), tuple(tuple(a) for a in adequate)),
    )


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (grade((), "nothing_missing", adequate=[()]), "right"),
        (grade((), "ambiguous", adequate=[DRIVE, BEND]), "false alarm"),
        (grade((), "established", DRIVE, [DRIVE]), "wrong"),
        (grade(DRIVE, "established", DRIVE, [DRIVE]), "right"),
        (grade(DRIVE, "ambiguous", adequate=[BEND, DRIVE]), "right, among rivals"),
        (grade(DRIVE, "ambiguous", adequate=[BEND, ("backlash",)]), "not among the rivals"),
        (grade(DRIVE, "established", BEND, [BEND]), "wrong"),
        (grade(DRIVE, "ambiguous", ("backlash",), [PAIR, ("backlash", "gear_ratio")]), "wrong"),
        (grade(DRIVE, "nothing_missing", adequate=[()]), "missed"),
        (grade(DRIVE, "unexplained"), "unexplained"),
        (grade(PAIR, "established", PAIR, [PAIR]), "right"),
        (grade(PAIR, "ambiguous", ("backlash",), [PAIR, ("arm_bending", "backlash")]), "right, among rivals"),
        (grade(PAIR, "established", ("backlash",), [("backlash",)]), "in part"),
        (grade((), "unexplained", faults=["hose"]), "right"),
        (grade((), "nothing_missing", adequate=[()], faults=["hose"]), "missed"),
        (grade((), "ambiguous", adequate=[DRIVE, BEND], faults=["hose"]), "taken for a known effect"),
        (grade((), "established", DRIVE, [DRIVE], faults=["hose"]), "wrong"),
    ],
)
def test_grades(made, words):
    assert made.mark.value == words


def test_what_is_hidden_decides_what_is_asked():
    assert [Facts(e, f).kind for e, f in (((), ()), (DRIVE, DRIVE), (PAIR, PAIR), ((), ("hose",)))] == [
        "none", "single", "pair", "outside",
    ]  # fmt: skip


def test_bounds_count_what_they_say():
    grades = [
        grade((), "nothing_missing", adequate=[()]),
        grade((), "established", DRIVE, [DRIVE]),
        grade(DRIVE, "established", DRIVE, [DRIVE]),
        grade(DRIVE, "ambiguous", adequate=[BEND]),
        grade(DRIVE, "nothing_missing", adequate=[()]),
        grade(DRIVE, "nothing_missing", adequate=[()], size=3.0),  # too small to be asked for
        grade(PAIR, "established", PAIR, [PAIR]),
        grade(PAIR, "established", ("backlash",), [("backlash",)], distance=2.0),  # one of them all but explains both
        grade((), "unexplained", faults=["hose"]),
        grade((), "established", DRIVE, [DRIVE], faults=["hose"]),
        grade((), "established", DRIVE, [DRIVE], faults=["hose"], distance=1.0),
    ]
    assert {line.name: (line.hits, line.n) for line in lines(grades)} == {
        "false_alarms": (1, 2), "inside": (1, 2), "found": (1, 3), "false_established": (3, 11), "pairs": (1, 1),
        "outside": (1, 2),
    }  # fmt: skip


def test_chance_is_allowed_for_and_no_more():
    allowed = int(binom.ppf(0.95, 200, 0.05))
    assert Line("a", "", 0.05, True, 10, 200).verdict == "holds"
    assert Line("a", "", 0.05, True, allowed, 200).verdict == "within chance"
    assert Line("a", "", 0.05, True, allowed + 2, 200).verdict == "falls short"
    assert Line("a", "", 0.90, False, 45, 50).verdict == "holds"
    assert Line("a", "", 0.90, False, 44, 50).verdict == "within chance"
    assert Line("a", "", 0.90, False, 38, 50).verdict == "falls short"
    assert Line("a", "", 0.90, False, 0, 0).verdict == "not tested"


@pytest.fixture
def folder(tmp_path):
    def sealed(name, kind, effects, faults, s, outside):
        listed = [{"fault": f, "effect": e, "s": s} for f, e in faults]
        content = {"schema": blind.SCHEMA, "kind": kind, "design": "rich", "effects": effects, "faults": listed}
        path = tmp_path / "sealed" / f"{name}.json"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps({**content, "s": s, "s_outside": outside}))

    sealed("001", "none", [], [], 0.0, 0.0)
    sealed("002", "single", ["base_drift"], [("tracker_drift", "base_drift")], 9.0, 0.0)
    return tmp_path


def diagnosis(folder, name, verdict, established=(), adequate=(), **more):
    content = {
        "schema": "pcalib.diagnosis/1", "verdict": verdict, "established": list(established),
        "adequate": [list(a) for a in adequate], "candidates": [],
    }  # fmt: skip
    (folder / f"{name}.diagnosis.json").write_text(json.dumps({**content, **more}))


def test_a_folder_is_scored(folder, tmp_path, capsys):
    diagnosis(folder, "001", "nothing_missing", (), [()])
    diagnosis(folder, "002", "established", ["base_drift"], [["base_drift"]])
    assert cli.main(["score", str(folder), "--json", str(tmp_path / "score.json")]) == 0
    assert "2 of 2 diagnoses are right" in capsys.readouterr().out
    got = json.loads((tmp_path / "score.json").read_text())
    assert got["schema"] == "pcbench.score/1" and got["holds"] and got["grades"] == {"right": 2}
    assert [s["truth"] for s in got["sets"]] == [[], ["base_drift"]]


def test_a_wrong_answer_and_a_missing_one_show(folder, capsys):
    diagnosis(folder, "002", "established", ["thermal_rods"], [["thermal_rods"]])
    found = score(folder)
    assert found.missing == ("001",) and found.grades[0].mark is Mark.WRONG and not found.holds
    assert cli.main(["score", str(folder)]) == 1
    said = capsys.readouterr().out
    assert "Without a diagnosis: 001" in said and "1 is wrong" in said


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "not valid JSON"),
        ("[]", "not a JSON object"),
        ('{"schema": "pcalib.fit/1"}', "schema is 'pcalib.fit/1'"),
        ('{"schema": "pcalib.diagnosis/1", "verdict": "fine", "established": [], "adequate": []}', "verdict is 'fine'"),
        ('{"schema": "pcalib.diagnosis/1", "verdict": "unexplained"}', "'established' is missing"),
    ],
)
def test_what_is_no_diagnosis_is_refused(folder, content, said):
    (folder / "001.diagnosis.json").write_text(content)
    with pytest.raises(InputError, match=said.replace("'", ".")):
        score(folder)


def test_a_folder_without_truths_or_answers_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="no diagnosis"):
        score(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no sealed truths"):
        score(tmp_path / "empty")
