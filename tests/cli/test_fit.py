"""`pcalib fit` and its traces through the entry point: what is printed of errors small and large."""

import re

import pytest

from pcalib import cli
from pcalib.data import measurement
from pcalib.model import Model


@pytest.fixture(scope="module")
def folder(tmp_path_factory, delta, perturb, measure):
    """A Delta whose lengths are 1 mm off, at 40 poses."""
    where = tmp_path_factory.mktemp("fit")
    measurement.save(where / "data.csv", measure(Model(delta, perturb(1, mm=1.0), "complete"), 40))
    (where / "robot.toml").write_text(delta.text)
    return where


@pytest.fixture
def run(folder, monkeypatch, capsys):
    """A function that runs a command in the folder and gives what it prints."""
    monkeypatch.chdir(folder)

    def call(command):
        assert cli.main(command.split()) == 0
        return capsys.readouterr().out

    return call


def test_errors_over_a_millimetre_are_told_in_mm(run):
    out = run("fit data.csv --robot robot.toml --level nominal -o m.toml")
    assert re.match(r"Level nominal explains 40 poses to \d\.\d\d mm RMS", out), out
    assert re.search(r"fit +40 +\d\.\d\d mm +\d\.\d\d mm ", out), out
    assert re.search(r"data.csv +\d\.\d\d mm +– ", run("log m.toml"))


def test_small_errors_are_told_in_micrometres(run):
    out = run("fit data.csv --robot robot.toml --folds 2")
    assert re.match(r"Level complete explains 40 poses to \d\d\.\d µm RMS", out), out
    assert re.search(r"in 2 folds: [\d.]+ µm RMS at poses not fitted; apparent rod-length errors [\d.]+ µm", out), out
