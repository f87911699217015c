"""What to measure next, to tell rival explanations apart.

pcalib next data.csv --model m.toml --between drive_compliance,encoder_eccentricity -n 6 -o plan.csv
pcalib next data.csv --model m.toml --between backlash,nothing --payload 0kg --payload 3kg -n 12 -o plan.csv
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli._next import MEASURED, say_next, to_compensate
from pcalib.cli._tools import ToolsOption, tool_options
from pcalib.cli.frame import JsonOption, OutputOption, SeedOption, say, show_table, write_json


def command(
    data: Path,
    /,
    *,
    model: ModelOption,
    between: str,
    n: Annotated[int, Parameter(name=["--rows", "-n"])] = 6,
    output: OutputOption = None,
    payload: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True)] = (),
    tool: ToolsOption = (),
    effect_file: EffectFiles = (),
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> int | None:
    """What to measure next, to tell rival explanations apart.

    Chooses poses, payloads, tools, directions and temperatures at which the two explanations, each at the size that the
    data give it, differ most after everything else has been fitted again. Says too when more of the same will not help.

    Args:
        data: Measurement file, CSV or Parquet: what is known already.
        between: Two explanations separated by a comma: effects, geometry levels or parts that may have changed (as
            'pcalib changed' names them), several joined by +, or 'nothing'.
        n: How many rows to plan.
        output: Plan to write, CSV: to be measured, or given to 'pcbench simulate --plan'.
        payload: A mass at hand, e.g. 2kg; may be given several times. When absent, those of the data, or 0, 1 and 2 kg
            where all rows carry the same.
        tool: A tool at hand, e.g. 0,0,-300mm; may be given several times. Those of the data when absent.
        seed: Seed of the draw of candidate poses.
    """
    from pcalib import units
    from pcalib.cli._inputs import read
    from pcalib.data import measurement, table
    from pcalib.diagnosis import discriminate
    from pcalib.errors import InputError
    from pcalib.fitting import identification

    sides = [side.strip() for side in between.split(",")]
    files = [name for side in sides for name in side.split("+") if ".py" in name and name not in effect_file]
    calibrated, measured, own = read(model, data, (*effect_file, *files))
    if len(sides) != 2:
        raise InputError(
            f"--between '{between}': name two explanations, separated by a comma",
            remedy="e.g. drive_compliance,encoder_eccentricity, or backlash,nothing",
        )
    named = [[name for name in side.split("+") if name != "nothing"] for side in sides]
    levels = [n for n in named[0] if n in named[1] and n in calibrated.robot.mechanism.levels]
    if levels:
        say(f"Both take geometry of level {levels[0]}, so the plan starts from a fit at that level.")
        calibrated = identification.fit(measured, calibrated, levels[0]).model
    without = ["+".join(name for name in side if name not in levels) or "nothing" for side in named]
    tools = tool_options(tool, calibrated.robot)
    payloads = [float(units.parse_quantity(p, "mass", option="--payload")[0]) for p in payload]
    if min(payloads, default=0.0) < 0:
        raise InputError("--payload: a payload cannot be negative", remedy="write e.g. 2kg")
    options = discriminate.Options(payloads=payloads or None, tools=np.array(tools) if tools else None, seed=seed)
    found = discriminate.next_rows(calibrated, measured, without, n, own, options)
    columns = discriminate.table(calibrated.robot, found)
    write_json(
        json,
        {
            "schema": "pcalib.next/1", "between": list(found.between), "s_before": found.before, "s_after": found.after,
            "s_more_of_the_same": found.more_of_the_same, "enough": found.enough, "rows": columns,
        },
    )  # fmt: skip
    if output is not None:  # before anything is printed: a closed pipe loses no file
        table.write(output, columns, {"robot": calibrated.robot.name, **measurement.instrument_metadata(measured)})
    say(found.sentence())
    shown, alike = _grouped(columns)
    show_table(
        ("row", *shown, "s so far"),
        [(i + 1, *(cells[i] for cells in shown.values()), f"{after:.1f}") for i, after in enumerate(found.after)],
    )
    if alike:
        say(f"The same in all rows: {', '.join(alike)}.")
    if output is not None:
        say(f"{len(found.q)} rows written to {output}.")
    either = next((name for side in without for name in side.split("+") if name != "nothing"), None)
    if found.hopeless and "nothing" in without:
        to_compensate(model)
    elif found.hopeless and either is not None:
        why = "to take one of the two, as both lead to the same commands"
        say_next("add", either, data, "--model", model, why=why)
    elif output is not None:
        say_next("join", data, output, "-o", "all.csv", why=MEASURED)
    return None


def _grouped(columns: Mapping[str, np.ndarray | list[str]]) -> tuple[dict[str, list[str]], list[str]]:
    """The columns of a plan as a screen has room for them: related ones together, and those that are alike in all rows
    apart."""
    groups = {
        "tool mm": [c for c in columns if c.startswith("tool_")],
        "arms, rods, base °C": [c for c in columns if c.startswith("temp_") and c != "temp_degC"],
        "directions": [c for c in columns if c.startswith("dir")],
        "expected at mm": [c for c in columns if c.startswith("expected_")],
    }
    together = {c: (title, group) for title, group in groups.items() for c in group}
    shown: dict[str, list[str]] = {}
    alike = []
    for name in columns:
        title, group = together.get(name, (name.replace("_", " "), [name]))
        if name != group[0]:
            continue

        def cell(value: float | str, title: str = title, alone: bool = len(group) == 1) -> str:
            if isinstance(value, str):
                return value
            return "−0+"[int(value) + 1] if title == "directions" else f"{value:.4g}" if alone else f"{value:.0f}"

        cells = [" ".join(map(cell, row)) for row in zip(*(columns[c] for c in group), strict=True)]
        if len(set(cells)) == 1 and len(cells) > 1:
            alike.append(f"{title} {cells[0]}")
        else:
            shown[title] = cells
    return shown, alike
