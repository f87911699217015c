"""Turn measurements of another origin into a measurement file and a robot file.

    pcalib import motion-capture poses.csv -o data.csv --robot-output platform.toml
    pcalib import carriage-steps steps.csv --set rod=288mm --set radius=140mm -o data.csv --robot-output printer.toml
    pcalib import point-list points.txt --robot delta --commands plan.csv --pair order -o data.csv
    pcalib import carriage-steps
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli._next import say_next
from pcalib.cli.frame import BesideOption, JsonOption, OutputOption, say, show_table, write_json


def command(
    form: str,
    file: Path | None = None,
    /,
    *,
    output: OutputOption = None,
    robot_output: BesideOption = None,
    set: tuple[str, ...] = (),
    robot: Path | None = None,
    commands: Path | None = None,
    pair: str | None = None,
    json: JsonOption = None,
) -> int | None:
    """Turn measurements of another origin into a measurement file and a robot file.

    Forms: motion-capture (a six-leg platform: leg commands in motor revolutions, measured position and quaternion) and
    carriage-steps and bed-heights (a linear Delta printer: carriage steps at contacts with the bed, or heights of the
    bed probed at known x and y). Readings without commands, which --robot and --commands complete: point-list (as
    SpatialAnalyzer, PolyWorks, Leica and FARO write it), matrices (3 × 4 or 4 × 4, a line each), motive (OptiTrack) and
    vicon. In a continuous recording the stops are found. With a form alone its settings are listed.

    Args:
        form: What the file holds.
        file: File to read.
        output: Measurement file to write, CSV or Parquet.
        robot_output: Robot file to write: the robot as drawn or configured.
        set: NAME=VALUE with its unit, for what the file does not hold, e.g. rod=288mm; may be given several times.
        robot: Robot file (TOML), or the name of a robot of models/: delta. For readings without commands.
        commands: The commands that were measured, a table with q1_deg … and what tool, payload and the like they had.
        pair: How readings are paired with commands: name, order (some of either may lack) or time. What cannot be
            paired is listed and left out.
    """
    from pcalib import files, importers, recordings
    from pcalib.data import measurement
    from pcalib.errors import InputError, unknown

    if form in recordings.FORMS.names():
        from pcalib.cli import _recording

        _recording.run(form, file, robot, commands, pair, set, output, json)
        return None
    if form not in importers.names():
        forms = sorted([*importers.names(), *recordings.FORMS.names()])
        raise InputError(unknown("form", form, forms), remedy="'pcalib import --help' describes them")
    importer = importers.get(form)
    if file is None:
        rows = [
            (name, ", ".join(f"{v:.7g}" for v in option.default) + option.unit, option.text)
            for name, option in importer.options.items()
        ]
        settings = [
            {"setting": name, "default": option.default, "unit": option.unit, "text": option.text}
            for name, option in importer.options.items()
        ]
        write_json(json, {"schema": "pcalib.import/1", "form": form, "settings": settings})
        say(f"{form}: {importer.summary}.")
        show_table(("setting", "default", "what it is"), rows)
        return None
    if output is None or robot_output is None:
        raise InputError("two files are written: the measurements and the robot", remedy="give -o and --robot-output")
    found = importers.run(form, file, set)
    with files.atomic(robot_output) as fresh:  # both or neither
        fresh.write_text(found.robot.text, encoding="utf-8")
        measurement.save(output, found.data)
    say(f"{len(found.data)} rows written to {output}, the robot to {robot_output}.")
    for note in found.notes:
        say(f"- {note}")
    say_next("inspect", output, "--robot", robot_output)
    write_json(json, {"schema": "pcalib.import/1", "form": form, "rows": len(found.data), "notes": found.notes})
    return None
