"""Laws that no library lists are found, from data that another simulator made."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from pcalib import robot as robots
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.problem import problem
from pcalib.fitting import identification
from pcalib.laws import telling
from pcalib.laws.proposal import Proposals
from pcalib.laws.search import propose

CASES = Path(__file__).parents[1] / "cases" / "own_delta"


@lru_cache(maxsize=8)
def _proposals(name: str) -> Proposals:
    robot = robots.load(CASES / "robot.toml")
    data = measurement.load(CASES / f"{name}.csv", robot)
    return propose(problem(identification.fit(data, robot).model, data))


def test_nothing_is_proposed_where_nothing_is_missing():
    found = _proposals("plain")
    assert not found.families
    assert found.p > 0.05
    assert telling.sentence(found).startswith("No law found")


def test_an_elbow_that_follows_the_next_arm():
    # True: every elbow sits off along its arm by 120 µm times the sine of the next arm's angle.
    best = _proposals("elbow").families[0].first
    (law,), (theta,) = best.laws, best.theta
    assert best.adequate and best.p < 0.01
    assert (law.channel.words, law.sharing) == ("elbows along their arm", "common")
    assert [s.variable.words for s in law.term.variables] == ["the next arm's angle"]
    assert theta[0] == pytest.approx(120e-6, rel=0.2)


def test_a_frequency_needs_no_whole_number():
    best = _proposals("ripple17p3").families[0].first
    assert best.adequate
    assert best.laws[0].channel.name == "actuator"
    assert best.laws[0].term.constant == pytest.approx(17.3, abs=0.03)


def test_two_at_once_are_a_law_beside_a_listed_effect():
    # True: warm rods and a gear ripple of 30 per turn. The ripple is listed, and so are warm rods.
    best = _proposals("both").families[0].first
    assert best.adequate and [c.name for c in best.beside] == ["gear_ripple"]
    assert [s.variable.name for s in best.laws[0].term.variables] == ["temp_rods"]
    assert "thermal_rods" not in best.words()  # the law is named by what it is


def test_json_and_files(tmp_path):
    found = _proposals("elbow")
    content = telling.as_json(found, tmp_path)
    first = content["laws"][0]
    assert content["schema"] == "pcalib.proposal/1"
    assert (first["channel"], first["variables"], first["function"]) == ("elbow", ["q"], "linear")
    assert first["adequate"] and first["s"] > 6 and np.isfinite(first["bic"])
    written = telling.write(found, tmp_path, "elbow.csv")
    assert first["spec"] in written and all(path.exists() for path in written.values())


def test_few_rows_propose_nothing_or_something_adequate():
    robot = robots.load(CASES / "robot.toml")
    data: Measurements = measurement.load(CASES / "plain.csv", robot).take(slice(0, 14))
    found = propose(problem(identification.fit(data, robot, "classical").candidate, data))
    assert found.tried > 0 and np.isfinite(found.p)
