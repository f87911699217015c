"""Laws for what no listed effect explains, written as effect files.

pcalib propose data.csv --model m.toml
pcalib propose data.csv --model m.toml -o laws
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli._next import say_next
from pcalib.cli.frame import JsonOption, SeedOption, Writes, say, show_table, write_json


def command(
    data: Path,
    /,
    *,
    model: ModelOption,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"]), Writes(folder=True)] = None,
    effect_file: EffectFiles = (),
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> int | None:
    """Laws for what no listed effect explains, written as effect files.

    Every combination of a place on the robot (motor angle, rod, elbow, tool point, base, …), a way in which the places
    share it, and a function of what was recorded is tried as an explanation of the residuals. Laws that these data
    cannot tell apart are shown as one, the simplest first. Nothing is proposed where nothing is missing.

    Args:
        data: Measurement file, CSV or Parquet.
        output: Folder for the laws, one Python file each, which 'pcalib add' takes like an effect of your own.
        seed: Seed of the Monte-Carlo draws that set the limits of significance.
    """
    from pcalib.cli._inputs import read
    from pcalib.diagnosis.problem import problem
    from pcalib.laws import telling
    from pcalib.laws.search import propose

    calibrated, measured, own = read(model, data, effect_file)
    found = propose(problem(calibrated, measured, own), seed=seed)
    written = {} if output is None else telling.write(found, output, data.name)
    write_json(json, telling.as_json(found, output))
    say(telling.sentence(found))
    if found.families:
        print()
        show_table(telling.LAWS, telling.rows(found), title=f"Best of {found.tried:,} laws that were tried")
    if output is None:
        if found.families:
            why = "to write them as effects of your own"
            say_next("propose", data, "--model", model, "-o", "laws", why=why)
        return None
    for spec in written:
        say(f"Law written: {spec}")
    for words in telling.next_commands(found, output, str(data), str(model)):
        say_next(*words)
    return None
