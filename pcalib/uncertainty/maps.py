"""What the models of a ladder expect at the targets of its maps: how far off the TCP may be, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcalib import workspace
from pcalib.ladder import ErrorMap, Expected, Ladder, Step
from pcalib.model import Conditions, Model
from pcalib.uncertainty import radius, rivals
from pcalib.uncertainty.outlook import at_targets, longest_tool, usual_columns


def with_expected(ladder: Ladder, payload: float = 0.0, effect_files: Sequence[str] = ()) -> Ladder:
    """The ladder with what its models expect; as it is where none states an uncertainty.

    Args:
        payload: [kg] at the TCP.
        effect_files: the user's own effects that kept rival explanations may need.
    """
    models = [step.model if _states(step) else None for step in ladder.steps]
    if not any(models):
        return ladder
    maps = tuple(replace(field, expected=_expected(models, field, payload, effect_files)) for field in ladder.maps)
    return replace(ladder, maps=maps)


def of_model(model: Model, effect_files: Sequence[str] = ()) -> Ladder:
    """One model with what it expects over the workspace, at the plate and with the longest tool that was measured."""
    plate = workspace.workspace_grid(model.robot)
    longest = longest_tool(model)
    nothing, reached = np.zeros((1, *plate.shape)), np.full((1, len(plate)), "ok")
    tools = [np.zeros(3), *([longest] if longest.any() else [])]
    maps = tuple(ErrorMap(tool, plate + tool, nothing, reached) for tool in tools)
    return with_expected(Ladder(model.robot, (Step("model", "Calibrated", model),), maps), effect_files=effect_files)


def _states(step: Step) -> bool:
    """Whether the step's model states an uncertainty, which holds for exact commands only."""
    return step.method == "exact" and step.model.posterior is not None and step.model.uncertainty is not None


def _expected(
    models: Sequence[Model | None], field: ErrorMap, payload: float, effect_files: Sequence[str]
) -> Expected:
    covariance = np.stack([_over(model, field, payload, effect_files) for model in models])
    known = np.asarray(np.isfinite(covariance).all(axis=(2, 3)))
    u95 = np.where(known, radius.containing(np.where(known[..., None, None], covariance, 0.0)), np.nan)
    pooled = [radius.pooled(some[rows]) if rows.any() else np.nan for some, rows in zip(covariance, known, strict=True)]
    return Expected(covariance, u95, np.array(pooled))


def _over(model: Model | None, field: ErrorMap, payload: float, effect_files: Sequence[str]) -> np.ndarray:
    """(P, 3, 3) [m²]; NaN without a model, and where the robot cannot go."""
    n = len(field.targets)
    if model is None:
        return np.full((n, 3, 3), np.nan)
    conditions = Conditions(np.broadcast_to(field.tool, (n, 3)), np.full(n, payload), usual_columns(model, n))
    known = rivals.models(model, effect_files)
    return at_targets(replace(model, frame=None), field.targets, conditions, known)[1].covariance
