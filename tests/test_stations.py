"""Rows for sensors that read no pose: within reach, spread over stations, and better than chance."""

import numpy as np
import pytest

from pcalib import planning, sensors, stations
from pcalib.cli import main
from pcalib.data import measurement
from pcalib.errors import InputError

TOOLS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.15]])
REACH = (0.1, 0.3)


def ballbar(**more):
    return stations.Asked(sensors.get("distance"), 2e-6, REACH, **more)


@pytest.fixture(scope="module")
def planned(delta):
    return stations.plan(delta, 90, [ballbar()], tools=TOOLS, candidates=600)


def spread(delta, rows, level="complete"):
    """RMS [m] of the TCP with the longest tool, beside a rigid motion, as readings of these rows leave it."""
    there = stations._There(delta, rows.q, rows.tool, rows.position)
    blocks, free = stations._blocks(there, [ballbar()], rows.to, rows.places, level)
    J = blocks.reshape(-1, blocks.shape[-1])
    wanted = stations._wanted(delta, TOOLS, level, np.random.default_rng(5))
    L = np.pad(wanted, ((0, 0), (0, J.shape[1] - free)))
    return np.sqrt(np.trace(L @ np.linalg.solve(np.eye(J.shape[1]) + J.T @ J, L.T)))


def test_rows_are_within_reach_of_stations_that_are_used_alike(planned):
    assert list(planned.places) == ["A", "B", "C"]
    d = [np.linalg.norm(x - planned.places[to]) for x, to in zip(planned.position, planned.to, strict=True)]
    assert min(d) >= REACH[0] and max(d) <= REACH[1]
    assert {to: int(np.sum(planned.to == to)) for to in "ABC"} == {"A": 30, "B": 30, "C": 30}
    assert 30 < planned.identified < planned.unknowns == 60


def test_they_tell_more_than_random_rows(delta, planned):
    found = planning.reachable(delta, 4000, np.random.default_rng(3))
    rng = np.random.default_rng(4)
    tool = TOOLS[rng.integers(0, 2, len(found.q))]
    x = found.pose.x + tool
    to, inside = stations._dealt(x, planned.places, REACH, rng)
    rows = np.flatnonzero(inside)[: len(planned.q)]
    random = stations.Rows(found.q[rows], tool[rows], x[rows], to[rows], planned.places, 0, 60)
    assert len(rows) == len(planned.q) and spread(delta, planned) < 0.7 * spread(delta, random)


def test_stations_that_stand_already_stay(delta):
    places = {"A": np.array([0.2, 0.0, -1.0]), "B": np.array([-0.2, 0.1, -1.0])}
    found = stations.plan(delta, 20, [ballbar(places=places)], tools=TOOLS, candidates=400)
    assert found.places == places and set(found.to) == {"A", "B"}


def test_stations_out_of_reach_are_refused(delta):
    with pytest.raises(InputError, match="within reach of the stations"):
        stations.plan(delta, 20, [ballbar(places={"A": np.array([2.0, 0, 0])})], candidates=100)


def test_the_plan_of_the_command_starts_a_measurement_file(tmp_path, delta, capsys):
    plan = tmp_path / "plan.csv"
    tools = ["--tool", "0,0,0mm", "--tool", "0,0,-150mm"]
    bar = ["--instrument", "ballbar:2um", "--instrument", "inclinometer:20urad", "--reach", "100,300mm"]
    assert main(["plan", "--robot", "delta", "-n", "30", *bar, *tools, "-o", str(plan)]) in (0, None)
    said = capsys.readouterr().out
    assert "station A at about" in said and "where the base stands is not among them" in " ".join(said.split())
    head, *rows = [line for line in plan.read_text().splitlines()]
    start = next(i for i, line in enumerate(rows) if line.startswith("q1_deg"))
    rows[start] += ",distance_mm,tilt_x_mrad,tilt_y_mrad"
    rows[start + 1 :] = [f"{row},200,1,2" for row in rows[start + 1 :]]
    (tmp_path / "data.csv").write_text("\n".join([head, *rows]))
    data = measurement.load(tmp_path / "data.csv", delta)
    assert len(data) == 2 * 40 and data.stated == (True, True) and data.sigma[0, 0] == pytest.approx(2e-6)
    assert isinstance(data.readings.options["station_A_mm"], np.ndarray)


@pytest.mark.parametrize(
    "options, problem",
    [
        (["--instrument", "cat"], "unknown instrument 'cat'"),
        (["--instrument", "ballbar:2kg"], "not a unit|unknown unit"),
        (["--instrument", "inclinometer", "--reach", "1,2m"], "belong to an instrument that measures distances"),
        (["--instrument", "ballbar", "--reach", "300,100mm"], "the shortest, then the longest"),
        (["--instrument", "ballbar", "--station", "1,2mm"], "--station needs 3 numbers"),
    ],
)
def test_wrong_instruments_are_refused(tmp_path, options, problem, capsys):
    import re

    assert main(["plan", "--robot", "delta", "-n", "10", *options, "-o", str(tmp_path / "p.csv")]) == 2
    assert re.search(problem, " ".join(capsys.readouterr().err.split()))
