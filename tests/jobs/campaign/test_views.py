"""What is drawn of a campaign, read back."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from bench.cli import main
from bench.jobs import running
from bench.jobs.campaign import plots, recording, spec, summary, trial
from bench.jobs.campaign.study import Campaign


@pytest.fixture
def found(written, tmp_path):
    """The small campaign with a sweep, done; its summary and results."""
    campaign = spec.load(written(written.small + '[[sweep]]\n"instrument.sigma_pos_mm" = [0.02, 0.03]\n'))
    outcome = running.run(Campaign(campaign), tmp_path / "out", 1)
    return campaign, summary.read(outcome.results), outcome.results


def test_figures_of_a_summary(found):
    campaign, told, _ = found
    assert len(told.groups) == 2 * 2 * 2 and told.failed == 0 and told.spec.paths == ("instrument.sigma_pos_mm",)
    rows = [r for i in range(6) for r in trial.run(campaign, i) if r["method"] == "complete" and r["tool"] == "0,0,0mm"]
    (group,) = summary.select(told.groups, cell=0, method="complete", tool="0,0,0mm")
    rms = np.array([r["rms_um"] for r in rows]) * 1e-6
    assert np.allclose(group.rms, rms) and list(group.robot) == list(range(6))
    assert group.pooled == pytest.approx(np.sqrt(np.mean(rms**2))) and group.worst_robot == np.argmax(rms)
    assert group.worst == pytest.approx(max(r["max_um"] for r in rows) * 1e-6)
    assert group.percentile(50) == pytest.approx(np.median(rms))


def test_failures_are_counted_by_reason(written, tmp_path):
    campaign = spec.load(written(robots="robots = 2", poses="poses = 5"))
    outcome = running.run(Campaign(campaign), tmp_path / "out", 1)
    told = summary.read(outcome.results)
    (reason,) = [r for r in told.reasons if "too few poses" in r and "complete" in r]
    assert told.reasons[reason] == 4
    (group,) = summary.select(told.groups, method="complete", tool="0,0,0mm")
    assert group.failed == 2 and len(group.rms) == 0 and np.isnan(group.pooled) and group.worst_robot is None
    header, rows = summary.table(told)
    assert rows[2][header.index("RMS")] == "–"
    plots.write(told, tmp_path / "plots")


def test_plots(found, tmp_path):
    _, told, _ = found
    paths = plots.write(told, tmp_path / "plots")
    names = {p.name for p in paths}
    assert names == {"distributions.svg", "tool_length.svg", "against_instrument_sigma_pos_mm.svg"}
    again = {p.name: p.read_bytes() for p in plots.write(told, tmp_path / "again")}
    for path in paths:
        text = path.read_text()
        assert "complete" in text or "<use" in text
        assert path.with_suffix(".png").stat().st_size > 5000
        assert again[path.name] == path.read_bytes()  # nothing of when and where


def test_recordings(found, tmp_path):
    from rerun.chunk import RrdReader

    campaign, told, results = found
    (first, second) = recording.write(told, results, tmp_path)
    assert (first.name, second.name) == ("errors-cell0.rrd", "errors-cell1.rrd")
    maps = recording.gather(told, results, 0)
    assert maps is not None and maps.n == 1  # map_robots = 1
    (row,) = [r for r in trial.run(campaign, 0) if r["method"] == "complete" and r["tool"] == "0,0,-300mm"]
    assert np.allclose(maps.percentile[:, 1, 1], np.tile(row["error_um"], (2, 1)) * 1e-6, rtol=1e-6)
    robot, field = maps.worst[0]
    (group,) = summary.select(told.groups, cell=0, method="complete", tool="0,0,-300mm")
    assert robot == group.worst_robot and field.rms[1] == pytest.approx(group.rms.max(), rel=1e-6)
    paths = {str(c.entity_path) for c in RrdReader(str(first)).stream()}
    assert {"/scene/percentile95/tool1/error", f"/scene/robot{robot}/error", "/distribution/lines", "/text"} <= paths


def test_no_recording_without_errors_kept(written, tmp_path):
    campaign = spec.load(written(map_robots="map_robots = 0", robots="robots = 2"))
    outcome = running.run(Campaign(campaign), tmp_path / "out", 1)
    assert recording.write(summary.read(outcome.results), outcome.results, tmp_path) == []


def test_all_of_it_on_the_command_line(written, tmp_path, capsys):
    out = tmp_path / "out"
    report = tmp_path / "r.json"
    spec_file = written(robots="robots = 2")
    assert main(["campaign", str(spec_file), "-o", str(out), "--workers", "1", "--json", str(report)]) == 0
    left = sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file() and not p.name.startswith("."))
    assert left == [
        "campaign.json", "errors.rrd", "plots/distributions.png", "plots/distributions.svg", "plots/tool_length.png",
        "plots/tool_length.svg", "results.parquet", "summary.csv",
    ]  # fmt: skip
    content = json.loads(report.read_text())
    assert content["schema"] == Campaign.SCHEMA and len(content["groups"]) == 4 and content["rate"] > 0
    assert {"rms_um", "max_um", "worst_robot", "failed"} <= set(content["groups"][0])
    said = capsys.readouterr().out
    assert "small" in said and re.search(r"model24 +300 .* mm +\d", said) and re.search(r"complete +0 .* µm +\d", said)
