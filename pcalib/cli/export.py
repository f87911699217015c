"""The calibrated robot as code for a controller or as a model for a simulator.

pcalib export m.toml --to c -o robot
pcalib export m.toml --to st -o robot
pcalib export m.toml --to mjcf -o robot
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pcalib.cli.frame import JsonOption, Writes, say, write_json


def command(
    model: Path,
    /,
    *,
    to: str,
    output: Annotated[Path, Parameter(name=["--output", "-o"]), Writes(folder=True)],
    json: JsonOption = None,
) -> int | None:
    """The calibrated robot as code for a controller or as a model for a simulator.

    Args:
        model: Model file, as 'pcalib fit' writes it.
        to: c (C99: forward and inverse kinematics with a self-test), st (structured text for a PLC), linuxcnc (a
            kinematics module), or mjcf (a model of MuJoCo).
        output: Folder for the files; it is made where it does not exist.
    """
    from pcalib import modelfile, outputs
    from pcalib.export import TARGETS

    target = TARGETS.get(to)
    written = target.write(modelfile.load(model))
    output.mkdir(parents=True, exist_ok=True)
    for name, text in written.items():
        outputs.write_text(output / name, text)
    write_json(json, {"schema": "pcalib.export/1", "to": to, "files": [str(output / name) for name in written]})
    say(f"{target.about}: {', '.join(written)} written to {output}.")
    print(f"Next: {target.next.format(folder=output)}")  # never wrapped: it is to be pasted
    return None
