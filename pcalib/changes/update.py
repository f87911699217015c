"""A model after a change: the part that changed is fitted anew, the rest is held by what was known of it.

With the posterior covariance P of the old fit and directions B of what changed, the errors of the robot have the prior
covariance P + B·S²·Bᵀ with S so wide that it does not hold. In the coordinates u of its factor, δz = [F, B·S]·u, the
prior is |u|², and the maximum of the posterior is found by Gauss–Newton steps, each by QR of the whitened rows above
those of the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib import prediction
from pcalib.changes.session import FRAME_PRIOR, known, noise_of, session
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.diagnosis.point import Point
from pcalib.errors import FitError, InputError
from pcalib.fitting import linearisation
from pcalib.fitting.crossvalidation import rms
from pcalib.fitting.sufficiency import require_reach
from pcalib.model import Model
from pcalib.posterior import Posterior

FREE = 100.0
"""Tolerances that a changed part may move: ten millimetres for a length."""
ROUNDS = 12
SETTLED = 1e-6
"""Steps of u, in σ, below which the search ends."""


@dataclass(frozen=True)
class Updated:
    """A model after an update and how well it fits the new session."""

    model: Model
    rms_before: float
    rms_after: float
    """[m] RMS position error on the new session, the frame allowed for."""


def update(model: Model, data: Measurements, changed: Sequence[Hypothesis], same_setup: bool = False) -> Updated:
    """Refit the parts that changed, on a new session; the posterior of the model is the prior of everything else.

    Args:
        changed: parts of the robot, or effects that the model has or lacks; an effect that it lacks is refused.

    Raises:
        InputError: the model keeps no uncertainty.
        FitError: the search does not settle.
    """
    if data.readings is not None:
        raise InputError(
            "an update takes readings of poses only", file=data.source,
            remedy="refit everything: pcalib fit DATA.csv --robot R.toml -o MODEL.toml",
        )  # fmt: skip
    new = session(model, data, same_setup)
    model = new.model
    posterior = model.posterior
    assert posterior is not None
    level = model.robot.mechanism.levels[model.level]
    wide = np.hstack([_directions(model, h) for h in changed])
    factor = np.hstack([posterior.factor, wide])
    r = factor.shape[1]
    u, old = np.zeros(r), model
    offset = data.frame == "tracker"
    frames = 0 if model.frame is None or same_setup else model.frame.unknowns(offset)
    before = after = float("nan")
    R = np.eye(r + frames)
    for _ in range(ROUNDS):
        error, p = linearisation.residuals(model, data)
        require_reach(p, data)
        after = rms(error[:, :3])
        point = Point.of(model, p, linearisation.conditions_of(data))
        noise = noise_of(data, point)
        columns = noise.whiten(np.nan_to_num(known(point) @ factor))
        if frames:
            free = prediction.frame_columns(model, p, offset=offset) * FRAME_PRIOR[:frames]
            columns = np.hstack([columns, noise.whiten(np.nan_to_num(free))])
        y = noise.whiten(np.nan_to_num(error[..., None]))[:, 0]
        prior = np.eye(r, r + frames)
        Q, R = np.linalg.qr(np.vstack([columns, prior]))
        step = np.linalg.solve(R, Q.T @ np.r_[y, -u])
        u = u + step[:r]
        model = _moved(old, model, factor @ u, level.basis, step[r:] * FRAME_PRIOR[:frames])
        if np.isnan(before):
            before = rms(linearisation.residuals(replace(model, k=old.k, effects=old.effects), data)[0][:, :3])
        if np.abs(step[:r]).max() < SETTLED:
            break
    else:
        raise FitError(f"{data.source}: the update does not settle\n  refit everything: pcalib fit {data.source}")
    half = factor @ np.linalg.solve(R, np.eye(r + frames))[:r]
    kept = Posterior.of(posterior.names, half, posterior.left)
    sigma = np.sqrt(np.sum((level.basis @ half[: level.basis.shape[1]]) ** 2, axis=1))
    sigma = np.where(np.isfinite(model.sigma), sigma, np.nan) if model.sigma is not None else sigma
    frame = old.frame if same_setup else model.frame if data.frame == "tracker" else None
    return Updated(replace(model, posterior=kept, sigma=sigma, frame=frame), before, after)


def _directions(model: Model, changed: Hypothesis) -> np.ndarray:
    """(n, p) Directions of the posterior's unknowns that a hypothesis frees, as wide as they may move.

    Raises:
        FitError: the model's level cannot express the change, or lacks the effect.
    """
    posterior = model.posterior
    assert posterior is not None
    level = model.robot.mechanism.levels[model.level]
    nz = level.basis.shape[1]
    if changed.basis is not None:
        inside = np.stack([level.coordinates(column) for column in changed.basis.T], axis=1)
        if not np.allclose(level.basis @ inside, changed.basis, atol=1e-9):
            raise FitError(
                f"level {model.level} cannot express a change of {changed.words}\n  fit at level complete first"
            )
        out = np.zeros((len(posterior.names), inside.shape[1]))
        out[:nz] = inside * (FREE * changed.scale(model))
        return out
    places = [i for i, name in enumerate(posterior.names) if name.startswith(f"{changed.name}.") and i >= nz]
    if not places:
        raise FitError(f"the model lacks {changed.name}\n  add it: pcalib add {changed.spec} DATA --model MODEL")
    out = np.zeros((len(posterior.names), len(places)))
    out[places, np.arange(len(places))] = FREE * changed.scale(model)
    return out


def _moved(old: Model, model: Model, change: np.ndarray, basis: np.ndarray, frame: np.ndarray) -> Model:
    """The model with geometry and effects `change` away from the old ones, and its frame turned and shifted further."""
    nz = basis.shape[1]
    effects, i = [], nz
    for fitted in old.effects:
        p = len(fitted.theta)
        effects.append(replace(fitted, theta=fitted.theta + change[i : i + p]))
        i += p
    out = replace(model, k=old.k + basis @ change[:nz], effects=tuple(effects))
    if not len(frame) or model.frame is None:
        return out
    return replace(out, frame=model.frame.moved(frame))
