"""Commands that bring the TCP to wanted positions, by a calibrated model.

    pcalib compensate targets.csv --model m.toml --tool 0,0,-300mm -o commands.csv
    pcalib compensate targets.csv --model m.toml --method first-order -o commands.csv
    pcalib compensate targets.csv --model m.toml --uncertainty components --strict -o commands.csv
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from pcalib.cli._inputs import EffectFiles
from pcalib.cli._next import say_next
from pcalib.cli.frame import NOT_HELD, JsonOption, RequiredOutput, quantity, say, write_json

if TYPE_CHECKING:
    from pcalib.model import Model
    from pcalib.uncertainty import Expected


def command(
    targets: Path,
    /,
    *,
    model: Path,
    output: RequiredOutput,
    tool: Annotated[np.ndarray | None, quantity("length", 3)] = None,
    method: str = "exact",
    uncertainty: Literal["radius", "components"] = "radius",
    strict: bool = False,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """Commands that bring the TCP to wanted positions, by a calibrated model.

    Writes one row per target in the same order: actuator values and a status, 'ok' or why there is no command; the
    target's own columns are kept. Payload, temperature and direction columns are used by models with effects. Two more
    columns are u95_um, the radius that contains the miss with 95 %, and extrapolates: what was never measured (tool,
    payload, temperature, direction, place), blank where nothing.

    Args:
        targets: Target file, CSV or Parquet: x, y, z in the base frame, optionally payload, temperatures, tool.
        model: Model file, as 'pcalib fit' writes it.
        output: Command file to write.
        tool: TCP in the plate frame with its unit, e.g. 0,0,-300mm; the targets' own tool columns where they have
            them.
        strict: End with exit code 1 where any target has no command.
        method: exact (inverse of the complete model) or first-order (the paper's).
        uncertainty: radius, or components: the covariance of the miss as well, in µm².
    """
    from pcalib import compensation, effects, modelfile
    from pcalib.cli._tools import require_tool
    from pcalib.data.targets import load_targets, save_commands
    from pcalib.errors import InputError
    from pcalib.prediction import Conditions
    from pcalib.uncertainty import propagation
    from pcalib.uncertainty.outlook import MORE
    from pcalib.wording import size

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
    expected = _expected(calibrated, found.q, conditions, effect_file)
    beside = {} if expected is None else _columns(expected, uncertainty == "components")
    save_commands(output, calibrated.robot, wanted, found.q, found.status.tolist(), beside)
    kinds, counts = np.unique(found.status, return_counts=True)
    tally = dict(zip(kinds.tolist(), counts.tolist(), strict=True))
    ok = tally.get("ok", 0)
    others = "".join(f"; {n} {kind.replace('_', ' ')}" for kind, n in tally.items() if kind != "ok")
    say(f"{ok} of {len(wanted)} targets have a command{others}. Written to {output}.")
    if wanted.payload.any() and not calibrated.effects:
        say(
            f"- The targets carry up to {wanted.payload.max():g} kg, and the model has no effect of loads: the "
            "deflection by them is not compensated. 'pcalib diagnose' on measurements with payloads finds it."
        )
    content: dict[str, Any] = {
        "schema": "pcalib.compensate/1", "method": method, "targets": len(wanted), "status": tally,
        "uncertainty": None,
    }  # fmt: skip
    if expected is None:
        say("- The model states no uncertainty: fit it anew with this version for that.")
    elif ok:
        _say_expected(expected, ok)
        worst = float(np.nanmax(expected.u95))
        beside = propagation.taught(calibrated, expected, found.q, conditions)
        if beside is not None and beside < worst / MORE:
            say(
                f"- Once the cell's frame is taught with the robot, 95 % stay within {size(beside)}: the readings "
                "of the fit do not say where the base stands."
            )
            worst = beside
        least = int(np.ceil(2e6 * worst / 10) * 10)  # twice what is expected leaves room for a guard band
        why = "with new measurements at such commands, to accept the robot within what you need"
        say_next("accept", "measured.csv", "--model", model, "--within", f"{least}um", why=why)
        if json is not None:
            content["uncertainty"] = _json(expected, calibrated, beside)
    write_json(json, content)
    return NOT_HELD if strict and ok < len(wanted) else None


def _expected(model: Model, q: np.ndarray, conditions: Any, effect_file: tuple[str, ...]) -> Expected | None:
    """What to expect of the commands; None where the model states no uncertainty."""
    from pcalib.uncertainty import expect, rivals

    if model.posterior is None or model.uncertainty is None:
        return None
    return expect(model, q, conditions, rivals=rivals.models(model, effect_file))


def _columns(expected: Expected, whole: bool) -> dict[str, Any]:
    """Further columns of the command file."""
    from pcalib.data.targets import COVARIANCE, EXTRAPOLATES, U95

    known = np.isfinite(expected.u95)
    out: dict[str, Any] = {
        U95: np.round(expected.u95 * 1e6, 2),
        EXTRAPOLATES: np.where(known, expected.extrapolates, "").tolist(),
    }
    if whole:
        pairs = [(i, j) for i in range(3) for j in range(i, 3)]
        out |= {COVARIANCE.format("xyz"[i], "xyz"[j]): expected.covariance[:, i, j] * 1e12 for i, j in pairs}
    return out


def _say_expected(expected: Expected, ok: int) -> None:
    """Print what to expect of the rows that have a command."""
    from pcalib.wording import size

    known = np.isfinite(expected.u95)
    u95 = expected.u95[known]
    middle, largest = size(float(np.median(u95))), size(float(u95.max()))
    say(f"- The miss stays within {middle} (median) to {largest} (largest) with 95 %.")
    beyond = {str(name): int(rows[known].sum()) for name, rows in expected.beyond.items() if rows[known].any()}
    outside = int(sum(text != "" for text in expected.extrapolates[known]))
    if beyond:
        parts = ", ".join(f"{name} of {count}" for name, count in beyond.items())
        say(
            f"- {outside} of {ok} rows extrapolate to what was never measured ({parts}): what the model leaves out may "
            "be larger there than u95_um says. Measure under these conditions to be sure."
        )


def _json(expected: Expected, model: Model, beside: float | None) -> dict[str, Any]:
    """`pcalib.uncertainty/1` of the rows that have a command."""
    from pcalib.uncertainty import radius
    from pcalib.uncertainty.outlook import coverage_json

    known = np.isfinite(expected.u95)
    parts = {name: radius.pooled(values[known]) * 1e6 for name, values in expected.components.items()}
    return {
        "schema": "pcalib.uncertainty/1",
        "u95_um": radius.pooled(expected.covariance[known]) * 1e6,
        "u95_taught_um": None if beside is None else beside * 1e6,
        "components_um": parts,
        "conditions": {"extrapolates": {str(name): int(rows[known].sum()) for name, rows in expected.beyond.items()}},
        "coverage": coverage_json(model),
    }
