"""The specs that come with the project."""

from __future__ import annotations

import pytest

from bench.jobs import study
from bench.jobs.campaign import spec
from bench.jobs.campaign.regress import load
from bench.jobs.campaign.study import Campaign
from bench.kinds import MODELS

SPECS = MODELS.parent / "bench" / "specs"


@pytest.mark.parametrize("name", sorted(path.stem for path in SPECS.glob("*.toml")))
def test_every_spec_runs(name):
    path = SPECS / f"{name}.toml"
    campaign = spec.load(path)
    assert campaign.name == name
    assert f"bench/specs/{name}.toml" in path.read_text()  # says how it is run
    rows = study.rows(Campaign(campaign), [campaign.n_trials - 1])
    assert all(row["status"] == "ok" for row in rows), [row["reason"] for row in rows]


def test_the_committed_baseline_is_of_the_spec_beside_it():
    figures = load(SPECS / "regression.baseline.json", spec.load(SPECS / "regression.toml"))
    assert any(figure.kind == "time" for figure in figures.values())
    complete = figures["complete, tool 300 mm: RMS"].value
    assert complete < 30e-6 < 1e-3 < figures["model24, tool 300 mm: RMS"].value


def test_the_promise_of_the_thousand():
    campaign = spec.load(SPECS / "thousand.toml")
    cell = campaign.cell(0)
    assert campaign.n_trials == 1000 and cell.poses.poses == 40 and cell.verify.targets == 200
    assert len(cell.methods) == 4 and len(cell.verify.tools) == 3
