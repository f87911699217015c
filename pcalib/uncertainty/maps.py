"""What the models of a ladder expect at the targets of its maps: how far off the TCP may be, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcalib import workspace
from pcalib.ladder import ErrorMap, Expected, Ladder, Step
from pcalib.model import Conditions, Model
from pcalib.uncertainty import radius, rivals
from pcalib.uncertainty.outlook import at_targets, usual_columns


def with_expected(ladder: Ladder, payload: float = 0.0, effect_files: Sequence[str] = ()) -> Ladder:
    """The ladder with what its models expect; as it is where none states an uncertainty.

    Args:
        payload: [kg] at the TCP.
        effect_files: the user's own effects that kept rival explanations may need.
    """
    models = [step.model for step in ladder.steps]
    if not any(model.posterior is not None and model.uncertainty is not None for model in models):
        return ladder
    maps = tuple(replace(field, expected=_expected(models, field, payload, effect_files)) for field in ladder.maps)
    return replace(ladder, maps=maps)


def of_model(model: Model, effect_files: Sequence[str] = ()) -> Ladder:
    """One model with what it expects over the workspace, at the plate and with the longest tool that was measured."""
    plate = workspace.workspace_grid(model.robot)
    span = np.zeros((3, 2)) if model.uncertainty is None else model.uncertainty.measured.tool
    longest = np.where(np.abs(span[:, 0]) > np.abs(span[:, 1]), span[:, 0], span[:, 1])
    nothing, reached = np.zeros((1, *plate.shape)), np.full((1, len(plate)), "ok")
    tools = [np.zeros(3), *([longest] if longest.any() else [])]
    maps = tuple(ErrorMap(tool, plate + tool, nothing, reached) for tool in tools)
    return with_expected(Ladder(model.robot, (Step("model", "Calibrated", model),), maps), effect_files=effect_files)


def _expected(
    models: Sequence[Model], field: ErrorMap, payload: float, effect_files: Sequence[str]
) -> Expected:
    covariance = np.stack([_over(model, field, payload, effect_files) for model in models])
    known = np.asarray(np.isfinite(covariance).all(axis=(2, 3)))
    u95 = np.where(known, radius.containing(np.where(known[..., None, None], covariance, 0.0)), np.nan)
    pooled = [radius.pooled(some[rows]) if rows.any() else np.nan for some, rows in zip(covariance, known, strict=True)]
    return Expected(covariance, u95, np.array(pooled))


def _over(model: Model, field: ErrorMap, payload: float, effect_files: Sequence[str]) -> np.ndarray:
    """(P, 3, 3) [m²]; NaN where the model states no uncertainty, or where the robot cannot go."""
    n = len(field.targets)
    if model.posterior is None or model.uncertainty is None:
        return np.full((n, 3, 3), np.nan)
    conditions = Conditions(np.broadcast_to(field.tool, (n, 3)), np.full(n, payload), usual_columns(model, n))
    known = rivals.models(model, effect_files)
    return at_targets(replace(model, frame=None), field.targets, conditions, known)[1].covariance
