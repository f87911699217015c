"""A single wild reading of a sensor is named, and the others are judged without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import plan as plans
from bench import sensors as virtual
from bench import simulate, truth
from bench.instrument import Instrument
from pcalib.fitting import as_drawn, mixups
from pcalib.fitting.wild import wild
from pcalib.inspection import inspect

SENSORS = {
    "ballbar": {"sigma_um": 5, "stations_mm": [300, 0, -1050, -200, 250, -1050, -150, -280, -1050]},
    "inclinometer": {"sigma_urad": 50, "zero_mrad": [3, -2], "level_mrad": [1, 2], "turn_deg": 1},
}


def read(robot, seed, scale=1.0):
    """What a ballbar at three stations and an inclinometer read of a robot with errors."""
    errors = scale * truth.draw_errors(robot, 1e-4, np.radians(0.05), seed)
    made = tuple(virtual.make(name, table) for name, table in SENSORS.items())
    real = truth.Truth(robot, errors, Instrument(kind="none"), (), made)
    plan = plans.make(robot, "random", 75, tools=[(0.0, 0.0, 0.0), (0.0, 0.0, -0.15)], seed=seed)
    return simulate.run(real, plan, seed).measurements


def spoilt(data, row, change):
    """The data with one reading changed."""
    value = data.readings.value.copy()
    value[row] = change(value[row])
    return replace(data, readings=replace(data.readings, value=value))


@pytest.mark.parametrize("seed", range(4))
def test_readings_of_a_right_file_are_not_wild(delta, seed):
    assert wild(read(delta, seed, scale=3.0), delta) == ()


@pytest.mark.parametrize(
    ("sensor", "change"),
    [
        ("distance", lambda v: v * 1e12),
        ("distance", lambda v: v * 10),
        ("distance", lambda v: v + 0.02),
        ("inclinometer", lambda v: v + 0.2),
    ],
)
def test_one_wild_reading_is_named_and_set_aside(delta, sensor, change):
    data = read(delta, 5)
    row = int(np.flatnonzero(data.readings.sensor == sensor)[17])
    bad = spoilt(data, row, change)
    assert [each.rows.tolist() for each in wild(bad, delta)] == [[row]]
    said = as_drawn.rows_apart(as_drawn.compare(bad, delta), bad)
    assert f"line {data.lines[row]}." in said and "of the nominal robot" in said
    assert not mixups.judge(bad, delta).far
    assert [f.code for f in inspect(bad, delta).findings if "nominal robot" in f.message] == ["far_rows"]


def test_two_rows_that_changed_places_are_both_named(delta):
    data = read(delta, 6)
    rows = np.flatnonzero((data.readings.sensor == "distance") & (data.readings.to == "A"))
    assert len(rows) > 16
    a, b = rows[[2, 9]]
    value = data.readings.value.copy()
    value[[a, b]] = value[[b, a]]
    found = wild(replace(data, readings=replace(data.readings, value=value)), delta)
    assert [each.rows.tolist() for each in found] == [[a, b]]


def test_where_many_readings_are_off_none_is_called_wild(delta):
    data = read(delta, 7)
    rows = np.flatnonzero(data.readings.sensor == "distance")
    value = data.readings.value.copy()
    value[rows[::2]] *= np.random.default_rng(0).uniform(0.3, 3.0, (len(rows[::2]), 1))
    found = wild(replace(data, readings=replace(data.readings, value=value)), delta)
    assert not any(each.dimension == "length" for each in found)
