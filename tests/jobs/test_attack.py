"""Damaged files and odd options are taken or refused, by every reader and command; a case repeats from its number."""

from pathlib import Path

import pytest

from bench.jobs.attack import corpus, run


def test_1500_cases(tmp_path):
    assert run.main(["--quick", "--json", str(tmp_path / "attack.json")]) == 0


@pytest.fixture
def folder(tmp_path, monkeypatch):
    run.prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_reader_that_breaks_is_found(folder):
    """What would be a traceback, a hang and a change of another file are each seen."""

    def broken(path: Path) -> None:
        raise KeyError(path.name)

    made = run.Case(0, "robot", b"name = 1", ())
    assert "KeyError" in run.attempt(made, {"robot": broken}).wrong
    assert run.attempt(made, run.readers()) == run.Outcome(2, "")
    good = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    (folder / "m.toml").write_text("gone")
    assert run._changed(folder, good, made) == "m.toml was changed"
    assert (folder / "m.toml").read_bytes() == good[folder / "m.toml"] and not run._changed(folder, good, made)


def test_a_case_repeats(folder):
    assert [run.case(n, 7, folder) for n in range(50)] == [run.case(n, 7, folder) for n in range(50)]
    assert {run.case(n, 7, folder).role for n in range(400)} > set(run.FILES)
    assert all(role in run.FILES or role in ("effect",) for role in corpus.COMMANDS)
