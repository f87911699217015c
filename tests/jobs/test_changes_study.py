"""The study of changes on a few pairs: right figures in its table, and its bounds are counted as they are stated."""

import pytest

from bench.jobs import running
from bench.jobs.changes.study import ChangesStudy, inside, lines


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
