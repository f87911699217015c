"""Land a virtual robot by a calibrated model, with its faults in it, and judge where the TCP came to stand.

    pcbench verify m.toml data.truth.toml --tool 0,0,-300mm
    pcbench verify m.toml data.truth.toml --tool 0,0,0mm --tool 0,0,-300mm --max-rms-um 35
    pcbench verify m.toml data.truth.toml --targets targets.csv --method first-order --json verify.json
    pcbench verify m.toml data.truth.toml --payload 2kg --temperature 28degC
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from pcalib.cli._inputs import EffectFiles
from pcalib.cli._tools import ToolsOption, tool_options
from pcalib.cli.frame import JsonOption, quantity


def command(
    model: Path,
    truth: Path,
    /,
    *,
    tool: ToolsOption = (),
    targets: Path | None = None,
    method: str = "exact",
    cycles: int = 30,
    payload: Annotated[np.ndarray | None, quantity("mass")] = None,
    temperature: Annotated[np.ndarray | None, quantity("temperature")] = None,
    align: bool = False,
    max_rms_um: float | None = None,
    max_um: float | None = None,
    max_ap_um: float | None = None,
    max_rp_um: float | None = None,
    effect_file: EffectFiles = (),
    seed: int = 0,
    json: JsonOption = None,
) -> int:
    """Land a virtual robot by a calibrated model, with its faults in it, and judge where the TCP came to stand.

    AP and RP are pose accuracy and repeatability as ISO 9283 defines them, over cycles that approach every target
    from random sides. RMS and largest error are over all targets and cycles. Exit code 1 where a --max does not hold,
    or where it is asked for and MuJoCo could not carry out a command.

    Args:
        model: Model file, as 'pcalib fit' writes it.
        truth: Truth file, such as 'pcbench simulate' writes beside its data.
        tool: TCP in the plate frame, e.g. 0,0,-300mm; may be given several times.
        targets: Target file, CSV or Parquet, with payloads, temperatures, directions where they matter; a grid through
            the whole workspace when absent.
        method: exact (inverse of the complete model) or first-order (the paper's).
        cycles: How often every target is approached.
        payload: Mass at the TCP.
        temperature: Of the whole robot; 20degC when absent.
        align: Take out the rigid motion between targets and landings first, for models from an unknown frame.
        max_rms_um: Largest RMS that is accepted, per tool.
        max_um: Largest error that is accepted.
        max_ap_um: Largest AP of a target that is accepted.
        max_rp_um: Largest RP of a target that is accepted.
        seed: Of approach directions and of the drives' repeatability.
    """
    from bench.jobs import verify, verify_report
    from pcalib.cli import frame
    from pcalib.errors import InputError

    limits = {"rms": max_rms_um, "max": max_um, "ap": max_ap_um, "rp": max_rp_um}
    for limit in limits.values():
        if limit is not None and not limit >= 0:
            raise InputError(f"a limit of {limit} µm cannot hold", remedy="take a number from 0 on")
    if cycles < 1 or seed < 0:
        remedy = "ask for at least one cycle, and a seed from 0 on"
        raise InputError(f"--cycles {cycles} --seed {seed} make no sense", remedy=remedy)
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
    asked = verify_report.checks(done, limits)
    frame.write_json(json, verify_report.content(done, asked))
    verify_report.show(model.name, done, asked)
    if calibrated.frame is not None and not align:
        frame.say("- The model comes from data in an unknown frame and cannot know where its base stands; see --align.")
    return frame.OK if all(check.held for check in asked) else frame.NOT_HELD
