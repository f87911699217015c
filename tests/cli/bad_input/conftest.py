"""Bad input to every command: one message with file, line and remedy, exit code 2, and nothing written.

A file of every role is damaged in every way that people and programs damage files, and given to each command that
reads such a file. Each must refuse it by itself: nothing may be found out by a traceback, or by a wrong result.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from bench import cli as pcbench
from bench.jobs.attack import corpus
from bench.jobs.attack.corpus import COMMANDS
from pcalib import cli as pcalib


@pytest.fixture(scope="session")
def cell(tmp_path_factory) -> Path:
    """A folder with a good file of every role."""
    folder = tmp_path_factory.mktemp("cell")
    corpus.make(folder)
    return folder


@pytest.fixture
def refused(cell, monkeypatch, capfd) -> Callable[..., None]:
    """refused(argv, said, name): it ends with 2 and one message that matches `said` and names the file `name`, with a
    remedy, and no file appears or changes."""
    monkeypatch.chdir(cell)

    def check(argv: str, said: str, name: str = "") -> None:
        before = {f: f.stat().st_mtime_ns for f in cell.rglob("*")}
        program, *arguments = argv.split()
        code = (pcalib if program == "pcalib" else pcbench).main(arguments)
        out, err = capfd.readouterr()
        where = f"{argv}\n{out}{err}"
        assert code == 2, where
        # An inspection shows what is in a file that can be read, and then what is wrong with it.
        assert out == "" or (argv.startswith("pcalib inspect") and re.search(said, out)), where
        assert err.startswith("error: ") and err.count("error: ") == 1 and "Traceback" not in err, where
        assert re.search(said, err), f"{said!r} is not said by {where}"
        assert name in err, f"{name} is not named by {where}"
        assert len(err.splitlines()) > 1 or "accepted:" in err or "must be" in err, f"no remedy: {where}"
        assert len(err.splitlines()) < 5 and "Warning" not in err, where
        assert {f: f.stat().st_mtime_ns for f in cell.rglob("*")} == before, where

    return check


@pytest.fixture
def one_refused(refused) -> Callable[..., None]:
    """one_refused(role, file, said, name): the first command that reads a file of that role refuses this one.

    All commands of a role use one reader, so that what is in the file matters only once.
    """

    def check(role: str, file: str, said: str, name: str | None = None) -> None:
        command = COMMANDS[role].strip().splitlines()[0].strip()
        refused(command.replace("{}", file), said, file if name is None else name)

    return check


@pytest.fixture
def each_refused(refused) -> Callable[..., None]:
    """each_refused(role, file, said, name, but): every command that reads a file of that role refuses this one; those
    that match `but` are left out."""

    def check(role: str, file: str, said: str, name: str | None = None, but: str = "$^") -> None:
        commands = [line.strip() for line in COMMANDS[role].strip().splitlines()]
        asked = [command.replace("{}", file) for command in commands if not re.search(but, command)]
        assert asked
        for argv in asked:
            refused(argv, said, file if name is None else name)

    return check
