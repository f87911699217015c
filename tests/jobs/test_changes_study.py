"""The study of changes on a few pairs: right figures in its table, and its bounds are counted as they are stated."""

import json

import pytest

from bench import cli as bench_cli
from bench.jobs import running
from bench.jobs.changes.study import ChangesStudy, inside, lines
from pcalib import cli


@pytest.fixture(scope="module")
def rows():
    return running.table(ChangesStudy(0, 18, 0)).to_pylist()


def test_pairs_of_every_robot_size_and_set_up(rows):
    assert {(r["kind"], r["n"], r["setup"]) for r in rows} == {
        (kind, n, setup)
        for kind in ("delta", "linear_delta", "hexapod")
        for n in (12, 40)
        for setup in ("same", "aligned", "tracker")
    }
    assert {r["what"] for r in rows} == {"nothing", "single", "pair", "slip"}
    assert all(bool(r["truth"]) == (r["what"] != "nothing") for r in rows)


def test_no_bound_is_missed_by_more_than_chance(rows):
    assert [line.name for line in lines(rows) if line.verdict == "falls short"] == []
    landed = [r for r in rows if r["landed_full"] is not None]
    assert landed and all(r["landed_update"] < r["landed_before"] for r in landed if r["s"] > 12)


def test_a_right_answer_is_the_whole_truth():
    asked = {"truth": ["a11", "l32"], "adequate": [["l32"], ["l32", "a11"]]}
    assert inside(asked)
    assert not inside({**asked, "adequate": [["l32"]]})


def test_blind_pairs_are_asked_and_scored(tmp_path, capfd):
    folder = tmp_path / "pairs"
    assert bench_cli.main(["blind", "--changed", "--seed", "1", "-n", "3", "-o", str(folder)]) == 0
    again = tmp_path / "again"
    assert bench_cli.main(["blind", "--changed", "--seed", "1", "-n", "3", "-o", str(again)]) == 0
    assert (again / "003.csv").read_bytes() == (folder / "003.csv").read_bytes()
    assert bench_cli.main(["score", str(folder)]) == 2  # nobody has answered yet
    for name in ("001", "002", "003"):
        model = str(folder / f"{name}.toml")
        fit = ["fit", str(folder / f"{name}.first.csv"), "--robot", str(folder / "robot.toml"), "-o", model]
        assert cli.main(fit) == 0
        ask = ["changed", str(folder / f"{name}.csv"), "--model", model, "--json", str(folder / f"{name}.changes.json")]
        assert cli.main(ask) == 0
    out = tmp_path / "score.json"
    assert bench_cli.main(["score", str(folder), "--json", str(out)]) == 0
    sets = json.loads(out.read_text())["sets"]
    assert [s["truth"] for s in sets] == [[], [], ["arm1"]] and ["arm1"] in sets[2]["adequate"]
    (folder / "002.changes.json").unlink()
    capfd.readouterr()
    assert bench_cli.main(["score", str(folder)]) == 1
    assert "Without an answer: 002." in capfd.readouterr().out
