"""Whether a compensated robot is as good as asked for: pass, fail, or cannot tell, with a guard band.

    pcalib accept check.csv --model m.toml --within 50um --tool 0,0,-300mm
    pcalib accept check.csv --model m.toml --within 0.1mm --risk 0.01 --json acceptance.json
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from pcalib.cli._inputs import EffectFiles, ModelOption
from pcalib.cli.frame import NOT_HELD, JsonOption, quantity, say, write_json

if TYPE_CHECKING:
    from pcalib.uncertainty.acceptance import Acceptance


def command(
    data: Path,
    /,
    *,
    model: ModelOption,
    within: Annotated[np.ndarray, quantity("length")],
    tool: Annotated[np.ndarray | None, quantity("length", 3)] = None,
    risk: Annotated[float, Parameter(validator=Number(gt=0, lt=0.5))] = 0.05,
    effect_file: EffectFiles = (),
    json: JsonOption = None,
) -> int | None:
    """Whether a compensated robot is as good as asked for: pass, fail, or cannot tell, with a guard band.

    The robot passes where 95 % of its landings lie within the tolerance beyond doubt, after the decision rule of
    ISO 14253-1: the tolerance is narrowed by a guard band, so that a robot which is not as good passes with the stated
    risk at most. Rows that are held out (set = check) count; where there are none, all rows do, and must be new to the
    model. Exit code 0: pass; 1: fail, or cannot tell.

    Args:
        data: Measurement file, CSV or Parquet.
        within: Radius that must contain 95 % of the landings, with its unit, e.g. 50um.
        tool: TCP in the plate frame, e.g. 0,0,-300mm; the measured points when absent.
        risk: Of accepting a robot that is not as good, and of refusing one that is.
    """
    from pcalib.cli._inputs import read
    from pcalib.cli._tools import require_tool
    from pcalib.errors import InputError
    from pcalib.uncertainty import acceptance

    if not within[0] > 0:
        raise InputError("--within must be more than 0", remedy="say how far off landings may be, e.g. 50um")
    calibrated, measured, _ = read(model, data, effect_file, held_out=True)
    if tool is not None:
        require_tool(calibrated.robot, tool, "--tool")
    if not measured.check.any() and calibrated.history and calibrated.history[-1].get("data") == data.name:
        raise InputError(
            f"the model was fitted to {data.name}, of which no row is held out: the rows of a fit cannot test it",
            file=data, remedy="give new measurements, or hold rows out of the fit (set = check)",
        )
    found = acceptance.accept(calibrated, measured, float(within[0]), tool, risk)
    write_json(json, _json(found))
    for line in _lines(found):
        say(line)
    return None if found.decision is acceptance.Decision.PASS else NOT_HELD


def _radius(found: Acceptance) -> str:
    """How large the misses are, in words."""
    from pcalib.wording import size

    if found.estimate == 0:
        high = size(found.high)
        return f"The misses are no larger than the instrument's noise; 95 % of landings lie within {high}"
    limits = f"{size(found.low)} to {size(found.high)}"
    return f"The radius that contains 95 % of landings is {size(found.estimate)}, between its limits {limits}"


def _lines(found: Acceptance) -> list[str]:
    """The outcome in words."""
    from pcalib.ladder import tool_label
    from pcalib.uncertainty.acceptance import Decision
    from pcalib.wording import size

    tool = tool_label(found.tool)
    head = {
        Decision.PASS: f"Pass: 95 % of landings lie within {size(found.within)}",
        Decision.FAIL: f"Fail: 95 % of landings do not lie within {size(found.within)}",
        Decision.CANNOT_TELL: f"Cannot tell whether 95 % of landings lie within {size(found.within)}",
    }[found.decision]
    out = [
        f"{head} ({tool}, risk {found.risk:.2g}).",
        f"- {_radius(found)}; from {found.rows} rows of {found.commands} commands.",
        f"- The guard band is {size(found.guard)}.",
        f"- The instrument's own noise has a radius of {size(found.noise)} at this tool.",
    ]
    if found.turned:
        out.append("- No row was measured with this tool: its misses follow from the measured rotations.")
    if not found.unfitted:
        out.append("- No row is held out (set = check): the test assumes that the model was not fitted to them.")
    if found.registered:
        out.append("- The tracker was set up anew: its frame is found from these rows, as a cell's frame is taught.")
    if found.decision is Decision.CANNOT_TELL:
        if found.enough is not None:
            out.append(f"- About {found.enough} commands with this instrument would settle it.")
        else:
            out.append("- More commands with this instrument would not settle it.")
        if found.sigma is not None:
            out.append(f"- So would an instrument with σ {size(found.sigma)} per component and as many commands.")
    return out


def _json(found: Acceptance) -> dict[str, Any]:
    """`pcalib.acceptance/1`, lengths in µm."""
    return {
        "schema": "pcalib.acceptance/1",
        "decision": str(found.decision),
        "within_um": found.within * 1e6,
        "risk": found.risk,
        "u95_um": found.estimate * 1e6,
        "low_um": found.low * 1e6,
        "high_um": found.high * 1e6,
        "guard_um": found.guard * 1e6,
        "noise_u95_um": found.noise * 1e6,
        "commands": found.commands,
        "rows": found.rows,
        "tool_mm": found.tool * 1e3,
        "from_rotations": found.turned,
        "held_out": found.unfitted,
        "registered_anew": found.registered,
        "commands_needed": found.enough,
        "sigma_needed_um": None if found.sigma is None else found.sigma * 1e6,
    }
