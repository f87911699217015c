"""Residuals of a model on data, and how they depend on every unknown: what fits, diagnoses and plans start from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcalib import prediction, rotation
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.errors import InputError
from pcalib.fitting import least_squares
from pcalib.fitting.unknowns import Unknowns
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Frame, Model
from pcalib.prediction import Conditions, Prediction


@dataclass(frozen=True)
class Linearisation:
    """Whitened residuals of measured scalars and their derivatives by every unknown."""

    residual: np.ndarray
    """(M,) (measured − predicted)/σ."""
    jacobian: np.ndarray
    """(M, n) by geometry, effects and frame, side by side."""
    n_geometry: int
    row: np.ndarray
    """(M,) pose of each scalar."""
    component: np.ndarray
    """(M,) 0…5 for x y z rx ry rz."""
    prediction: Prediction
    motion: np.ndarray
    """(N, n_state, n_geometry) of the plates about their measured points, by geometry."""

    @property
    def geometry(self) -> np.ndarray:
        """(M, n_geometry)."""
        return self.jacobian[:, : self.n_geometry]

    @property
    def nuisance(self) -> np.ndarray:
        """(M, n_effects + n_frame) what is unknown beside the geometry."""
        return self.jacobian[:, self.n_geometry :]

    @cached_property
    def triangle(self) -> np.ndarray:
        """Triangular factor of [jacobian residual], at most (n + 1, n + 1): all that the M scalars say."""
        return least_squares.triangle(self.jacobian, self.residual)


def conditions_of(data: Measurements) -> Conditions:
    """Tools, payloads and further columns of a data set."""
    return Conditions(data.tool, data.payload, data.columns)


def residuals(model: Model, data: Measurements, start: Pose | None = None) -> tuple[np.ndarray, Prediction]:
    """Measured − predicted (N, 6) [m, rad], NaN where not measured or not reached, and the prediction.

    Args:
        start: poses from which forward kinematics starts.
    """
    p = prediction.predict(model, data.q, conditions_of(data), start)
    error = np.full((len(data.q), 6), np.nan)
    error[:, :3] = data.position - p.position
    turned = data.mask[:, 3]
    if turned.any():
        rows = slice(None) if turned.all() else turned
        error[rows, 3:] = rotation.log(data.rotation[rows] @ rotation.transposed(p.rotation[rows]))
    error[~data.mask] = np.nan
    error[~p.reached] = np.nan
    return error, p


def linearise(
    model: Model,
    data: Measurements,
    unknowns: Unknowns,
    at: tuple[np.ndarray, Prediction] | None = None,
    noise: Noise | None = None,
) -> Linearisation:
    """Whitened residuals and Jacobians of a model on data.

    Args:
        at: what :func:`residuals` gave for this model and these data, where it is known already.
        noise: that of the readings; what the data state where it is absent.
    """
    error, p = at if at is not None else residuals(model, data)
    closed, JX = prediction.closure_of(model, p)
    basis = None if unknowns.level.raw and unknowns.keep.all() else unknowns.basis
    motion = prediction.geometry_motion(model, p, closed, JX, basis)
    blocks = [prediction.readings(model, p, motion)]
    if unknowns.n_effects:
        assert p.situation is not None
        parts = prediction.unit_contributions(model, p.situation)
        blocks.append(prediction.effect_columns(model, p, closed, JX, parts))
    if unknowns.n_frame:
        blocks.append(prediction.frame_columns(model, p))
    columns = blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=-1)
    noise = Noise.of(data) if noise is None else noise
    whitened = noise.whiten(error), noise.whiten(columns)
    return Linearisation(*whitened, unknowns.n_geometry, noise.row, noise.component, p, motion)


def seen_from(model: Model, data: Measurements) -> Model:
    """The model in the measuring frame of the data: registered where a tracker's is not known yet, none in the base."""
    if data.frame != "tracker":
        return replace(model, frame=None)
    return model if model.frame is not None else replace(model, frame=register(model, data))


def register(model: Model, data: Measurements) -> Frame:
    """First guess of the frame: the rigid motion that best lays predicted on measured positions (Kabsch)."""
    p = prediction.predict(replace(model, frame=None), data.q, conditions_of(data))
    full = data.mask[:, :3].all(axis=1) & (p.status == "ok")
    if full.sum() < 3:
        raise InputError(
            f"only {full.sum()} rows have x, y and z: an unknown frame needs at least 3",
            file=data.source,
            remedy="measure more poses, or in the base frame (# frame = base)",
        )
    a, b = p.position[full], data.position[full]
    R = rotation.laying(a - a.mean(0), b - b.mean(0))
    return Frame(R, b.mean(0) - R @ a.mean(0))
