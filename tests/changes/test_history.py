"""Histories: dates, alarms over all sessions, the chart and the JSON of `pcalib changed` with several files."""

import json
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from bench import plan as plans
from bench.jobs.changes import pairs
from pcalib import cli, modelfile
from pcalib.changes.history import history, when
from pcalib.data import measurement
from pcalib.errors import InputError


@pytest.fixture(scope="module")
def weeks(tmp_path_factory):
    """A Delta whose rod 21 is 60 µm shorter from the third of four checks on; files in the wrong order."""
    folder = tmp_path_factory.mktemp("weeks")
    drawn = replace(pairs.Pair.draw("delta", 12, "aligned", np.random.default_rng(3)), stated=1.0)
    modelfile.save(folder / "march.toml", drawn.model)
    moved = pairs.part(drawn.robot, "l21", np.random.default_rng(0))
    size = 60e-6 / float(np.abs(moved.errors).max())
    files = []
    for week in range(4):
        plan = plans.make(drawn.robot, "random", 12, tools=pairs.tools(drawn.robot), seed=50 + week)
        data = drawn.later(plan, week + 1).second([moved], [size if week >= 2 else 0.0])
        day = date(2026, 3, 1 + 7 * week)
        files.append(folder / (f"{day.isoformat()}.csv" if week % 2 else f"week{week}.csv"))
        measurement.save(files[-1], data if week % 2 else replace(data, date=day))
    return folder, files


def test_sessions_are_ordered_by_their_dates_and_the_change_has_its_first(weeks, capfd):
    folder, files = weeks
    out, page = folder / "h.json", folder / "h.html"
    code = cli.main(["changed", *map(str, reversed(files)), "--model", str(folder / "march.toml"),
                     "--chart", str(page), "--json", str(out)])  # fmt: skip
    assert code == 0
    said = json.loads(out.read_text())
    assert said["schema"] == "pcalib.changes/1"
    assert [s["date"] for s in said["sessions"]] == ["2026-03-01", "2026-03-08", "2026-03-15", "2026-03-22"]
    quiet = [s["verdict"] == "nothing_changed" for s in said["sessions"]]
    assert quiet == [True, True, False, False]
    assert all(["l21"] in s["adequate"] for s in said["sessions"][2:])
    landing = [s["landing_um"] for s in said["sessions"]]
    assert min(landing[2:]) > 1.5 * max(landing[:2])
    text = page.read_text()
    assert "Something changed in 2 of 4 sessions, first in 2026-03-15." in text and text.count("<svg") == 2
    assert "2026-03-15, lands within" in capfd.readouterr().out


def test_every_session_of_a_history_is_judged_more_strictly(weeks):
    folder, files = weeks
    model = modelfile.load(folder / "march.toml")
    one = (files[0], measurement.load(files[0], model.robot))
    assert history(model, [one] * 4)[0].found.critical < history(model, [one])[0].found.critical


def test_a_date_stands_in_the_file_or_in_its_name(weeks):
    _, files = weeks
    data = measurement.load(files[1])
    assert data.date is None and when(files[1], data) == date(2026, 3, 8)
    assert when(Path("2026-13-40.csv"), data) is None
    assert when(Path("check_20260601.csv"), data) == date(2026, 6, 1)
    broken = files[0].with_name("broken.csv")
    broken.write_text(files[0].read_text().replace("# date = 2026-03-01", "# date = first of March"))
    with pytest.raises(InputError, match="is no date"):
        measurement.load(broken)
