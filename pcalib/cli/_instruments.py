"""`pcalib plan --instrument`: poses, tools and stations for sensors that read no pose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcalib import sensors, stations, units
from pcalib.cli.frame import say, write_json
from pcalib.data import table
from pcalib.errors import InputError, unknown
from pcalib.robot import Robot
from pcalib.stations import Asked


def run(
    robot: Robot,
    n: int,
    instrument: Sequence[str],
    station: Sequence[str],
    reach: np.ndarray | None,
    tools: np.ndarray | None,
    level: str,
    repeat: int,
    seed: int,
    output: Path,
    json: Path | None,
) -> None:
    """Choose the rows and write them.

    Args:
        instrument: 'ballbar' or 'ballbar:2um' each.
        station: places 'x,y,z' with a unit; chosen where there are none.
        reach: (2,) [m] shortest and longest distance.
    """
    asked = [_asked(text, station, reach) for text in instrument]
    if (station or reach is not None) and not any(one.sensor.to == "station" for one in asked):
        raise InputError("--station and --reach belong to an instrument that measures distances", remedy="add ballbar")
    found = stations.plan(robot, n, asked, tools=tools, level=level, seed=seed)
    again = np.unique(np.linspace(0, n - 1, min(repeat, n)).astype(int)) if repeat else np.zeros(0, int)
    rows = np.concatenate([np.arange(n), again])
    suffix, factor = robot.command_unit, units.UNITS[robot.command_unit].factor
    columns: dict[str, Any] = {
        f"{name}_{suffix}": found.q[rows, i] / factor for i, name in enumerate(robot.mechanism.actuators)
    }
    if tools is not None:
        columns |= {f"tool_{axis}_mm": found.tool[rows, i] * 1e3 for i, axis in enumerate("xyz")}
    columns |= {f"nominal_{axis}_mm": found.position[rows, i] * 1e3 for i, axis in enumerate("xyz")}
    if found.places:
        columns["station"] = [str(name) for name in found.to[rows]]
    columns["pose_id"] = rows + 1
    table.write(output, columns, {"robot": robot.name, **stations.metadata(asked, found)})
    twice = f", {len(again)} of them twice, which verifies the noise" if len(again) else ""
    say(f"{n} poses{twice}, written to {output}: {len(rows)} rows.")
    for name, place in found.places.items():
        used = int(np.sum(found.to == name))
        say(f"- station {name} at about {', '.join(f'{1e3 * v:.0f}' for v in place)} mm, base frame: {used} poses")
    say(
        f"- They identify {found.identified} of {found.unknowns} directions of level {level}; where the base stands is "
        "not among them."
    )
    write_json(json, {
        "schema": "pcalib.plan/1", "poses": n, "level": level, "q_si": found.q, "tool_m": found.tool,
        "instruments": [one.sensor.name for one in asked], "station": found.to.tolist(),
        "stations_mm": {name: 1e3 * place for name, place in found.places.items()},
        "identified": found.identified, "unknowns": found.unknowns,
    })  # fmt: skip


def _asked(text: str, station: Sequence[str], reach: np.ndarray | None) -> Asked:
    name, _, said = text.partition(":")
    known = {called: sensor for sensor in sensors.every() for called in sensor.instruments}
    if name not in known:
        raise InputError(
            unknown("instrument", name, known), remedy="without --instrument, plan is for one that reads positions"
        )
    sensor = known[name]
    dimension = next(iter(sensor.quantities.values()))[1]
    sigma = units.parse_quantity(said, dimension, option=f"--instrument {name}")[0] if said else sensor.usual_sigma
    if not sigma > 0:
        raise InputError(f"--instrument {text}: σ must be more than 0", remedy="say how well it measures, 1σ")
    if sensor.to != "station":
        return Asked(sensor, float(sigma))
    places = [units.parse_quantity(place, "length", option="--station") for place in station]
    if any(len(place) != 3 for place in places):
        raise InputError("--station needs 3 numbers", remedy="for example 300,0,-1050mm")
    low, high = (0.0, np.inf) if reach is None else reach
    if not 0 <= low < high:
        raise InputError("--reach needs the shortest, then the longest distance", remedy="for example 100,300mm")
    return Asked(sensor, float(sigma), (float(low), float(high)), {chr(65 + i): p for i, p in enumerate(places)})
