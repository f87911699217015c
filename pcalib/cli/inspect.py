"""What is in a measurement file, and what is wrong with it.

    pcalib inspect data.csv
    pcalib inspect data.csv --robot models/delta.toml --json findings.json
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli import frame
from pcalib.cli._next import say_next
from pcalib.cli.frame import JsonOption


def command(data: Path, /, *, robot: Path | None = None, json: JsonOption = None) -> int | None:
    """What is in a measurement file, and what is wrong with it.

    Says what is measured and under which conditions, how noisy replicates are, and what is lacking for later steps.
    With a robot file, values are also judged against its joint range, its workspace and its nominal geometry.

    Args:
        data: Measurement file, CSV or Parquet.
        robot: Robot file (TOML), or the name of a robot of models/: delta.
    """
    from pcalib import inspection
    from pcalib import robot as robots
    from pcalib.data import measurement

    described = robots.load(robot) if robot is not None else None
    result = inspection.inspect(measurement.load(data, described), described)
    frame.write_json(json, result.to_json())
    frame.show_table(("", ""), inspection.words(result.facts), title=str(data))
    frame.show_table(
        ("joint", "from", "to", "unit", "share of its range"),
        [
            (j["name"], f"{j['min']:.2f}", f"{j['max']:.2f}", j["unit"], _share(j["share_of_range"]))
            for j in result.facts["joints"]
        ],
    )
    for finding in result.findings:
        frame.say(f"- {finding.level}: {finding.message} {finding.remedy}".rstrip())
    if result.errors:
        first = result.errors[0]
        return frame.fail(f"{data}: {first.message}\n  {first.remedy}")
    if robot is None:
        say_next("inspect", data, "--robot", "robot.toml", why="to judge the values too")
    elif not result.absurd:
        say_next("fit", data, "--robot", robot, "-o", "model.toml")
    return frame.OK


def _share(value: float) -> str:
    return f"{100 * value:.0f} %" if value == value else "–"
