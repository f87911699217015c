"""Configuration values of a calibrated linear-Delta printer, for Klipper or RepRapFirmware.

    pcalib firmware m.toml
    pcalib firmware m.toml --dialect klipper -o delta.cfg
"""

from __future__ import annotations

from pathlib import Path

from pcalib.cli.frame import JsonOption, OutputOption, say, write_json

DIALECTS = ("klipper", "rrf")


def command(
    model: Path,
    /,
    *,
    dialect: str | None = None,
    output: OutputOption = None,
    json: JsonOption = None,
) -> int | None:
    """Configuration values of a calibrated linear-Delta printer, for Klipper or RepRapFirmware.

    The upper end of the robot file's joint range is where the carriages stand at the endstops. Says what the
    firmware's three-arm model cannot hold, and by how much it therefore misses.

    Args:
        model: Model file, as 'pcalib fit' writes it.
        dialect: klipper or rrf; both when absent.
        output: File to write the values to, of one dialect.
    """
    from pcalib import files, firmware, modelfile
    from pcalib.errors import InputError, unknown

    if dialect is not None and dialect not in DIALECTS:
        raise InputError(unknown("dialect", dialect, DIALECTS))
    if output is not None and dialect is None:
        raise InputError("a file holds the values of one firmware", remedy="say --dialect klipper or --dialect rrf")
    found = firmware.configuration(modelfile.load(model))
    texts = {name: getattr(found, name)() for name in DIALECTS if dialect in (None, name)}
    for name, text in texts.items():
        if output is None:
            print(f"{'# Klipper, printer.cfg' if name == 'klipper' else '; RepRapFirmware, config.g'}\n{text}")
        else:
            files.write_text(output, text)
            say(f"Values for {name} written to {output}.")
    say(found.statement())
    write_json(json, {"schema": "pcalib.firmware/1", **found.json(), **texts})
    return None
