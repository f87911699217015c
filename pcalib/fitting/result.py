"""What a fit found: the model, how far it is from the measurements, and how much of it the data support."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from pcalib import wording
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.errors import FitError
from pcalib.fitting.far import FAR, Far, far
from pcalib.fitting.identifiability import Identifiability
from pcalib.fitting.scatter import Scale
from pcalib.fitting.unknowns import Unknowns, current
from pcalib.mechanics.mechanism import Level
from pcalib.model import Model
from pcalib.posterior import Posterior
from pcalib.shown import Shown

_OVERSTATED = 0.5
"""χ² per degree of freedom below which σ is doubted."""


class Code(Enum):
    """Kinds of warnings of a fit, for programs."""

    ROTATIONS_LEFT_OUT = "rotations_left_out"
    FEW_DIRECTIONS = "few_directions"
    PRIORS_WIDENED = "priors_widened"
    TILT_UNSEEN = "tilt_unseen"
    EFFECT_UNPHYSICAL = "effect_unphysical"
    LITTLE_WEIGHT = "little_weight"
    FAR_ROWS = "far_rows"
    FAR_HELD_OUT = "far_held_out"
    UNSETTLED = "unsettled"
    OTHER_ROBOT = "other_robot"
    OUT_OF_REACH = "out_of_reach"
    AT_BOUND = "at_bound"
    HELD_BY_PRIOR = "held_by_prior"
    NEVER_MOVED = "never_moved"
    SIGMA_TOO_LARGE = "sigma_too_large"
    SIGMA_TOO_SMALL = "sigma_too_small"
    SIGMA_UNEVEN = "sigma_uneven"
    FAR_FROM_DRAWING = "far_from_drawing"
    TARGET_AWAY = "target_away"


@dataclass(frozen=True)
class Caution:
    """A warning of a fit: a code that programs compare, and a text for people."""

    code: Code
    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Accuracy:
    """How far model and measurements are apart on some rows."""

    rms_pos: float
    """[m] sqrt(mean |e|²) over the rows with a position."""
    max_pos: float
    """[m] the largest |e|."""
    rms_rot: float
    """[rad] sqrt(mean |e|²) over the rows with a rotation; NaN without rotations."""
    chi2_dof: float
    """χ² per degree of freedom of the readings that the level can explain; NaN without degrees of freedom."""
    dof: float
    """Degrees of freedom: readings less the parameters that the data determine."""
    n_rows: int

    @property
    def at_the_noise(self) -> bool:
        """Whether such residuals are what noise of the given σ leaves: within 3 of its σ, or 5 %."""
        return bool(np.sqrt(self.chi2_dof) < 1 + max(3 / np.sqrt(2 * max(self.dof, 1)), 0.05))


    @property
    def more_than_chance(self) -> bool:
        """Whether χ² exceeds what noise of the given σ leaves in 19 of 20 fits (one-sided, p < 0.05)."""
        return bool((np.sqrt(self.chi2_dof) - 1) * np.sqrt(2 * max(self.dof, 1)) > 1.645)


def accuracy(error: np.ndarray, noise: Noise, parameters: float) -> Accuracy:
    """RMS and maximum of residuals (N, 6) [m, rad], and χ² per degree of freedom of those that `noise` covers."""
    some = ~np.isnan(error[:, :3]).all(axis=1)
    length2 = np.nansum(error[some, :3] ** 2, axis=1)
    turned = ~np.isnan(error[:, 3:]).all(axis=1)
    angle2 = np.nansum(error[turned, 3:] ** 2, axis=1)
    counted = replace(noise, measured=noise.measured & ~np.isnan(error))
    chi2 = float(np.sum(counted.whiten(error) ** 2))
    dof = int(counted.measured.sum()) - parameters
    return Accuracy(
        rms_pos=float(np.sqrt(length2.mean())) if len(length2) else float("nan"),
        max_pos=float(np.sqrt(length2.max())) if len(length2) else float("nan"),
        rms_rot=float(np.sqrt(angle2.mean())) if len(angle2) else float("nan"),
        chi2_dof=chi2 / dof if dof > 0 else float("nan"),
        dof=dof,
        n_rows=int((~np.isnan(error).all(axis=1)).sum()),
    )


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Shown):
    """The outcome of an identification. `model` refuses where the fit cannot be trusted."""

    candidate: Model
    """The fitted model, whatever the status: for inspection only."""
    status: str
    """'converged', 'not_converged' or 'rank_deficient'."""
    reason: str
    """Why a status other than converged."""
    remedy: str
    """Suggested remedy; empty if the fit converged."""
    data: Measurements
    """All rows, those held out included."""
    noise: Noise
    """Noise that the fit counted with, of all rows; `measured` holds the readings that the level can explain."""
    unknowns: Unknowns
    covariance: np.ndarray
    """(n, n) posterior covariance of the unknowns [SI], under the noise that the data support."""
    scale: Scale
    """Noise that the data support, over that of the weights; `covariance` is scaled by it."""
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad], NaN where not measured, of all rows."""
    weight: np.ndarray
    """(N,) robust weights; 1 with linear loss and on rows held out."""
    accuracy: Accuracy
    """Figures of the fitted rows."""
    check: Accuracy | None
    """Figures of the rows held out; None where there are none."""
    identifiability: Identifiability
    expected: int
    """Directions that well-spread poses with the same kind of readings would identify at this level."""
    prior_scale: float
    """Factor by which the manufacturing priors were widened, as the data ask."""
    iterations: int
    posterior_of: Callable[[Model], Posterior]
    """Gives the posterior that a fitted model keeps; it takes longer than the fit, and not every fit is kept."""
    warnings: tuple[Caution, ...] = ()

    def __repr__(self) -> str:
        a = self.accuracy
        return (
            f"<Fit {self.candidate.level} {self.status}: {self.n_identified} of {self.expected} directions, "
            f"{wording.size(a.rms_pos)} RMS on {a.n_rows} rows, χ²/dof {a.chi2_dof:.3g}>"
        )

    @cached_property
    def model(self) -> Model:
        """The fitted model.

        Raises:
            FitError: the fit did not converge or the data cannot support the level.
        """
        if self.status != "converged":
            status = self.status.replace("_", " ")
            raise FitError(f"{self.data.source}: the fit is not usable ({status}): {self.reason}\n  {self.remedy}")
        return replace(self.candidate, posterior=self.posterior_of(self.candidate))

    @property
    def method(self) -> str:
        """'map', 'base' or 'linear'."""
        return self.candidate.options.method

    @property
    def n_identified(self) -> int:
        """Directions with prior σ / posterior σ above the threshold."""
        return self.identifiability.n_identified

    @cached_property
    def estimate(self) -> np.ndarray:
        """(n,) values of the unknowns: change from nominal, effect values, target offset."""
        return current(self.candidate, self.unknowns)

    @cached_property
    def far(self) -> tuple[Far, ...]:
        """Values many manufacturing tolerances from the drawing, the farthest first."""
        g = self.unknowns.n_geometry
        if not (np.abs(self.estimate[:g]) > FAR / 3 * self.unknowns.scale[:g]).any():
            return ()  # a number of three components or fewer has one beyond that
        return far(self.candidate, self.unknowns, self.covariance)

    @cached_property
    def left_out(self) -> float:
        """RMS, in σ, of fitted rotations that the level cannot explain and that do not count; NaN without any."""
        beside = (self.data.mask & ~self.noise.measured)[~self.data.check]
        off = (self.error / self.data.sigma)[~self.data.check][beside]
        return float(np.sqrt(np.mean(off**2))) if len(off) else float("nan")

    def headline(self) -> str:
        """The outcome in one sentence."""
        a = self.accuracy
        text = f"Level {self.candidate.level} explains {a.n_rows} poses to {wording.size(a.rms_pos)} RMS"
        notes = [_noise(a, "stated" if self.data.sigma_stated else "assumed")] if np.isfinite(a.chi2_dof) else []
        if np.isfinite(self.left_out):
            off = f"{wording.deviation(a.rms_rot, 'rad')} RMS, {self.left_out:.1f}× their σ"
            notes.append(f"rotations left out: {off}")
        if notes:
            text += f" ({'; '.join(notes)})"
        if self.check:
            text += f"; {self.check.n_rows} held-out poses: {wording.size(self.check.rms_pos)}"
        return text + "."

    def summary(self) -> str:
        """The headline, and one line for every warning."""
        return "\n".join([self.headline(), *(f"- {caution}" for caution in self.warnings)])


def explained(data: Measurements, level: Level) -> np.ndarray:
    """(N, 6) bool, readings that the level can explain: no rotations where parallelograms are taken as perfect."""
    if not level.perfect or not data.mask[:, 3:].any() or not data.mask[:, :3].any():
        return data.mask
    return data.mask & ([True] * 3 + [False] * 3)


def _noise(a: Accuracy, said: str) -> str:
    """How χ² per degree of freedom compares with the σ that is 'stated' or 'assumed'."""
    if a.chi2_dof < _OVERSTATED:
        return f"far below the {said} noise: σ overstated?"
    if not a.at_the_noise:
        ratio = np.sqrt(a.chi2_dof)
        return f"{ratio:.2g}× the {said} noise" if ratio < 10 else f"{ratio:.0f}× the {said} noise"
    return "at the noise" if said == "stated" else "at the assumed noise"
