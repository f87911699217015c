"""Land a virtual robot by a calibrated model, with its faults in it, and judge where the TCP came to stand.

    pcbench verify m.toml data.truth.toml --tool 0,0,-300mm
    pcbench verify m.toml data.truth.toml --tool 0,0,0mm --tool 0,0,-300mm --max-rms 35um
    pcbench verify m.toml data.truth.toml --targets targets.csv --method first-order --json verify.json
    pcbench verify m.toml data.truth.toml --payload 2kg --temperature 28degC
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from pcalib.cli._inputs import EffectFiles
from pcalib.cli._tools import ToolsOption, tool_options
from pcalib.cli.frame import JsonOption, SeedOption, count, quantity


def _named(name: str) -> Parameter:
    """A limit by its name, and by the one with a unit in it that it had before."""
    return Parameter(name=[name, f"{name}-um"])


def command(
    model: Path,
    truth: Path,
    /,
    *,
    tool: ToolsOption = (),
    targets: Path | None = None,
    method: str = "exact",
    cycles: Annotated[int, count(100_000)] = 30,
    payload: Annotated[np.ndarray | None, quantity("mass")] = None,
    temperature: Annotated[np.ndarray | None, quantity("temperature")] = None,
    align: bool = False,
    max_rms: Annotated[np.ndarray | None, quantity("length"), _named("--max-rms")] = None,
    max_error: Annotated[np.ndarray | None, quantity("length"), _named("--max")] = None,
    max_ap: Annotated[np.ndarray | None, quantity("length"), _named("--max-ap")] = None,
    max_rp: Annotated[np.ndarray | None, quantity("length"), _named("--max-rp")] = None,
    max_failed: int | None = None,
    effect_file: EffectFiles = (),
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> int:
    """Land a virtual robot by a calibrated model, with its faults in it, and judge where the TCP came to stand.

    AP and RP are pose accuracy and repeatability as ISO 9283 defines them, over cycles that approach every target
    from random sides. RMS and largest error are over all targets and cycles that were attained. Exit code 1 where a
    --max does not hold; where one is asked for, all targets must be attained, but for as many as --max-failed allows.

    Args:
        model: Model file, as 'pcalib fit' writes it.
        truth: Truth file, such as 'pcbench simulate' writes beside its data.
        tool: TCP in the plate frame, e.g. 0,0,-300mm; may be given several times.
        targets: Target file, CSV or Parquet, with payloads, temperatures, directions where they matter; a grid through
            the whole workspace when absent.
        method: exact (inverse of the complete model) or first-order (the paper's).
        cycles: How often every target is approached.
        payload: Mass at the TCP.
        temperature: Temperature of the whole robot; 20degC when absent.
        align: Take out the rigid motion between targets and landings first, for models from an unknown frame.
        max_rms: Largest RMS that is accepted, per tool, e.g. 35um.
        max_error: Largest error that is accepted.
        max_ap: Largest AP of a target that is accepted.
        max_rp: Largest RP of a target that is accepted.
        max_failed: How many targets of all tools may be refused or not reached in some cycle; 0 where another --max is
            given.
        seed: Seed of the approach directions and of the drives' repeatability.
    """
    from bench.jobs import verify, verify_report
    from pcalib.cli import frame
    from pcalib.errors import InputError

    given = {"rms": max_rms, "max": max_error, "ap": max_ap, "rp": max_rp}
    limits = {name: float(value[0]) for name, value in given.items() if value is not None}
    for name, limit in limits.items():
        if limit < 0:
            raise InputError(f"{name} ≤ {limit * 1e6:g} µm cannot hold", remedy="take a length from 0 on, e.g. 35um")
    if max_failed is not None and max_failed < 0:
        raise InputError(f"--max-failed {max_failed} cannot hold", remedy="take a whole number from 0 on")
    calibrated, real = verify.load(model, truth, effect_file)
    tools = tool_options(tool, real.robot)
    load = None if payload is None else float(payload[0])
    if load is not None and load < 0:
        raise InputError(f"--payload {load:g}kg: a payload cannot be negative", remedy="write e.g. 2kg")
    if temperature is not None and temperature[0] < -273.15:
        raise InputError("--temperature: there is nothing below −273.15 °C", remedy="write e.g. 28degC")
    tasks = verify.tasks(real.robot, tools, targets, load)
    done = {}
    with frame.progress("landing", cycles * sum(len(task.position) for task in tasks.values())) as advance:
        for label, task in tasks.items():
            done[label] = verify.run(
                calibrated, real, task, method=method, cycles=cycles, seed=seed, aligned=align, advance=advance,
                temperature=20.0 if temperature is None else float(temperature[0]),
            )  # fmt: skip
    asked = verify_report.checks(done, limits, max_failed)
    frame.write_json(json, verify_report.content(done, asked))
    verify_report.show(model.name, done, asked)
    if calibrated.frame is not None and not align:
        frame.say("- The model comes from data in an unknown frame and cannot know where its base stands; see --align.")
    return frame.OK if all(check.held for check in asked) else frame.NOT_HELD
