"""Measure a virtual robot with hidden errors, and write a data file.

    pcbench simulate truth.toml --plan random -n 40 -o data.csv
    pcbench simulate truth.toml --plan border -n 40 --check 20 --tool 0,0,0mm --tool 0,0,-300mm -o data.csv
    pcbench simulate truth.toml --plan d-optimal -n 40 --check 20 -o data.csv
    pcbench simulate truth.toml --plan rich -n 120 --payload 0kg --payload 2kg --seed 7 -o data.csv
    pcbench simulate truth.toml --plan next.csv --check 20 -o more.csv
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pcalib.cli._tools import ToolsOption, tool_options
from pcalib.cli.frame import JsonOption, Reads, SeedOption, WorkersOption, Writes, count


def sealed(output: Path) -> Path:
    """The truth file that is written beside the data."""
    from bench import simulate

    return simulate.truth_path(output)


def command(
    truth: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"]), Writes(beside=sealed)],
    plan: Annotated[str, Reads()] = "random",
    n: Annotated[int, Parameter(name="-n"), count()] = 40,
    check: Annotated[int, count(least=0)] = 0,
    tool: ToolsOption = (),
    payload: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True, negative=())] = (),
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    json: JsonOption = None,
) -> int:
    """Measure a virtual robot with hidden errors, and write a data file.

    The truth file says what is wrong with the robot and what instrument looks at it (docs/bench.md). Beside the data
    its sealed copy is written, DATA.truth.toml, with every error by its value: `pcbench verify` lands on it.

    Args:
        truth: Truth file (TOML).
        output: Measurement file to write, CSV or Parquet.
        plan: random, border, d-optimal, plain, rich, or a file of commands such as `pcalib next` writes.
        n: Rows to fit; a file brings its own.
        check: Further rows, marked as held out: of the same plan, or random ones after d-optimal or a file's.
        tool: Measured point in the plate frame, e.g. 0,0,-300mm; may be given several times.
        payload: Mass at the tool, e.g. 1kg; may be given several times.
        seed: Seed of plan and noise: the same seed gives the same bytes.
        workers: Processes that share the work.
    """
    import numpy as np

    from bench import plan as plans
    from bench import simulate
    from bench import truth as truths
    from pcalib import files, units
    from pcalib.cli import frame
    from pcalib.data import measurement
    from pcalib.errors import InputError

    hidden = truths.load(truth)
    tools = tool_options(tool)
    masses = [units.parse_quantity(text, "mass", option="--payload") for text in payload]
    for text, mass in zip(payload, masses, strict=True):
        if len(mass) != 1:
            raise InputError(f"--payload '{text}' needs 1 number, not {len(mass)}")
    payloads = [float(mass[0]) for mass in masses]
    if min(payloads, default=0.0) < 0:
        raise InputError(f"--payload {min(payloads):g}kg: a payload cannot be negative", remedy="write e.g. 2kg")
    if plan == plans.OPTIMAL:
        from bench.jobs import optimal

        made = optimal.make(hidden.robot, hidden.instrument, n, check=check, tools=tools, payloads=payloads, seed=seed)
    else:
        made = plans.make(hidden.robot, plan, n, check=check, tools=tools, payloads=payloads, seed=seed)
    with frame.progress("measuring", len(made)) as advance:
        data = simulate.run(hidden, made, seed, workers, advance)
    truth_file = simulate.truth_path(output)
    text = truths.dumps(hidden, {"plan": made.name, "seed": seed, "data": output.name})
    with files.atomic(truth_file) as fresh:  # both or neither: data whose truth is lost cannot be verified
        fresh.write_text(text, encoding="utf-8")
        measurement.save(output, data.measurements)

    held = int(data.measurements.check.sum())
    frame.say(f"{output}: {len(data.kept)} poses" + (f", {held} of them held out" if held else ""))
    failed = np.flatnonzero(~data.landing.ok)
    if len(failed):
        rows = ", ".join(f"{row + 1} ({data.landing.status[row]})" for row in failed[:8])
        rows += " …" * (len(failed) > 8)
        frame.say(f"{len(failed)} commands could not be carried out and are left out: rows {rows}")
    if len(data.lost):
        frame.say(f"the instrument lost {len(data.lost)} rows")
    frame.say(f"{truth_file}: the truth, sealed")
    frame.write_json(
        json,
        {
            "schema": "pcbench.simulate/1",
            "data": output,
            "truth": truth_file,
            "plan": made.name,
            "seed": seed,
            "rows": len(data.kept),
            "check": held,
            "not_reached": {str(row + 1): str(data.landing.status[row]) for row in failed},
            "lost": data.lost + 1,
            "outliers": data.outlier + 1,
        },
    )
    return frame.OK
