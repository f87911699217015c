"""What to measure next, to tell rival explanations apart.

pcalib next data.csv --model m.toml --between drive_compliance,encoder_eccentricity -n 6 -o plan.csv
pcalib next data.csv --model m.toml --between backlash,nothing --payload 0kg --payload 3kg -n 12 -o plan.csv
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli.frame import JsonOption, say, show_table, write_json


def command(
    data: Path,
    /,
    *,
    model: ModelOption,
    between: str,
    n: Annotated[int, Parameter(name=["--rows", "-n"])] = 6,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    payload: tuple[str, ...] = (),
    tool: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True)] = (),
    effect_file: EffectFiles = (),
    seed: int = 0,
    json: JsonOption = None,
) -> int | None:
    """What to measure next, to tell rival explanations apart.

    Chooses poses, payloads, tools, directions and temperatures at which the two explanations, each at the size that the
    data give it, differ most after everything else has been fitted again. Says too when more of the same will not help.

    Args:
        data: Measurement file, CSV or Parquet: what is known already.
        between: Two explanations separated by a comma: effects, effects joined by +, or 'nothing'.
        n: How many rows to plan.
        output: Plan to write, CSV: to be measured, or given to 'pcbench simulate --plan'.
        payload: A mass at hand, e.g. 2kg; may be given several times. Those of the data when absent.
        tool: A tool at hand, e.g. 0,0,-300mm; may be given several times. Those of the data when absent.
        seed: Of the poses to choose from.
    """
    from pcalib import effects, units
    from pcalib.cli._inputs import read
    from pcalib.diagnosis import discriminate
    from pcalib.diagnosis.problem import problem
    from pcalib.errors import InputError

    sides = [side.strip() for side in between.split(",")]
    files = [name for side in sides for name in side.split("+") if ".py" in name and name not in effect_file]
    calibrated, measured, own = read(model, data, (*effect_file, *files))
    known = {e.name: e for e in own} | {getattr(e, "spec", e.name): e for e in own}
    if len(sides) != 2:
        raise InputError(f"--between '{between}': name two explanations, separated by a comma")
    rivals = [
        [known.get(name) or effects.parse(name, calibrated.robot) for name in side.split("+") if name != "nothing"]
        for side in sides
    ]
    tools = np.array([units.parse_quantity(t, "length", option="--tool") for t in tool]) if tool else None
    if tools is not None and tools.shape[1:] != (3,):
        raise InputError("--tool needs three numbers, e.g. 0,0,-300mm")
    options = discriminate.Options(
        payloads=[float(units.parse_quantity(p, "mass", option="--payload")[0]) for p in payload] or None,
        tools=tools,
        seed=seed,
    )
    found = discriminate.plan(problem(calibrated, measured, own), rivals, n, options)
    say(found.sentence())
    columns = discriminate.table(calibrated.robot, found)
    show_table(
        ("row", *columns, "s so far"),
        [
            (i + 1, *(f"{values[i]:.4g}" for values in columns.values()), f"{found.after[i]:.1f}")
            for i in range(len(found.q))
        ],
    )
    write_json(
        json,
        {
            "schema": "pcalib.next/1", "between": list(found.between), "s_before": found.before, "s_after": found.after,
            "s_more_of_the_same": found.more_of_the_same, "enough": found.enough, "rows": columns,
        },
    )  # fmt: skip
    if output is not None:
        from pcalib import table

        table.write(output, columns, {"robot": calibrated.robot.name})
        say(f"{len(found.q)} rows written to {output}.")
    return None
