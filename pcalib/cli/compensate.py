"""Commands that bring the TCP to wanted positions, by a calibrated model.

    pcalib compensate targets.csv --model m.toml --tool 0,0,-300mm -o commands.csv
    pcalib compensate targets.csv --model m.toml --method first-order -o commands.csv
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from pcalib.cli._inputs import EffectFiles
from pcalib.cli.frame import NOT_HELD, JsonOption, RequiredOutput, quantity, say, write_json


def command(
    targets: Path,
    /,
    *,
    model: Path,
    output: RequiredOutput,
    tool: Annotated[np.ndarray | None, quantity("length", 3)] = None,
    method: str = "exact",
    strict: bool = False,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """Commands that bring the TCP to wanted positions, by a calibrated model.

    Writes one row per target in the same order: actuator values and a status, 'ok' or why there is no command; the
    target's own columns are kept. Payload, temperature and direction columns are used by models with effects.

    Args:
        targets: Target file, CSV or Parquet: x, y, z in the base frame, optionally payload, temperatures, tool.
        model: Model file, as 'pcalib fit' writes it.
        output: Command file to write.
        tool: TCP in the plate frame with its unit, e.g. 0,0,-300mm; the targets' own tool columns where they have
            them.
        strict: End with exit code 1 where any target has no command.
        method: exact (inverse of the complete model) or first-order (the paper's).
    """
    from pcalib import compensation, effects, modelfile
    from pcalib.cli._tools import require_tool
    from pcalib.data.targets import load_targets, save_commands
    from pcalib.errors import InputError
    from pcalib.prediction import Conditions

    calibrated = modelfile.load(model, effect_file)
    if tool is not None:
        require_tool(calibrated.robot, tool, "--tool")
    wanted = load_targets(targets, calibrated.robot)
    if wanted.tool is not None and tool is not None:
        raise InputError("the targets have tool columns and --tool is given too", file=targets, remedy="keep one")
    points = wanted.tool if wanted.tool is not None else np.zeros(3) if tool is None else tool
    conditions = Conditions(np.broadcast_to(points, wanted.position.shape), wanted.payload, wanted.columns)
    for fitted in calibrated.effects:
        effects.require(fitted.effect, wanted.columns, targets)
    turned = wanted.rotation if {3, 4, 5} & set(calibrated.robot.mechanism.task) else None
    found = compensation.compensate(
        calibrated, wanted.position, rotation_matrix=turned, conditions=conditions, method=method
    )
    save_commands(output, calibrated.robot, wanted, found.q, found.status.tolist())
    kinds, counts = np.unique(found.status, return_counts=True)
    tally = dict(zip(kinds.tolist(), counts.tolist(), strict=True))
    ok = tally.get("ok", 0)
    others = "".join(f"; {n} {kind.replace('_', ' ')}" for kind, n in tally.items() if kind != "ok")
    say(f"{ok} of {len(wanted)} targets have a command{others}. Written to {output}.")
    if wanted.payload.any() and not calibrated.effects:
        say(
            f"- The targets carry up to {wanted.payload.max():g} kg, and the model has no effect of loads: what they "
            "bend is not made good. 'pcalib diagnose' on measurements with payloads finds it."
        )
    write_json(json, {"schema": "pcalib.compensate/1", "method": method, "targets": len(wanted), "status": tally})
    return NOT_HELD if strict and ok < len(wanted) else None
