"""How far off the TCP may be at a command: the uncertainty of the model propagated to the TCP, component by component.

    covariance = T·Tᵀ + rivals + unexplained        T = ∂(TCP)/∂(level coordinates, effects) · F

F is the factor of the posterior covariance, so that the correlations of geometry and effects count. The TCP's
derivatives are those that fits use, taken at the command, with its tool, its load and its conditions, in the base
frame. A rival explanation r with weight w_r, which puts the TCP elsewhere by d_r, adds w_r·d_r·d_rᵀ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcalib import prediction, rotation
from pcalib.errors import InputError
from pcalib.mechanics.kinematics import Closure
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Conditions, Model
from pcalib.prediction import Prediction
from pcalib.uncertainty import radius
from pcalib.unexplained import Beyond

COMPONENTS = ("geometry", "effects", "rivals", "unexplained", "frame")
EITHER = 1 / 3
"""Weight of 'the instrument moved' where an effect moves the base: no reading tells one from the other. Half of all
landings are then off by d beside what else is unknown, with σ across d, and 95 % of all lie within about d + 1.3·σ: a
deviate with two values has no tails. A normal one of variance d²/2 would have 1.4·d; d²/3 gives d + 1.3·σ for d from
5 to 10 σ, and more below."""
FEWEST_TAUGHT = 20
"""Fewest landings to which a frame is fitted: its six parameters are then a tenth of their coordinates."""
CHUNK = 2000
"""Commands at a time: derivatives of 2000 poses by 60 parameters are 6 MB."""


@dataclass(frozen=True, eq=False)
class Expected:
    """What to expect of N landings."""

    covariance: np.ndarray
    """(N, 3, 3) [m²] of the miss, base frame; NaN where the robot cannot go."""
    components: Mapping[str, np.ndarray]
    """(N, 3, 3) [m²] by name; those of geometry and effects are correlated, and do not add up."""
    beyond: Mapping[Beyond, np.ndarray]
    """(N,) bool by condition: whether it was never measured."""

    @cached_property
    def u95(self) -> np.ndarray:
        """(N,) [m] radius of the sphere that contains the miss with 95 %."""
        return radius.containing(self.covariance)

    @cached_property
    def extrapolates(self) -> np.ndarray:
        """(N,) names of what was never measured, separated by spaces; '' where nothing."""
        words = [np.where(rows, f"{name} ", "").astype(object) for name, rows in self.beyond.items()]
        return np.array([text.strip() for text in sum(words[1:], words[0])], object)


def require_known(model: Model) -> None:
    """Refuse a model that keeps no uncertainty.

    Raises:
        InputError: it was fitted by an earlier version, or was never fitted.
    """
    if model.posterior is None or model.uncertainty is None:
        raise InputError(
            "the model states no uncertainty", remedy="fit it anew with 'pcalib fit … -o': the file then keeps it"
        )


def expect(
    model: Model,
    q: np.ndarray,
    conditions: Conditions,
    start: Pose | None = None,
    rivals: Sequence[Model] | None = None,
) -> Expected:
    """What to expect at commands.

    Args:
        q: (N, nq) [rad or m]; rows that are not finite get NaN.
        start: poses at which the loops close about there.
        rivals: models of the rival explanations, in the order of `model.uncertainty.rivals`; made from what the model
            keeps where they are absent.

    Raises:
        InputError: the model states no uncertainty.
    """
    require_known(model)
    assert model.uncertainty is not None
    if rivals is None:
        from pcalib.uncertainty.rivals import models

        rivals = models(model)
    parts = {name: np.full((len(q), 3, 3), np.nan) for name in (*COMPONENTS, "all")}
    place = np.full((len(q), 3), np.nan)
    good = np.flatnonzero(np.isfinite(q).all(axis=1))
    for i in range(0, len(good), CHUNK):
        rows = good[i : i + CHUNK]
        found, place[rows] = _chunk(
            model, q[rows], conditions.take(rows), None if start is None else start.take(rows), rivals
        )
        for name, values in found.items():
            parts[name][rows] = values
    seen = model.uncertainty.measured.beyond(conditions.tool, conditions.payload, place, q, conditions.columns)
    return Expected(parts.pop("all"), parts, seen)


def _by_geometry(model: Model, p: Prediction, at: Closure, JX: np.ndarray) -> np.ndarray:
    """(N, 3, r) what the columns of the posterior's factor do to the TCP by way of the geometry."""
    assert model.posterior is not None
    level = model.robot.mechanism.levels[model.level]
    factor = model.posterior.factor[: len(level.columns)]
    # The raw parameters' derivatives, times basis and factor as one large product: half the time of many small ones.
    raw = prediction.geometry_columns(model, p, at, JX)[:, :3]
    return (raw.reshape(-1, raw.shape[-1]) @ (level.basis @ factor)).reshape(len(p.q), 3, -1)


def base_is_unknown(model: Model) -> bool:
    """Whether the readings of the fit leave open where the base stands: those in a tracker's frame, and of sensors."""
    return model.frame is not None or bool(model.setup)


def taught(
    model: Model, expected: Expected, q: np.ndarray, conditions: Conditions, rivals: Sequence[Model] | None = None
) -> float | None:
    """[m] radius that contains 95 % of landings once a rigid motion of all is allowed for; None where readings say
    where the base stands, or where there are too few landings to fit a frame to.

    Args:
        rivals: as of :func:`expect`.
    """
    rows = np.flatnonzero(np.isfinite(expected.covariance).all(axis=(1, 2)))
    if not base_is_unknown(model) or len(rows) < FEWEST_TAUGHT:
        return None
    rows = rows[:: -(-len(rows) // CHUNK)]
    if rivals is None:
        from pcalib.uncertainty.rivals import models

        rivals = models(model)
    rest = expected.components["unexplained"][rows]
    return radius.pooled(beside_a_frame(model, q[rows], conditions.take(rows), rivals) + rest)


def beside_a_frame(model: Model, q: np.ndarray, conditions: Conditions, rivals: Sequence[Model] = ()) -> np.ndarray:
    """(N, 3, 3) [m²] covariance of the TCP from the uncertainty of geometry and effects and from rival explanations,
    without what a rigid motion of all N landings takes away, as when the frame of the cell is taught with the robot.
    The model must have a posterior."""
    assert model.posterior is not None
    entries = model.uncertainty.rivals if model.uncertainty is not None and rivals else ()
    bare = replace(model, frame=None)
    p = prediction.predict(bare, q, conditions)
    at, JX = prediction.closure_of(bare, p)
    moved = _by_geometry(bare, p, at, JX)
    if bare.effects:
        assert p.situation is not None
        units = [replace(part, sensor=None) for part in prediction.unit_contributions(bare, p.situation)]
        g = len(bare.robot.mechanism.levels[bare.level].columns)
        moved = moved + prediction.effect_columns(bare, p, at, JX, units)[:, :3] @ model.posterior.factor[g:]
    middle = p.position - p.position.mean(axis=0)
    rigid = np.concatenate([np.tile(np.eye(3), (len(q), 1, 1)), -rotation.hat(middle)], axis=-1).reshape(-1, 6)
    Q = np.linalg.qr(rigid)[0]
    base, apart = _landing(bare, p), []
    for rival, entry in zip(rivals, entries, strict=True):
        there = prediction.predict(replace(rival, frame=None), q, conditions, p.pose)
        apart.append(np.sqrt(float(entry["weight"])) * (_landing(rival, there) - base)[..., None])
    if p.contribution.base is not None:
        apart.append(np.sqrt(EITHER) * (base - p.pose.tcp(p.tool))[..., None])
    moved = np.concatenate([moved, *apart], axis=-1)
    flat = moved.reshape(3 * len(q), -1)
    return _square((flat - Q @ (Q.T @ flat)).reshape(moved.shape))


def _chunk(
    model: Model, q: np.ndarray, conditions: Conditions, start: Pose | None, rivals: Sequence[Model]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Covariances by component, and 'all', (N, 3, 3) each; and the plate's origins (N, 3)."""
    kept, posterior = model.uncertainty, model.posterior
    assert kept is not None and posterior is not None
    bare = replace(model, frame=None)
    p = prediction.predict(bare, q, conditions, start)
    at, JX = prediction.closure_of(bare, p)
    level = bare.robot.mechanism.levels[bare.level]
    g = len(level.columns)
    factor = posterior.factor
    geometry = _by_geometry(bare, p, at, JX)
    parts = {"geometry": _square(geometry), "effects": np.zeros((len(q), 3, 3))}
    whole = parts["geometry"].copy()
    if bare.effects:
        assert p.situation is not None
        # What an instrument misreads moves no TCP.
        units = [replace(part, sensor=None) for part in prediction.unit_contributions(bare, p.situation)]
        effects = prediction.effect_columns(bare, p, at, JX, units)[:, :3] @ factor[g:]
        parts["effects"], whole = _square(effects), _square(geometry + effects)
    spread = np.zeros((len(q), 3, 3))
    base = _landing(bare, p)
    for rival, entry in zip(rivals, kept.rivals, strict=True):
        there = prediction.predict(replace(rival, frame=None), q, conditions, p.pose)
        d = _landing(rival, there) - base
        spread += float(entry["weight"]) * d[:, :, None] * d[:, None, :]
    if p.contribution.base is not None:  # a base that moves, and an instrument that moves, read alike
        d = base - p.pose.tcp(p.tool)
        spread += EITHER * d[:, :, None] * d[:, None, :]
    left = kept.covariance((p.pose.R @ p.tool[..., None])[..., 0])
    out = {**parts, "rivals": spread, "unexplained": left}
    whole += spread + left
    whole[~p.reached] = np.nan
    free = [c for c in range(3) if c not in bare.robot.mechanism.task]
    for values in (*out.values(), whole):  # where the plate goes by itself, nothing is wanted, and nothing missed
        values[:, free] = 0.0
        values[:, :, free] = 0.0
    return {**out, "frame": np.zeros_like(whole), "all": whole}, p.pose.x


def _landing(model: Model, p: prediction.Prediction) -> np.ndarray:
    """(N, 3) [m] where the TCP is, whatever an instrument would misread."""
    return p.position if p.contribution.sensor is None else p.position - p.contribution.sensor


def _square(half: np.ndarray) -> np.ndarray:
    return half @ np.swapaxes(half, -1, -2)
