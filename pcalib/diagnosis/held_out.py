"""What held-out rows say: whether a model fits them as it stands, and whether an explanation is confirmed by them.

With residuals r (m,) of the held-out rows in units of the noise, and the columns J (m, n) of everything the model has
fitted, each scaled by its prior,

    V = I + J·P·Jᵀ        P = (NᵀN + I)⁻¹, the posterior covariance from the rows to fit (columns N)

is the covariance of r where nothing is missing: the whole noise, joint repeatability included, and the doubt that the
fit leaves in its parameters. A model as it stands is judged by rᵀV⁻¹r. An explanation changes the prediction by d = r −
r′, r′ the residuals after a full refit with it, and

    t = dᵀV⁻¹r / √(dᵀV⁻¹d)

is standard normal where the explanation is wrong and nothing is missing, because d depends on the rows to fit alone;
where it is right, t has the mean √(dᵀV⁻¹d). χ² falls where dᵀV⁻¹r > dᵀV⁻¹d/2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.diagnosis.hypothesis import Hypothesis, start_of
from pcalib.diagnosis.problem import Problem, Reading
from pcalib.diagnosis.tails import Tails, tails_of
from pcalib.errors import FitError, InputError
from pcalib.fitting import identification, linearisation
from pcalib.model import Model

SURE = 2.0
"""Standard errors by which held-out χ² must fall to confirm an explanation: chance confirms a wrong one in 2.3 %."""
FEWEST = 5
"""Held-out rows below which nothing is confirmed: four do not tell the scatter between rows to a factor of two."""
MOST = 400
"""Held-out rows that are used at most, spread evenly: V is a full matrix over their readings."""
HEAVY = 2.0
"""Standard errors of the kurtosis from which held-out readings have heavy tails. A misfit of all rows has none."""
FAR = 10.0
"""Times the size of half of all rows from which a held-out row counts as gross, as among the rows to fit."""
GROSS = 0.05
"""Share of the held-out rows that may be gross; more of them are a misfit."""


Pairs = Sequence[tuple[Hypothesis, np.ndarray]]
"""Hypotheses and the parameters (p,) [SI] that a fit of them starts from."""


@dataclass(frozen=True)
class Change:
    """Held-out rows before and after an explanation, both after a full refit."""

    before: float
    after: float
    """χ² with the whole covariance."""
    readings: int
    rows: int
    t: float
    """By how many standard errors the readings ask for the change (below 0: for its undoing): of the noise, or of the
    scatter between rows where that is larger."""
    by_rotations: bool
    """Whether rotations changed by more than positions did."""

    @property
    def times_before(self) -> float:
        """Root of χ² per reading before."""
        return float(np.sqrt(self.before / max(self.readings, 1)))

    @property
    def times_after(self) -> float:
        """Root of χ² per reading after."""
        return float(np.sqrt(self.after / max(self.readings, 1)))

    @property
    def confirmed(self) -> bool:
        """Whether χ² fell, and by more than chance lets it fall with a wrong explanation."""
        return self.rows >= FEWEST and self.after < self.before and self.t > SURE

    @property
    def p(self) -> float:
        """Probability that held-out rows confirm a wrong explanation as clearly by chance."""
        from scipy.special import ndtr

        return float(ndtr(-self.t))

    @property
    def refuted(self) -> bool:
        """Whether χ² rose by more than chance."""
        return self.rows >= FEWEST and self.after > self.before and self.t < -SURE


@dataclass(frozen=True)
class HeldOut:
    """The held-out rows of a data set, in noise units of a problem on its rows to fit."""

    data: Measurements
    reading: Reading
    whitener: np.ndarray
    """(m, m) inverse Cholesky factor of V."""
    gross: np.ndarray
    """(n,) bool, rows that are far from everything; they are left out."""
    tails: Tails | None = None
    """How heavy tails of the noise are met, as among the rows to fit."""

    @classmethod
    def of(cls, made: Problem, data: Measurements) -> HeldOut | None:
        """The held-out rows of a data set; None where it has none."""
        rows = np.flatnonzero(data.check)
        if not len(rows):
            return None
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(MOST, len(rows))).round().astype(int))]
        rows = data.whole(rows)
        chosen = data.take(rows)
        reading, J = made.elsewhere(chosen)
        N = made.nuisance
        half = np.linalg.cholesky(N.T @ N + np.eye(N.shape[1]))
        K = np.linalg.solve(half, J.T)  # (n, m): V = I + KᵀK
        whitener = np.linalg.inv(np.linalg.cholesky(np.eye(len(J)) + K.T @ K))
        found = cls(chosen, reading, whitener, np.zeros(len(chosen), bool))
        size = found._per_row(found.residual(made.model))
        far = size > FAR * np.median(size)
        return cls(chosen, reading, whitener, far & (far.mean() <= max(GROSS, 1.0 / len(far))), made.tails)

    def residual(self, model: Model) -> np.ndarray:
        """(m,) residuals of a model in noise units before V; NaN where it does not reach the pose."""
        seen = linearisation.seen_from(model, self.data)
        return self.reading.whiten(linearisation.residuals(seen, self.data)[0])

    def _per_row(self, r: np.ndarray) -> np.ndarray:
        """(n,) RMS of each row's readings."""
        square = np.bincount(self.reading.row, np.nan_to_num(r) ** 2, len(self.data))
        return np.sqrt(square / np.maximum(np.bincount(self.reading.row, minlength=len(self.data)), 1))

    def _kept(self, r: np.ndarray) -> np.ndarray:
        return np.isfinite(r) & ~self.gross[self.reading.row]

    def times_noise(self, model: Model) -> float:
        """RMS of the readings in noise units, gross rows left out."""
        r = self.residual(model)
        return float(np.sqrt(np.mean(r[self._kept(r)] ** 2)))

    def score(self, model: Model) -> tuple[float, int, float]:
        """χ² of a model as it stands with the whole covariance, its readings, and by how much heavy tails widen its
        distribution."""
        r = self.residual(model)
        kept = self._kept(r)
        z = self.whitener @ np.where(kept, r, 0.0)
        if self.tails is not None:
            z = self.tails.clipped(z, (self.reading.component >= 3).astype(int))
        return float(z @ z), int(kept.sum()), tails_of(z[kept], int(kept.sum()), HEAVY)

    def change(self, before: Model, after: Model) -> Change:
        """What an explanation changes, both models refitted to the rows to fit.

        Rotations do not count where both levels take parallelograms as perfect: neither fit looked at them, and a small
        turn of the frame would change them by more than all else.
        """
        old, new = self.residual(before), self.residual(after)
        kept = self._kept(old) & self._kept(new)
        if all(m.robot.mechanism.levels[m.level].perfect for m in (before, after)):
            kept &= self.reading.component < 3
        a, b = (self.whitener @ np.where(kept, r, 0.0) for r in (old, new))
        rows = self.reading.row[kept]
        fell = a @ a >= b @ b
        t = self._errors(a - b, a) if fell else -self._errors(b - a, b)
        turned = self.reading.component >= 3
        return Change(
            before=float(a @ a), after=float(b @ b), readings=int(kept.sum()), rows=len(np.unique(rows)), t=t,
            by_rotations=bool(np.sum((a - b)[turned] ** 2) > np.sum((a - b)[~turned] ** 2)),
        )  # fmt: skip

    def compared(self, before: Model | None, after: Model | None) -> Change | None:
        """The change from one refitted model to another; None where either fit failed."""
        return None if before is None or after is None else self.change(before, after)

    def _errors(self, change: np.ndarray, r: np.ndarray) -> float:
        """By how many standard errors a change (m,) of the prediction agrees with residuals r (m,)."""
        product = change * r
        if not change.any():
            return 0.0
        each = np.bincount(self.reading.row, product, len(self.data))
        scatter = max(np.sqrt(len(each)) * np.std(each), 1e-12)
        return float(np.sum(product) / max(np.linalg.norm(change), scatter))


def refitted(model: Model, data: Measurements, added: Pairs) -> Model | None:
    """The model fitted to the data with hypotheses added that start at parameters θ (p,); None where that fails."""
    start, level = start_of(model, added)
    try:
        return identification.fit(data, start, level).model
    except (FitError, InputError):
        return None
