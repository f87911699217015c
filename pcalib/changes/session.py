"""A new session under an old model: residuals whitened by noise and posterior, and what the frame may take up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcalib import prediction
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.data.readings import POSE
from pcalib.diagnosis.point import Point
from pcalib.errors import InputError
from pcalib.fitting import linearisation
from pcalib.fitting.sufficiency import require_reach
from pcalib.model import Frame, Model
from pcalib.posterior import Posterior, Remaining

FRAME_PRIOR = np.r_[np.full(3, 1.0), np.full(3, 1.0), np.full(3, 0.1), np.full(3, 1.0)]
"""[m, rad, m] Scale of the frame's translation, rotation and of the target's offset: so wide that they are free."""


@dataclass(frozen=True, eq=False)
class LinearisedSession:
    """One session, linearised at a model of the robot.

    Whitened arrays have unit covariance if nothing changed: C = λ·(Σ + J·P·Jᵀ) = L·Lᵀ, with the noise Σ, the derivative
    J of the readings by geometry and effects, their posterior covariance P, and the misfit λ of the model.
    """

    model: Model
    """The robot of the last session in the frame of this one."""
    data: Measurements
    point: Point
    noise: Noise
    factor: np.ndarray
    """(M, M) L⁻¹, of readings that were whitened by the noise alone."""
    y: np.ndarray
    """(M,) Whitened residuals."""
    frame: np.ndarray
    """(M, 0, 6 or 9) Whitened columns of the measuring frame and the target, times their scale."""
    sensitivity: np.ndarray
    """(M, r) J·(factor of P), whitened by the noise alone."""

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        """Columns (N, 6, p) [m, rad] as (M, p) of unit covariance."""
        return self.factor @ self.noise.whiten(columns)

    @property
    def left(self) -> Remaining:
        """Noise and misfit that the fit of the model found beyond the stated σ."""
        assert self.model.posterior is not None
        return self.model.posterior.left

    @property
    def n_frame(self) -> int:
        """How many of the columns of `frame` are the measuring frame's; those of the sensors' set-up follow."""
        return self.frame.shape[1] - sum(len(block.theta) for block in self.model.setup)

    @property
    def row(self) -> np.ndarray:
        """(M,) row of each reading."""
        return self.noise.row


def session(model: Model, data: Measurements, same_setup: bool = False) -> LinearisedSession:
    """A new session under an old model.

    Args:
        data: rows of the new session; all of them are used.
        same_setup: the instrument stands where it stood and the target sits where it sat.

    Raises:
        InputError: the model has no posterior, or the robot of the model cannot take the commands.
    """
    if model.posterior is None:
        model = replace(model, posterior=independent(model))
    return at(_registered(model, data, same_setup), data, same_setup)


def independent(model: Model) -> Posterior:
    """The uncertainty of a model file of an earlier version, which keeps the σ of every parameter and no covariance.

    As if they were independent they predict readings worse than the fit does: small changes are not seen.

    Raises:
        InputError: the model keeps no σ either.
    """
    if model.sigma is None or not np.isfinite(model.sigma).any():
        raise InputError(
            "the model keeps no uncertainty of its fit, so that a change cannot be told from an error of its fit",
            remedy="fit it again from the data of its session: pcalib fit DATA.csv --robot R.toml -o MODEL.toml",
        )
    level = model.robot.mechanism.levels[model.level]
    spread = np.diag(np.nan_to_num(model.sigma))
    geometry = np.stack([level.coordinates(column) for column in spread.T], axis=1)
    known = [np.zeros(len(f.theta)) if f.sigma is None else f.sigma for f in model.effects]
    effects = np.concatenate([np.zeros(0), *known])
    n, m = len(geometry), len(effects)
    half = np.zeros((n + m, geometry.shape[1] + m))
    half[:n, : geometry.shape[1]], half[n:, geometry.shape[1] :] = geometry, np.diag(np.nan_to_num(effects))
    return Posterior.of(model.unknowns, half, Remaining(np.ones(2)))


def at(model: Model, data: Measurements, same_setup: bool) -> LinearisedSession:
    """The session linearised at a model that is registered to it already."""
    assert model.posterior is not None
    error, p = linearisation.residuals(model, data)
    require_reach(p, data)
    point = Point.of(model, p, linearisation.conditions_of(data))
    noise = noise_of(data, point)
    sensitivity = noise.whiten(np.nan_to_num(known(point) @ model.posterior.factor))
    C = np.eye(len(sensitivity)) + sensitivity @ sensitivity.T
    L = np.linalg.cholesky(C)
    y = noise.whiten(np.nan_to_num(error[..., None]))[:, 0]
    free = np.zeros((len(data), 6, 0))
    if model.frame is not None and not same_setup:
        free = prediction.frame_columns(model, p, offset=data.frame == "tracker")
        free = free * FRAME_PRIOR[: free.shape[-1]]
    if model.setup:  # stations and zeros are not part of the posterior: each session finds them anew
        sizes = np.concatenate([block.prior for block in model.setup])
        free = np.concatenate([free, prediction.setup_columns(p, len(sizes)) * sizes], axis=-1)
    inverse = np.linalg.solve(L, np.eye(len(L))) / np.sqrt(model.posterior.left.misfit)
    return LinearisedSession(model, data, point, noise, inverse, inverse @ y, inverse @ noise.whiten(free), sensitivity)


def known(point: Point) -> np.ndarray:
    """(N, 6, n) Derivative of the readings by what the posterior is about: level coordinates, then effects."""
    model, p = point.model, point.prediction
    basis = model.robot.mechanism.levels[model.level].basis
    parts = [prediction.geometry_columns(model, p, point.closure, point.JX, basis)]
    parts.append(point.columns(prediction.unit_contributions(model, point.situation)))
    return np.nan_to_num(np.concatenate(parts, axis=-1))


def noise_of(data: Measurements, point: Point) -> Noise:
    """The noise of a new session: σ of its file, times the ratio that the fit of the model found, with the noise of
    joints that the fit found."""
    assert point.model.posterior is not None
    left = point.model.posterior.left
    noise = Noise.of(data).scaled(left.ratio)
    if left.sigma_q:
        noise = noise.with_joints(np.nan_to_num(point.response().actuator), left.sigma_q)
    return noise


def _registered(model: Model, data: Measurements, same_setup: bool) -> Model:
    """The model in the frame of the new session: found anew unless the set-up is the same."""
    if same_setup:
        return linearisation.seen_from(model, data)
    if data.frame == "tracker":
        return linearisation.seen_from(replace(model, frame=None), data)
    # Readings in the base frame: the instrument was aligned to the base anew, and never exactly as before.
    poses = data.readings is None or bool((data.readings.sensor == POSE).any())
    return replace(linearisation.seen_from(model, data), frame=Frame() if poses else None)
