"""The outer loop of a fit: weights that depend on where the search stands.

Three things are re-estimated after a step, while the step itself takes them as known: robust weights of rows, the
common scale of the manufacturing priors, and the widths of the priors of effects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.data.noise import Noise
from pcalib.fitting import least_squares
from pcalib.fitting.unknowns import EFFECT_PRIOR_WIDTH

ROBUST_AT = 2.5
"""σ per component beyond which a row weighs less under a robust loss; Gaussian rows of six readings stay below it."""
_MEDIAN_RMS = 0.9
"""Median over rows of the RMS of a few standard normal readings: 0.94 of six, 0.89 of three."""
_MANY = 20
"""Directions that the data know better than the drawing does, from which on their median is used: the median of 20 is
known to 25 %, which is enough for a scale of priors."""
_SCALES = np.geomspace(1.0, 100.0, 60)
"""Candidates for the scale of the priors, 8 % apart; the result is interpolated between them."""
_MEDIAN = 0.6745
"""Median of |z| for a standard normal z."""
WIDENED = 2.0
"""Scale of the priors that asks for an explanation: chance alone reaches 1.3 with 40 directions."""
_TURNS, _ALIKE = 20, 0.05
"""Most turns in which scale and gross errors are found, and the relative change below which they are found."""
GROSS = 10.0
"""Tolerances (1 mm, 0.5°) from which on a change is taken for an error of the drawing and not of manufacture."""
FEW = 0.125
"""Share of the dimensions that may be grossly wrong: of a Delta's 60, the six that an arm of another length changes."""
_KNOWN = 0.5
"""Share of an effect's prior variance that the data must take away before its prior is widened."""


@dataclass(frozen=True)
class Weights:
    """What the outer loop decides."""

    row: np.ndarray
    """(N,) robust weight of each row."""
    scale: float
    """Common factor on the priors of the geometry."""
    gross: np.ndarray
    """(n_geometric,) further factor on each, more than 1 where the drawing is grossly wrong."""
    room: np.ndarray
    """(n_effects,) 1σ of the priors of effects, in natural sizes."""

    def change(self, before: Weights) -> tuple[float, float]:
        """Largest change of a row's weight, and largest relative change of the prior of an effect or of a dimension."""
        room = np.abs(self.room / before.room - 1).max(initial=0.0)
        return np.abs(self.row - before.row).max(), max(room, np.abs(self.gross / before.gross - 1).max(initial=0.0))


def robust_weights(error: np.ndarray, noise: Noise, loss: str) -> np.ndarray:
    """Weight (N,) of each row by the RMS z of its whitened residuals: 'huber' min(1, c/z), 'cauchy' 1/(1 + (z/c)²).

    The threshold c grows with the median of all rows, because a misfit that all rows share makes no outliers.
    """
    if loss == "linear":
        return np.ones(len(error))
    square = np.nan_to_num(noise.whiten(error)) ** 2
    seen = (~np.isnan(error)).sum(axis=1)
    z = np.sqrt(np.bincount(noise.row, square, len(error)) / np.maximum(seen, 1))
    z = z / (max(1.0, float(np.median(z)) / _MEDIAN_RMS) * ROBUST_AT)
    return np.where(z <= 1, 1.0, 1 / np.maximum(z, 1)) if loss == "huber" else 1 / (1 + z * z)


def prior_scale(rows: np.ndarray, u: np.ndarray, prior: np.ndarray, geometric: np.ndarray) -> float:
    """The prior's scale τ that agrees with the geometric errors found, never below the stated tolerances.

    Along an eigenvector of the data's information λ the unshrunk estimate has variance τ² + 1/λ. Evidence asks that
    the shrunk ones have the size that they should have in the mean square (MacKay 1992). Where the data know many
    directions better than the drawing does, the median replaces the mean square: something that the model misses shows
    in a few directions, as errors of many tolerances, and must not make room for itself. The result does not depend on
    an earlier τ, so that no iteration over τ is needed.

    Args:
        rows: (·, n + 1) what the data say of a step from u.
        u: (n,) position, in natural sizes.
        prior: (n,) 1σ of the unknowns; that of the geometry does not count.
        geometric: indices of the geometric unknowns.
    """
    corner = rows
    if len(geometric) < len(u):
        # In triangular form with the geometry last, its corner holds what the other unknowns leave of its information.
        others = np.setdiff1d(np.arange(len(u)), geometric)
        corner = least_squares.with_priors(rows[:, np.r_[others, geometric, -1]], -u[others], prior[others])
        corner = np.asarray(np.linalg.qr(corner, mode="r"))[len(others) :, len(others) :]
    J, y = corner[:, :-1], corner[:, -1]
    of_data, V = np.linalg.eigh(J.T @ J)
    known = of_data > 1
    many = known.sum() >= _MANY
    seen = known if many else of_data > 1e-6
    if not seen.any():
        return 1.0
    estimate = (V.T @ (J.T @ (y + J @ u[geometric])))[seen] / of_data[seen]
    share = _SCALES[:, None] ** 2 / (_SCALES[:, None] ** 2 + 1 / of_data[seen])
    if many:
        shrunk = np.sort(np.abs(estimate) * np.sqrt(share), axis=1)
        size = 0.5 * (shrunk[:, (len(estimate) - 1) // 2] + shrunk[:, len(estimate) // 2]) / (_MEDIAN * _SCALES)
    else:
        size = np.sqrt(np.sum((share * estimate) ** 2, axis=1) / np.sum(share, axis=1)) / _SCALES
    enough = np.flatnonzero(size <= 1)
    if not len(enough) or enough[0] == 0:
        return float(_SCALES[0 if len(enough) else -1])
    between = slice(enough[0] - 1, enough[0] + 1)
    return float(np.exp(np.interp(0.0, -np.log(np.maximum(size[between], 1e-300)), np.log(_SCALES[between]))))


def priors(
    rows: np.ndarray, u: np.ndarray, prior: np.ndarray, geometric: np.ndarray, readings: int
) -> tuple[float, np.ndarray]:
    """The common scale of the priors of the geometry, and factors (n_geometric,) of gross errors beside it.

    One gross error leaks into all eigenvectors and so into the common scale, which then hides it. The two are therefore
    found in turn, each with the other as it is, from the stated tolerances on. Many gross errors are no errors of the
    drawing but something that the model misses, and are given no room.

    Args:
        rows, u, prior, geometric: as of :func:`prior_scale`; all unknowns are in `rows`.
        readings: how many are behind `rows`. What no unknown explains of them makes all of them count less.
    """
    left = rows[-1, -1] ** 2 / max(readings - len(u), 1) if len(rows) > len(u) else 0.0
    doubted = rows / np.sqrt(max(1.0, left))
    size, wide, gross = np.ones(len(u)), prior.copy(), np.ones(len(geometric))
    scale = 1.0
    for _ in range(_TURNS):
        wide[geometric] = scale * gross * prior[geometric]
        there = u + least_squares.solve(doubted, -u, wide)[0]
        before, gross = gross, gross_errors((there / prior)[geometric], scale)
        size[geometric] = gross
        scale = prior_scale(rows * np.append(size, 1.0), u / size, prior, geometric)
        if np.abs(gross / before - 1).max(initial=0.0) < _ALIKE:
            break
    if np.sum(gross > 1) > FEW * len(gross):
        gross = np.ones(len(gross))
        scale = prior_scale(rows, u, prior, geometric)
    return scale, gross


def gross_errors(u: np.ndarray, scale: float) -> np.ndarray:
    """Factors (n,) on the priors of dimensions that lie many tolerances from the drawing: |z|/c for |z| > c, else 1.

    Iteratively reweighted, such a factor makes the prior Gaussian within c tolerances and a Cauchy distribution beyond:
    an error in the drawing or in the robot file is no manufacturing error, and draws on nothing else.

    Args:
        u: (n,) changes from the drawing in tolerances.
        scale: common factor on the tolerances.
    """
    return np.maximum(1.0, np.abs(u) / (GROSS * scale))


def effect_room(u: np.ndarray, variance: np.ndarray, room: np.ndarray, least: np.ndarray) -> np.ndarray:
    """1σ of the priors of effects: widened where data show a size above the usual one, which is not shrunk then.

    Args:
        u: (n,) values, and `variance` (n,) of them, in natural sizes.
        room: (n,) 1σ so far; `least` (n,) that of the library.
    """
    gamma = 1.0 - variance / room**2
    seen = np.isfinite(gamma) & (gamma > _KNOWN)
    wide = EFFECT_PRIOR_WIDTH * np.abs(u) / np.sqrt(np.where(seen, gamma, 1.0))
    return np.where(seen, np.maximum(wide, least), room)
