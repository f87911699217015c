"""Blind data sets: the same bytes for the same seed, a truth that is sealed, and nothing of it in the data."""

import json
from collections import Counter
from pathlib import Path

import pytest

from bench import cli
from bench import truth as truths
from bench.jobs import blind
from pcalib import robot as robots
from pcalib.data import measurement
from pcalib.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
ROBOT = robots.load(ROOT / "models" / "delta.toml")
N = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind") / "sets"
    return folder, blind.make(ROBOT, folder, N, seed=11)


def content(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_same_seed_gives_the_same_bytes_whatever_the_workers(made, tmp_path):
    blind.make(ROBOT, tmp_path / "again", N, seed=11, workers=2)
    assert content(tmp_path / "again") == content(made[0])


def test_a_set_does_not_depend_on_how_many_are_made(made):
    one = blind.draw(ROBOT, 11, 3)
    sealed = json.loads((made[0] / "sealed/003.json").read_text())
    assert {"schema": blind.SCHEMA, "data": "003.csv", **one.facts} == sealed
    assert one.truth == (made[0] / "sealed/003.truth.toml").read_text()


def test_another_seed_gives_other_sets(made):
    assert blind.draw(ROBOT, 12, 1).truth != (made[0] / "sealed/001.truth.toml").read_text()


def test_truths_are_sealed_and_say_what_the_facts_say(made):
    folder, paths = made
    assert [p.name for p in paths] == [f"{i:03d}.csv" for i in range(1, N + 1)]
    for path in paths:
        facts = json.loads((folder / "sealed" / f"{path.stem}.json").read_text())
        truth = truths.load(folder / "sealed" / f"{path.stem}.truth.toml")
        assert [f["fault"] for f in facts["faults"]] == [f.name for f in truth.faults]
        assert not any(f.absent for f in truth.faults)
        assert facts["schema"] == blind.SCHEMA and facts["data"] == path.name
        got = blind.facts_of(facts)
        assert got.kind == facts["kind"] and set(got.effects) == {f["effect"] for f in facts["faults"]} - {None}


def test_the_data_give_nothing_away(made):
    for path in made[1]:
        head = [line for line in path.read_text().splitlines() if line.startswith("#")]
        assert {line.split("=")[0].strip("# ") for line in head} <= {"robot", "frame", "sigma_pos_mm", "sigma_rot_deg"}
        data = measurement.load(path, robots.load(path.parent / "robot.toml"))
        assert data.check.sum() > 10 and (~data.check).sum() > 80


def test_sizes_are_what_was_asked_for_or_more(made):
    for path in sorted((made[0] / "sealed").glob("*.json")):
        facts = json.loads(path.read_text())
        if facts["kind"] == "single":
            assert facts["s"] >= 0.95 * blind.SIZES[0] and facts["s"] <= 1.05 * blind.SIZES[1]
        if facts["kind"] in ("pair", "outside"):
            assert facts["s_outside"] >= 0.95 * blind.PAIRED


def test_all_kinds_come_in_an_order_that_the_seed_decides():
    dealt = [[blind.kind_of(seed, i) for i in range(1, 41)] for seed in (5, 6)]
    for kinds in dealt:
        assert Counter(kinds[:20]) == Counter(kinds[20:]) == Counter(blind.KINDS)
    assert dealt[0] != dealt[1] and dealt[0][:20] != dealt[0][20:]


def test_a_set_is_of_the_kind_that_was_dealt(made):
    kinds = [json.loads((made[0] / f"sealed/{i:03d}.json").read_text())["kind"] for i in range(1, N + 1)]
    assert kinds == [blind.kind_of(11, i) for i in range(1, N + 1)]


def test_what_cannot_be_made_is_refused(made, tmp_path, capsys):
    with pytest.raises(InputError, match="there are data sets in this folder"):
        blind.make(ROBOT, made[0], 1)
    with pytest.raises(InputError, match="cannot make 0 data sets"):
        blind.make(ROBOT, tmp_path / "none", 0)
    assert cli.main(["blind", "-n", "1", "-o", str(made[0])]) == 2
    assert "name a new folder" in capsys.readouterr().err


def test_the_command_writes_them(tmp_path, capsys):
    told = tmp_path / "b.json"
    assert cli.main(["blind", "--seed", "3", "-n", "1", "-o", str(tmp_path / "b"), "--json", str(told)]) == 0
    assert json.loads(told.read_text())["sets"] == ["001.csv"]
    said = capsys.readouterr().out
    assert "pcalib diagnose" in said and "pcbench score" in said
    assert (tmp_path / "b" / "001.csv").exists() and (tmp_path / "b" / "robot.toml").exists()
