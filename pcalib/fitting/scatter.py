"""The noise that data show: joints that do not repeat, from replicates, and how far residuals are from the stated σ."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from pcalib.data import replicates
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.fitting.linearisation import joint_response
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Model

ENOUGH_REPLICATES = 10
"""Degrees of freedom of replicates, per class of readings, from which on they give σ: to about ± 22 %."""
ENOUGH_RESIDUALS = 30
"""Degrees of freedom of residuals, per class of readings, from which on they give σ: to about ± 13 %."""
CLEAR = 2.7
"""2·Δlog likelihood from which on joints are said not to repeat: p = 0.05 for one variance that cannot be negative. In
40 poses measured twice with 20 µm, 60 µrad are seen in 90 % of the data sets, and anything in 2 % where there is
nothing."""
QUIET = 0.1
"""Scatter of replicates over the stated noise below which it is no noise of joints: readings were computed or copied,
and what they differ by is a drift between them."""
_ROUNDS, _SMALLEST = 30, 0.02
"""Rounds of Fisher scoring, and the share of its last value below which a variance does not fall in one round."""

_CLASSES = (slice(0, 3), slice(3, 6))


class Source(Enum):
    """What the σ of parameters are scaled by."""

    RESIDUALS = "residuals"
    REPLICATES = "replicates"
    STATED = "stated"


@dataclass(frozen=True)
class Scale:
    """The noise that the data support, over the σ that the fit weighed with."""

    source: Source
    ratio: np.ndarray
    """(2,) noise of positions and of rotations over σ; 1 where the stated σ is taken."""
    dof: np.ndarray
    """(2,) degrees of freedom of each ratio; inf where the stated σ is taken."""
    replicates: np.ndarray
    """(2,) noise over σ as replicates alone show it; NaN where too few rows are repeated."""
    sigma_q: float = 0.0
    """[rad or m] 1σ repeatability of the joints, in the weights of the fit; 0 where replicates do not show it."""
    components: tuple[np.ndarray, np.ndarray] = (np.full(6, np.nan), np.zeros(6))
    """(6,) residuals over the σ that the fit weighed with, component by component, and the degrees of freedom behind
    each; NaN where a component is not measured."""

    def sentence(self, stated: tuple[bool, bool], measured: tuple[bool, bool]) -> str:
        """What the σ of parameters follow from.

        Args:
            stated: whether the file states σ of positions and of rotations.
            measured: whether any are measured.
        """
        if self.source is Source.STATED:
            text = "The σ of parameters follow from the σ of the file; there are too few readings to judge it."
        else:
            classes = zip(self.ratio, stated, measured, ("positions", "rotations"), strict=True)
            parts = [
                f"{ratio:.2g}× the {'stated' if told else 'assumed'} σ of {what}"
                for ratio, told, seen, what in classes
                if seen
            ]
            text = f"The σ of parameters follow from the {self.source.value}, which are {' and '.join(parts)}."
        if self.sigma_q:
            text += f" Replicates show that joints repeat to {self.sigma_q * 1e6:.2g} µrad (µm); the weights hold it."
        return text


NOT_SCALED = Scale(Source.STATED, np.ones(2), np.full(2, np.inf), np.full(2, np.nan))
"""Where the stated σ stands."""


@dataclass(frozen=True)
class Repeated:
    """What replicates say, by restricted maximum likelihood (REML)."""

    ratio: np.ndarray
    """(2,) σ of positions and rotations over the stated ones, without joints; NaN where too few are repeated."""
    sigma_q: float


GROSS = 10.0
"""Times the scatter of half of all groups from which a group holds a gross row, which is no noise (as a diagnosis sets
rows aside)."""


def with_joints(data: Measurements, model: Model, pose: Pose) -> tuple[Noise, Repeated]:
    """The stated noise of fitted rows, and that of joints with it where replicates show it."""
    noise, nothing = Noise.of(data), Repeated(np.full(2, np.nan), 0.0)
    if not (data.pose_id >= 0).any():
        return noise, nothing
    group = replicates.groups(data)
    rows = np.flatnonzero(group >= 0)
    if not len(rows):
        return noise, nothing
    response = joint_response(model, data, pose)
    found = repeated(data.take(rows), group[rows], response[rows], data.kinds[0])
    if not found.sigma_q:
        return noise, found
    return _counted(noise, found, response), found


def with_repeated(noise: Noise, found: Repeated, model: Model, data: Measurements, pose: Pose) -> Noise:
    """The noise of further rows with what replicates say of joints."""
    return _counted(noise, found, joint_response(model, data, pose)) if found.sigma_q else noise


def _counted(noise: Noise, found: Repeated, response: np.ndarray) -> Noise:
    ratio = np.where(np.isnan(found.ratio), 1.0, found.ratio)
    return noise.scaled(ratio).with_joints(response, found.sigma_q)


def repeated(data: Measurements, group: np.ndarray, response: np.ndarray, lengths: bool = True) -> Repeated:
    """Variances of positions, rotations and joints from the scatter of replicates about the means of their groups.

    The scatter W of a group of r rows has the Wishart distribution of r − 1 degrees of freedom about
    Σ = θ₁·Σ_pos + θ₂·Σ_rot + θ₃·G·Gᵀ; Fisher scoring finds θ, and the time it takes grows with the groups only.

    Args:
        group: (N,) number of each row's group.
        response: G (N, 6, nq) derivative of the readings by the position of every actuator.
        lengths: whether lengths are measured at all. Joints then count only where lengths are repeated: angles alone
            hardly answer to joints, and would blame a little noise on joints that miss by millimetres.
    """
    first = np.unique(group, return_index=True)[1]
    alike = (data.mask == data.mask[first[group]]).all(axis=1)
    data, group, response = data.take(alike), group[alike], response[alike]
    count = len(first)
    mask, nu = data.mask[first], np.bincount(group, minlength=count) - 1.0
    value = data.beside(data.take(first[group]))
    value = np.where(data.mask, value / data.sigma, 0.0)
    value -= (_sums(value, group, count) / (nu[:, None] + 1))[group]
    W = _sums(value[:, :, None] * value[:, None, :], group, count)
    eye = np.eye(6) * mask[:, None, :]
    plain = eye if data.correlation is None else data.correlation[first] * mask[:, :, None] * mask[:, None, :]
    G = (response / data.sigma[:, :, None])[first] * mask[:, :, None]
    unit = 1.0 / max(float(np.sqrt(np.mean(np.sum(G[mask] ** 2, axis=-1)))), 1e-300)
    size = np.trace(W, axis1=1, axis2=2) / np.maximum(nu * mask.sum(axis=1), 1.0)
    good = size <= GROSS**2 * np.median(size)
    W, nu, mask, plain, G = W[good], nu[good], mask[good], plain[good], G[good]
    dof = np.array([np.sum(nu[:, None] * mask[:, part]) for part in _CLASSES])
    enough = dof >= ENOUGH_REPLICATES
    if not enough.any():
        return Repeated(np.full(2, np.nan), 0.0)
    parts = []
    for part in _CLASSES:
        block = np.zeros((6, 6))
        block[part, part] = 1.0
        parts.append(plain * block)
    if data.correlation is not None:  # one factor for readings that belong together
        parts, enough = [plain], np.array([bool(enough.all())])
    known = np.flatnonzero(enough)
    base = sum((parts[k] for k in range(len(parts)) if not enough[k]), np.eye(6) * ~mask[:, None, :])
    joint = unit**2 * G @ np.swapaxes(G, -1, -2)
    without = _scored([parts[k] for k in known], base, W, nu)
    both = _scored([*(parts[k] for k in known), joint], base, W, nu)
    quiet = float(np.mean(size[good])) < QUIET**2
    clear = (enough[0] or not lengths) and not quiet and 2 * (both[1] - without[1]) > CLEAR
    theta = both[0] if clear else without[0]
    ratio = np.full(2, np.nan)
    ratio[known if data.correlation is None else slice(0, 2)] = np.sqrt(theta[: len(known)])
    return Repeated(ratio, float(np.sqrt(theta[-1]) * unit) if clear else 0.0)


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    out = np.zeros((count, *values.shape[1:]))
    np.add.at(out, group, values)
    return out


def _scored(parts: list[np.ndarray], base: np.ndarray, W: np.ndarray, nu: np.ndarray) -> tuple[np.ndarray, float]:
    """Variances θ of Σ = base + Σ θ_k·S_k, each (G, 6, 6), and the log likelihood.

    Args:
        W: (G, 6, 6) scatters, of
        nu: (G,) degrees of freedom.
    """
    theta = np.ones(len(parts))
    S = np.stack(parts)

    def whole(theta: np.ndarray) -> np.ndarray:
        return base + np.einsum("k,kgij->gij", theta, S)

    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(whole(theta))
        each = inverse @ S
        A = np.einsum("g,kgij,mgji->km", nu, each, each)
        b = np.einsum("kgij,gji->k", each @ inverse, W) - np.einsum("g,kgij,gji->k", nu, each, inverse @ base)
        fresh = np.maximum(np.linalg.lstsq(A, b, rcond=None)[0], _SMALLEST * theta)
        steady = np.abs(fresh - theta).max() < 1e-4 * fresh.max()
        theta = fresh
        if steady:
            break
    total = whole(theta)
    likelihood = -0.5 * np.sum(nu * np.linalg.slogdet(total)[1]) - 0.5 * np.einsum("gij,gji->", np.linalg.inv(total), W)
    return theta, float(likelihood)


def scale(error: np.ndarray, noise: Noise, weight: np.ndarray, leverage: np.ndarray, found: Repeated) -> Scale:
    """By what the σ that a fit weighed with are to be multiplied.

    Args:
        error: (N, 6) residuals of the fitted rows.
        weight: (N,) robust weights; what a row counts is its influence w·r (Huber's proposal 2).
        leverage: (6,) degrees of freedom that the unknowns take of each component.
        found: what replicates say.
    """
    whitened = np.nan_to_num(noise.whiten(error)) ** 2 * weight[noise.row] ** 2
    each = np.bincount(noise.component, whitened, 6)
    counts = np.bincount(noise.component, weight[noise.row] ** 2, 6)
    left = counts - leverage
    with np.errstate(divide="ignore", invalid="ignore"):
        components = np.where(left > 0, np.sqrt(each / left), np.nan), np.maximum(left, 0.0)
    chi2, count, dof = (np.array([v[part].sum() for part in _CLASSES]) for v in (each, counts, left))
    if noise.covariance is not None:  # whitened readings hold others: one factor for all of a row
        chi2, dof = np.full(2, chi2.sum()), np.full(2, dof.sum())
    ratio, source = np.ones(2), Source.STATED
    joints = 1.0 if found.sigma_q else found.ratio  # with joints, what replicates say is in the weights already
    counted = count > 0
    enough = counted & (dof >= ENOUGH_RESIDUALS)
    ratio[enough] = np.sqrt(np.maximum(chi2[enough], 1e-30) / dof[enough])
    by_replicates = counted & ~enough & np.isfinite(found.ratio)
    ratio[by_replicates] = np.broadcast_to(joints, 2)[by_replicates]
    if enough.any():
        source = Source.RESIDUALS
    elif by_replicates.any():
        source = Source.REPLICATES
    behind = np.where(enough, dof, np.where(by_replicates, ENOUGH_REPLICATES, np.inf))
    return Scale(source, ratio, behind, found.ratio, found.sigma_q, components)
