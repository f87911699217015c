"""Turn measurements of another origin into a measurement file and a robot file.

    pcalib import motion-capture poses.csv -o data.csv --robot-output platform.toml
    pcalib import carriage-steps steps.csv --set rod=288mm --set radius=140mm -o data.csv --robot-output printer.toml
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
    json: JsonOption = None,
) -> int | None:
    """Turn measurements of another origin into a measurement file and a robot file.

    Forms: motion-capture (a six-leg platform: leg commands in motor revolutions, measured position and quaternion) and
    carriage-steps and bed-heights (a linear Delta printer: carriage steps at contacts with the bed, or heights of the
    bed probed at known x and y). With a form alone its settings are listed.

    Args:
        form: What the file holds: motion-capture, carriage-steps or bed-heights.
        file: File to read.
        output: Measurement file to write, CSV or Parquet.
        robot_output: Robot file to write: the robot as drawn or configured.
        set: NAME=VALUE with its unit, for what the file does not hold, e.g. rod=288mm; may be given several times.
    """
    from pcalib import files, importers
    from pcalib.data import measurement
    from pcalib.errors import InputError

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
