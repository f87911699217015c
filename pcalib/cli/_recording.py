"""`pcalib import FORM FILE --robot R --commands C`: an instrument's readings and the robot's commands as one file."""

from __future__ import annotations

from pathlib import Path

from pcalib import recordings, units
from pcalib import robot as robots
from pcalib.cli._next import say_next
from pcalib.cli.frame import say, write_json
from pcalib.data import measurement
from pcalib.errors import InputError, unknown
from pcalib.recordings import dwells, pairing
from pcalib.wording import some_lines

_SHOWN = 12
"""Lines or rows that a sentence spells out."""


def run(
    form: str,
    file: Path | None,
    robot: Path | None,
    commands: Path | None,
    pair: str | None,
    settings: tuple[str, ...],
    output: Path | None,
    json: Path | None,
) -> None:
    """Read both, pair them, write the measurements, and list what could not be paired."""
    reader = recordings.FORMS.get(form)
    if file is None:
        say(f"{form}: {reader.summary}. Needs --robot and --commands; --set sigma_pos=… and sigma_rot=… state σ.")
        write_json(json, {"schema": "pcalib.import/1", "form": form, "settings": []})
        return
    if robot is None or commands is None or output is None:
        raise InputError(
            f"form {form} holds readings only", remedy="give --robot, --commands with a file of the commands, and -o"
        )
    sigma = _sigma(settings)
    described = robots.load(robot)
    asked = measurement.load(commands, described, measured=False)
    found = reader.read(file)
    read = dwells.dwells(found) if len(found) > 3 * len(asked) or pair == "time" else found
    by = pair or ("name" if read.label and any(n in asked.notes for n in ("name", "point", "label")) else "order")
    if by not in pairing.BY:
        raise InputError(unknown("--pair", by, pairing.BY))
    data, pairs = pairing.measured(read, asked, described, by, sigma)
    measurement.save(output, data)
    say(f"{len(data)} readings paired with {len(set(pairs.command))} of {len(asked)} commands by {by}, in {output}.")
    for note in read.notes:
        say(f"- {note}")
    lost, extra = asked.lines[pairs.lost], read.lines[pairs.extra]
    if len(lost):
        say(f"- {_counted(len(lost), 'command')} without a reading, on {some_lines(lost, _SHOWN)} of {commands.name}.")
    if len(extra):
        where = f"{some_lines(extra, _SHOWN)} of {file.name}"
        say(f"- {_counted(len(extra), 'reading')} without a command, on {where}, left out.")
    say_next("inspect", output, "--robot", robot)
    write_json(json, {
        "schema": "pcalib.import/1", "form": form, "rows": len(data), "paired_by": by, "notes": list(read.notes),
        "commands_without_reading": lost, "readings_without_command": extra,
    })  # fmt: skip


def _sigma(settings: tuple[str, ...]) -> tuple[float | None, float | None]:
    known = {"sigma_pos": "length", "sigma_rot": "angle"}
    found: dict[str, float] = {}
    for text in settings:
        key, _, value = text.partition("=")
        if key not in known:
            raise InputError(unknown("setting", key, known))
        found[key] = float(units.parse_quantity(value, known[key], option=key)[0])
    return found.get("sigma_pos"), found.get("sigma_rot")


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n > 1)}"
