"""What to expect over the workspace with the longest tool that was measured: one sentence, and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib import compensation, workspace
from pcalib.errors import PcalibError
from pcalib.ladder import tool_label
from pcalib.model import Conditions, Model
from pcalib.uncertainty import radius
from pcalib.uncertainty.discrepancy import FEWEST_HELD_OUT
from pcalib.uncertainty.propagation import COMPONENTS, Expected, expect, require_known, taught
from pcalib.unexplained import DIRECTION, TEMPERATURE, Unexplained
from pcalib.wording import figure, size

MORE = 1.5
"""Both radii are said where the one without a taught frame is at least this many times the other."""
REFERENCE = 20.0
"""[°C] of a robot whose temperatures were not recorded."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """What to expect over the workspace."""

    position: np.ndarray
    """(P, 3) [m] targets, base frame."""
    expected: Expected
    u95: float
    """[m] radius that contains 95 % of landings at all targets taken together."""
    components: dict[str, float]
    """[m] the same, of each component by itself."""
    conditions: Conditions
    model: Model
    taught: float | None = None
    """[m] the radius beside a rigid motion of all landings, where readings do not say where the base stands."""

    @property
    def tool(self) -> np.ndarray:
        """(3,) [m]."""
        return self.conditions.tool[0]


def outlook(model: Model, tool: np.ndarray | None = None, rivals: Sequence[Model] | None = None) -> Outlook:
    """What to expect at a grid through the workspace.

    Args:
        tool: (3,) [m]; the longest that was measured when absent.
        rivals: models of the rival explanations that the model keeps.

    Raises:
        InputError: the model states no uncertainty.
        ReachError: no target can be reached.
    """
    require_known(model)
    kept = model.uncertainty
    assert kept is not None
    plate = workspace.workspace_grid(model.robot)
    chosen = longest_tool(model) if tool is None else np.asarray(tool, float)
    n = len(plate)
    conditions = Conditions(
        np.broadcast_to(chosen, plate.shape), np.full(n, kept.measured.payload[1]), usual_columns(model, n)
    )
    wanted = plate + chosen
    q, expected = at_targets(model, wanted, conditions, rivals)
    good = np.asarray(np.isfinite(expected.covariance).all(axis=(1, 2)))
    if not good.any():
        raise PcalibError("no target of the workspace can be reached by this model\n  check [workspace] and [joints]")
    expected = Expected(
        expected.covariance[good], {name: v[good] for name, v in expected.components.items()},
        {name: v[good] for name, v in expected.beyond.items()},
    )  # fmt: skip
    parts = {name: radius.pooled(values) for name, values in expected.components.items()}
    some = conditions.take(good)
    beside = taught(model, expected, q[good], some, rivals)
    return Outlook(wanted[good], expected, radius.pooled(expected.covariance), parts, some, model, beside)


def longest_tool(model: Model) -> np.ndarray:
    """(3,) [m] the farthest that was measured along each axis; zero where that is not known."""
    if model.uncertainty is None:
        return np.zeros(3)
    low, high = model.uncertainty.measured.tool.T
    return np.where(np.abs(low) > np.abs(high), low, high)


def at_targets(
    model: Model, targets: np.ndarray, conditions: Conditions, rivals: Sequence[Model] | None = None
) -> tuple[np.ndarray, Expected]:
    """The model's own commands (P, nq) for targets (P, 3) [m] of the TCP, and what to expect there."""
    # A robot that commands orientation is asked for a level plate, as the grid has it.
    n = len(targets)
    turned = np.broadcast_to(np.eye(3), (n, 3, 3)) if {3, 4, 5} & set(model.robot.mechanism.task) else None
    made = compensation.compensate(model, targets, rotation_matrix=turned, conditions=conditions, limits=False)
    return made.q, expect(model, made.q, conditions, rivals=rivals)


def usual_columns(model: Model, n: int) -> dict[str, np.ndarray]:
    """Columns (n,) that the model's effects need, each at the middle of its measured range."""
    kept = model.uncertainty
    assert kept is not None
    needed = {name for fitted in model.effects for name in fitted.effect.needs}
    values = {name: span.mean() for name, span in kept.measured.columns.items() if name.startswith(TEMPERATURE)}
    for name in needed - set(values):
        values[name] = REFERENCE if name.startswith(TEMPERATURE) else 1.0 if name.startswith(DIRECTION) else 0.0
    if "time" in values:
        values["time"] = model.time_origin or 0.0
    return {name: np.full(n, value) for name, value in values.items()}


def sentence(found: Outlook) -> str:
    """The outlook in words."""
    kept = found.model.uncertainty
    assert kept is not None
    names = {
        "geometry": "geometry",
        "effects": " and ".join(f.effect.name.replace("_", " ") for f in found.model.effects),
        "rivals": "which explanation is true",
        "unexplained": "unexplained",
    }
    parts = [
        f"{names[name]} {figure(found.components[name] * 1e6, 2)}"
        for name in names
        if found.components[name] > 0.005 * found.u95
    ]
    where = f"with a {tool_label(found.tool).removeprefix('tool ')} tool" if found.tool.any() else "at the plate"
    # In a tracker's frame tolerances hold the base; where they do so well, there is one radius to speak of.
    if found.taught is not None and (found.model.frame is None or found.u95 > MORE * found.taught):
        return (
            f"Expect 95 % of landings within {size(found.taught)} {where} once the cell's frame is taught with the "
            "robot; where the base stands the readings do not say, and without it landings are within "
            f"{size(found.u95)}; "
            f"{_judged(kept)}."
        )
    return f"Expect 95 % of landings within {size(found.u95)} {where} ({', '.join(parts)} µm); {_judged(kept)}."


def _judged(kept: Unexplained) -> str:
    if kept.held_out:
        return f"{kept.inside} of {kept.rows} held-out rows lie inside of what was predicted for them"
    return (
        f"{kept.inside} of {kept.rows} rows lie inside of what fits without them predict, and too few are held out "
        f"(set = check) to confirm it: that takes {FEWEST_HELD_OUT}"
    )


def to_json(found: Outlook) -> dict[str, Any]:
    """`pcalib.uncertainty/1`."""
    return {
        "schema": "pcalib.uncertainty/1",
        "u95_um": found.u95 * 1e6,
        "u95_taught_um": None if found.taught is None else found.taught * 1e6,
        "components_um": {name: found.components[name] * 1e6 for name in COMPONENTS},
        "conditions": {
            "tool_mm": (found.tool * 1e3).tolist(),
            "payload_kg": float(found.conditions.payload[0]),
            **{name: float(values[0]) for name, values in found.conditions.columns.items()},
        },
        "coverage": coverage_json(found.model),
    }


def coverage_json(model: Model) -> dict[str, Any] | None:
    """How many held-out rows lie inside of what was predicted; None where the model states no uncertainty."""
    kept = model.uncertainty
    if kept is None:
        return None
    share = kept.inside / kept.rows if kept.rows else None
    return {
        "held_out_inside": share if kept.held_out else None,
        "left_out_inside": None if kept.held_out else share,
        "rows": kept.rows,
    }


def said(model: Model, rivals: Sequence[Model] | None = None) -> tuple[str, dict[str, Any] | None]:
    """The sentence and the JSON of a model; of one that states no uncertainty, why not, and None."""
    if model.posterior is None or model.uncertainty is None:
        return "How far off landings may be is not known: the model states no uncertainty; fit it anew for that.", None
    try:
        found = outlook(model, rivals=rivals)
    except PcalibError as error:
        return f"How far off landings may be is not known: {error.args[0]}.", None
    return sentence(found), to_json(found)
