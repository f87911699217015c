"""What a fit leaves unexplained beyond the noise, from rows that it was not fitted to.

Rows that were held out are predicted as they are. Every other row i is predicted by the fit without it, which needs no
refit: with whitened residuals z_i and leverage H_i = B_i·C·B_iᵀ, B_i the row's whitened derivatives and C the
posterior covariance, the residual of the fit without the row is (I − H_i)⁻¹·z_i, and its covariance is (I − H_i)⁻¹
where nothing is missing; that of a held-out row is I + H_i (Cook and Weisberg 1982). What the squares of these
residuals have beyond that covariance is unexplained: rotations give the turn of the plate, and positions, at tools
of any length, the shift that is left when the turn is accounted for (:mod:`pcalib.unexplained`).

Nothing counts as unexplained where χ² of positions, or of rotations, is below its mean plus half a standard error, but
for what rows under neighbouring conditions share beyond chance (:mod:`pcalib.uncertainty.neighbours`).
Above, the estimate is unbiased and not below zero; where the misfit is significant it is one standard error larger, and
scaled until 95 % of the rows lie inside of what is predicted for them, because residuals of a missing effect are not
normal (split conformal prediction, Vovk 2005). The same is done where too few rows lie inside for chance: of all rows,
and of those held out by themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pcalib import prediction
from pcalib.data import replicates
from pcalib.data.noise import Noise
from pcalib.fitting import least_squares
from pcalib.fitting.identification import Fit
from pcalib.fitting.linearisation import ROWS, conditions_of, linearise
from pcalib.model import Model
from pcalib.uncertainty import neighbours, radius
from pcalib.unexplained import Envelope, Unexplained

FEWEST_HELD_OUT = 20
"""Held-out rows from which on they are judged by themselves: the largest of 19 residuals is the 95 % point."""
SIGNIFICANT = 1.645
"""Standard errors beyond which a misfit is significant, with a risk of 5 %."""
DOUBTFUL = 0.5
"""Standard errors of χ² up to which a misfit counts as none. Noise alone exceeds it in three of ten fits, and widens
u95 there: with nothing hidden coverage becomes 97 % (measured by scripts/uncertainty_study)."""
ALIKE = 1.0
"""Standard errors up to which what neighbouring rows share counts as nothing. Noise alone exceeds them in one of six
fits, and widens u95 by a tenth in these. Of landings of a robot whose frame bends, 93 to 95 % then lie inside u95, and
90 % without this comparison."""
FEWEST_REPLICATES = 10
"""Degrees of freedom of replicates from which on their scatter, known to a quarter, may correct the stated σ."""
FAR = 10.0
"""Times the median residual beyond which a row is gross, and left aside."""
GROSS = 0.05
"""Share of rows that may be gross; more of them are a misfit."""
DIFFERENT = 0.1
"""Relative spread of the tools' effect on positions from which on shift and turn can be told apart by positions."""


def assessed(fit: Fit) -> Model:
    """The fitted model with what it leaves unexplained.

    Raises:
        FitError: the fit is not usable.
    """
    model, data = fit.model, fit.data
    p = prediction.predict(model, data.q, conditions_of(data))
    if model.posterior is None:
        return model
    rows = _left_out(fit)
    arm = (p.pose.R @ p.tool[..., None])[..., 0]
    if model.frame is not None:
        arm = arm @ model.frame.rotation.T
    lever = np.einsum("ni,ni->n", arm, arm)[:, None] - arm**2
    judged = rows.usable & rows.seen[:, :3].any(axis=1)
    held = judged & data.check
    enough = int(held.sum()) >= FEWEST_HELD_OUT
    misfit = rows.misfit
    significant = bool(misfit[0] > SIGNIFICANT)  # of positions, by which the scale is found
    shift, turn = _split(rows, lever, _half_width(model), misfit)
    envelope = Envelope.of(data.tool, data.payload, p.pose.x, data.q, data.columns)
    if not significant:
        alike = neighbours.shared(fit, rows.noise, rows.usable)
        shift = max(shift, alike.sigma) if alike.errors > ALIKE else shift
    found = Unexplained(shift, turn, 0, 0, 0, envelope)
    for some in (judged, held):
        inside = rows.inside(found.covariance(arm))[some]
        if len(inside) >= FEWEST_HELD_OUT and (significant or _too_few(inside)):
            if not significant:  # what scatters too far is a misfit that the mean does not show
                shift, turn = _split(rows, lever, _half_width(model), np.full(2, np.inf))
                found = replace(found, shift=max(shift, found.shift), turn=max(turn, found.turn))
            scale = _scale(rows, found.covariance(arm), some)
            found = replace(found, shift=scale * found.shift, turn=scale * found.turn)
    counted = held if enough else judged
    inside = rows.inside(found.covariance(arm))[counted]
    found = replace(
        found, rows=len(inside), inside=int(inside.sum()), held_out=len(inside) if enough else 0
    )
    return replace(model, uncertainty=found)


@dataclass(frozen=True, eq=False)
class _Rows:
    """N rows, each predicted by a fit without it."""

    error: np.ndarray
    """(N, 6) [m, rad] measured − predicted; 0 where not measured."""
    covariance: np.ndarray
    """(N, 6, 6) of it where nothing is missing; 0 where not measured."""
    seen: np.ndarray
    """(N, 6) bool."""
    usable: np.ndarray
    """(N,) bool: predicted, and not gross."""
    noise: Noise
    """As stated, or as replicates show it."""

    @property
    def excess(self) -> np.ndarray:
        """(N, 6) squares of the errors beyond what noise and parameters make."""
        return self.error**2 - np.diagonal(self.covariance, axis1=1, axis2=2)

    @property
    def misfit(self) -> np.ndarray:
        """(2,) standard errors by which χ² of positions and of rotations exceeds its mean where nothing is missing."""
        return np.array([self._misfit([True] * 3 + [False] * 3), self._misfit([False] * 3 + [True] * 3)])

    def _misfit(self, columns: list[bool]) -> float:
        some = self.seen & self.usable[:, None] & columns
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)
        size = np.sqrt(np.where(some, variance, 1.0))
        both = some[:, :, None] & some[:, None, :]
        correlation = np.where(both, self.covariance / (size[:, :, None] * size[:, None, :]), 0.0)
        return float(np.sum((self.excess / size**2)[some]) / np.sqrt(max(2 * np.sum(correlation**2), 1e-300)))

    def standard_error(self, some: np.ndarray) -> float:
        """Of the mean excess over readings `some` (N, 6), where nothing is missing: var Σe² = 2·tr Σ²."""
        both = some[:, :, None] & some[:, None, :]
        return float(np.sqrt(2 * np.sum(np.where(both, self.covariance, 0.0) ** 2)) / max(some.sum(), 1))

    def inside(self, left: np.ndarray) -> np.ndarray:
        """(N,) bool: positions within u95 of noise, parameters, and what is left with covariance (N, 3, 3)."""
        return np.linalg.norm(self.error[:, :3], axis=1) <= radius.containing(self._with(left))

    def _with(self, left: np.ndarray) -> np.ndarray:
        seen = self.seen[:, :3]
        return self.covariance[:, :3, :3] + np.where(seen[:, :, None] & seen[:, None, :], left, 0.0)


def _left_out(fit: Fit) -> _Rows:
    """Every row, predicted without it.

    The noise is the one that is stated, or that replicates show, and not that of the residuals: a misfit must not pass
    for noise. Leverages do not depend on it, because the covariance of the fit goes with the noise that it supports.
    """
    data, n = fit.data, len(fit.data)
    error, covariance = np.zeros((n, 6)), np.zeros((n, 6, 6))
    noise = fit.noise.scaled(np.full(2, _factor(fit)))
    eye = np.eye(6)
    for part, B in _derivatives(fit, fit.noise.scaled(fit.scale.ratio)):
        held, now = data.check[part], noise.take(part)
        H = B @ fit.covariance @ np.swapaxes(B, -1, -2)
        alone = np.linalg.inv(eye - np.where(held[:, None, None], 0.0, _bounded(H)))
        whitened = now.padded(np.where(now.measured, np.nan_to_num(fit.error[part]), 0.0))
        back = np.where(now.measured[:, :, None] & now.measured[:, None, :], np.linalg.inv(now.whitener), 0.0)
        error[part] = (back @ (alone @ whitened[..., None]))[..., 0]
        inner = np.where(held[:, None, None], eye + H, alone)
        covariance[part] = back @ inner @ np.swapaxes(back, -1, -2)
    aside = _rotations_left_out(fit, noise.measured)
    error = np.where(np.isfinite(aside), aside, error)
    covariance += np.where(np.isfinite(aside), data.sigma**2, 0.0)[:, :, None] * eye
    seen = (noise.measured & np.isfinite(fit.error)) | np.isfinite(aside)
    times = np.sqrt(np.sum((error / noise.sigma) ** 2 * seen, axis=1) / np.maximum(seen.sum(axis=1), 1))
    usable = seen.any(axis=1)
    far = usable & (times > FAR * np.median(times[usable])) if usable.any() else ~usable
    if far.mean() > GROSS:
        far = np.zeros(n, bool)
    return _Rows(np.where(seen, error, 0.0), covariance, seen, np.asarray(usable & ~far), noise)


def _rotations_left_out(fit: Fit, measured: np.ndarray) -> np.ndarray:
    """(N, 6) [rad] errors of rotations that were measured and that the level leaves out of the fit; NaN elsewhere.

    They show what turns the plate all the same. In a tracker's frame their mean is the turn of the tracked body, which
    no level without rotations finds.
    """
    out = np.where(fit.data.mask & ~measured, fit.error, np.nan)
    out[:, :3] = np.nan
    if fit.candidate.frame is not None and np.isfinite(out).any():
        out[:, 3:] -= np.nanmean(out[:, 3:], axis=0)
    return out


def _derivatives(fit: Fit, noise: Noise) -> Iterator[tuple[slice, np.ndarray]]:
    """Slices of the rows, and their whitened derivatives (n, 6, unknowns)."""
    for start in range(0, len(fit.data), ROWS):
        part = slice(start, min(start + ROWS, len(fit.data)))
        now = noise.take(part)
        linear = linearise(fit.candidate, fit.data.take(part), fit.unknowns, noise=now)
        yield part, linear.padded


def _bounded(H: np.ndarray) -> np.ndarray:
    """Leverages with eigenvalues of at most 0.99: a row on which a direction depends alone says nothing of it."""
    values, vectors = np.linalg.eigh(H)
    return (vectors * np.clip(values, 0.0, 0.99)[:, None, :]) @ np.swapaxes(vectors, -1, -2)


def _factor(fit: Fit) -> float:
    """Noise over that of the fit's weights, where replicates show beyond doubt that it is another; else 1."""
    from scipy.special import gammaincinv

    if fit.scale.sigma_q:  # the weights follow the replicates already
        return 1.0
    seen = replicates.noise(fit.data)
    ratios = [(r, d) for r, d in ((seen.ratio_pos, seen.dof_pos), (seen.ratio_rot, seen.dof_rot)) if d > 0]
    dof = sum(d for _, d in ratios)
    if dof < FEWEST_REPLICATES:
        return 1.0
    square = sum(d * r**2 for r, d in ratios) / dof
    low, high = (2 * gammaincinv(dof / 2, p) / dof for p in (0.005, 0.995))
    return float(np.sqrt(square)) if not low <= square <= high else 1.0


def _half_width(model: Model) -> float:
    """[m] RMS distance of the plate's joints from their middle: an error of one rod shifts the plate about as much, and
    turns it by that over this length. Infinite where nothing turns the plate."""
    mechanism = model.robot.mechanism
    if not mechanism.plate_turns:
        return np.inf
    points = mechanism.plate_points(model.k)
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def _split(rows: _Rows, lever: np.ndarray, half_width: float, misfit: np.ndarray) -> tuple[float, float]:
    """Standard deviations [m, rad] of the plate's shift and turn per component.

    Args:
        lever: (N, 3) [m²] variance of each component of the position by a turn of unit variance.
        half_width: [m] of the plate, for positions that do not tell shift and turn apart.
        misfit: (2,) of positions and rotations, in standard errors.
    """
    some = rows.seen & rows.usable[:, None]
    moved, turned = some.copy(), some.copy()
    moved[:, 3:] = False
    turned[:, :3] = False
    excess, turn2 = rows.excess, 0.0
    generous = misfit > SIGNIFICANT
    if turned.any() and misfit[1] > DOUBTFUL:
        turn2 = max(float(excess[turned].mean()), 0.0) + generous[1] * rows.standard_error(turned)
    if not moved.any():
        return float(np.sqrt(turn2)) * half_width if turn2 else 0.0, float(np.sqrt(turn2))
    if misfit[0] <= DOUBTFUL:
        return 0.0, float(np.sqrt(turn2))
    own, x = excess[:, :3][moved[:, :3]], lever[moved[:, :3]]
    more = generous[0] * rows.standard_error(moved)
    if turned.any():
        shift2 = max(float(np.mean(own - turn2 * x)), 0.0) + more
    elif np.std(x) > DIFFERENT * max(half_width**2, float(x.mean())):
        both = np.stack([np.ones_like(x), x], axis=1)
        shift2, turn2 = least_squares.bounded(both, own + more, np.zeros(2), np.full(2, np.inf))
    else:
        shift2 = max(float(own.mean()), 0.0) + more
        turn2 = shift2 / half_width**2
    return float(np.sqrt(shift2)), float(np.sqrt(turn2))


def _scale(rows: _Rows, left: np.ndarray, some: np.ndarray) -> float:
    """Factor ≥ 1 on what is unexplained with which the 95 % point of n + 1 rows lies inside."""
    n = int(some.sum())
    if n < FEWEST_HELD_OUT - 1 or not np.trace(left, axis1=1, axis2=2)[some].any():
        return 1.0
    length = np.linalg.norm(rows.error[some, :3], axis=1)
    chosen = _Rows(
        rows.error[some], rows.covariance[some], rows.seen[some], rows.usable[some], rows.noise.take(some)
    )

    def point(scale: float) -> float:
        times = np.sort(length / radius.containing(chosen._with(scale**2 * left[some])))
        rank = min(radius.COVERAGE * (n + 1), n) - 1
        return float(np.interp(rank, np.arange(n), times))

    low, high = 1.0, 1.0
    while point(high) > 1 and high < 64:
        low, high = high, 2 * high
    for _ in range(20):
        if high - low < 1e-3:
            break
        middle = 0.5 * (low + high)
        low, high = (middle, high) if point(middle) > 1 else (low, middle)
    return high


def _too_few(inside: np.ndarray) -> bool:
    """Whether so few rows lie inside that chance makes it in less than 5 %."""
    from scipy.special import bdtr

    return bool(bdtr(int(inside.sum()), len(inside), radius.COVERAGE) < 0.05)
