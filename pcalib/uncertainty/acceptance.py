"""Whether a compensated robot is as good as asked for: pass, fail, or cannot tell, after ISO 14253-1.

The measurand is the radius ρ that contains 95 % of the robot's misses. Rows that the model was not fitted to give the
miss e_i of each, model against measurement, with covariance N_i of the instrument's noise. With E = mean |e_i|² and
N = mean tr N_i the mean square of the true misses is E − N. E is known like a χ² variable with

    ν = 2·n·E²/var |e_i|²        degrees of freedom (Satterthwaite), n commands, at most three for each

and its confidence limits at the stated risk bound the radius: ρ ∝ √(E − N). The guard band is the distance of such a
limit from the estimate. The robot passes where the upper limit is within the tolerance, fails where the lower one is
beyond it, and is undecided in between. The radius follows from the shape of the misses' covariance, or from the 95 %
point of the measured misses, with the noise's own radius taken off, where that is larger: tails need not be normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcalib import prediction
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.fitting.linearisation import residuals, set_up_anew
from pcalib.model import Model
from pcalib.rotation import hat
from pcalib.uncertainty import radius
from pcalib.unexplained import TOOL_MARGIN

RISK = 0.05
"""Of accepting a robot that is not as good as asked for; the default of ISO 14253-1 for specification limits."""
COMMANDED = 0.02
"""RMS miss, as a share of the noise, below which positions are targets and no measurements: rounding leaves less."""
FEWEST = 8
"""Commands below which nothing is decided: with seven the scatter of the misses is known to a third."""
MOST = 2000
"""Commands beyond which more of them are no advice."""


class Decision(StrEnum):
    """Outcome of an acceptance test."""

    PASS = "pass"
    FAIL = "fail"
    CANNOT_TELL = "cannot_tell"


@dataclass(frozen=True, eq=False)
class Acceptance:
    """An acceptance test and its outcome."""

    decision: Decision
    within: float
    """[m] tolerance on the radius that contains 95 % of the misses."""
    risk: float
    estimate: float
    """[m] the radius, and"""
    low: float
    high: float
    """[m] its confidence limits, each at the stated risk."""
    noise: float
    """[m] radius that contains 95 % of the instrument's noise at this tool."""
    commands: int
    rows: int
    tool: np.ndarray
    """(3,) [m]."""
    turned: bool
    """Whether misses at the tool were computed from rotations, and not measured there."""
    enough: int | None
    """Commands, with this instrument, after which the test would be decided if the misses stay as they are; None where
    no number up to MOST does."""
    sigma: float | None
    """[m] 1σ per component of an instrument that would decide with as many commands; None where none would."""
    unfitted: bool
    """Whether the rows were held out from the fit; else nothing shows that they are new."""
    registered: bool = False
    """Whether the tracker was set up anew, and its frame found from these rows."""

    @property
    def guard(self) -> float:
        """[m] guard band: from the estimate to the upper confidence limit."""
        return self.high - self.estimate


@dataclass(frozen=True, eq=False)
class _Misses:
    """Mean square misses of n commands."""

    square: np.ndarray
    """(n,) [m²] mean of |e|² over the rows of a command."""
    noise: float
    """[m²] N."""
    shape: float
    """ρ/√(E − N), at least that of a normal deviate with the covariance of the misses."""

    def limits(
        self, risk: float, commands: int | None = None, noise: float | None = None
    ) -> tuple[float, float, float]:
        """Lower limit, estimate and upper limit [m] of ρ: for these commands, or for another number of similar ones.

        Args:
            noise: [m²] another N: misses and their scatter are then those that such an instrument would show.
        """
        from scipy.special import gammaincinv

        n = len(self.square) if commands is None else commands
        mean, variance = float(self.square.mean()), float(self.square.var(ddof=1))
        now = self.noise
        if noise is not None:
            real = max(mean - now, 0.0)
            variance *= ((real + noise) / mean) ** 2
            mean, now = real + noise, noise
        dof = min(2 * n * mean**2 / max(variance, 1e-300), 3.0 * n)
        # Misses below the noise are chance: the upper limit is then that of a robot without any.
        wide = max(mean, now) * dof / (2 * gammaincinv(dof / 2, risk))
        ends = (mean * dof / (2 * gammaincinv(dof / 2, 1 - risk)), mean, wide)
        low, middle, high = (self.shape * float(np.sqrt(max(end - now, 0.0))) for end in ends)
        return low, middle, high

    def decide(self, within: float, limits: tuple[float, float, float]) -> Decision:
        """The decision rule."""
        if limits[2] <= within:
            return Decision.PASS
        return Decision.FAIL if limits[0] > within else Decision.CANNOT_TELL


def accept(
    model: Model, data: Measurements, within: float, tool: np.ndarray | None = None, risk: float = RISK
) -> Acceptance:
    """Whether 95 % of the robot's landings lie within a tolerance.

    Args:
        data: rows that the model was not fitted to; where some are held out (set = check), only those count.
        within: [m].
        tool: (3,) [m] TCP; the measured points themselves when absent.
        risk: of either wrong decision.

    Raises:
        InputError: no row, or rows that say nothing about this tool.
    """
    held = bool(data.check.any())
    used = data.take(data.check) if held else data
    anew = set_up_anew(model, used)
    error, p = residuals(model if anew is None else anew, used)
    miss, noise, turned = _at_tool(error, p, used, tool)
    seen = np.asarray(np.isfinite(miss).all(axis=1))
    miss, noise, used = miss[seen], noise[seen], used.take(seen)
    free = [c for c in range(3) if c not in model.robot.mechanism.task]
    miss[:, free], noise[:, free], noise[:, :, free] = 0.0, 0.0, 0.0
    if len(miss) and np.mean(miss**2) < COMMANDED**2 * np.mean(np.trace(noise, axis1=1, axis2=2)) / 3:
        raise InputError(
            f"all positions are where the model says, within {100 * COMMANDED:.0f} % of the instrument's noise: these "
            "are targets or commands, and nothing in them was measured", file=data.source,
            remedy="write what the instrument read in place of x, y and z",
        )  # fmt: skip
    _, of = np.unique(np.round(np.column_stack([used.q, used.tool]), 9), axis=0, return_inverse=True)
    of = of.ravel()
    count = int(of.max(initial=-1)) + 1
    if count < FEWEST:
        raise InputError(
            f"{count} commands with a position at this tool decide nothing", file=data.source,
            remedy=f"measure at least {FEWEST} commands that the model was not fitted to",
        )
    each = np.bincount(of, np.sum(miss**2, axis=1)) / np.bincount(of)
    if anew is not None:  # the frame took six of the numbers
        each *= 3 * len(miss) / max(3 * len(miss) - 6, 1)
    mean_noise = float(np.mean(np.trace(noise, axis1=1, axis2=2)))
    left = miss.T @ miss / len(miss) - noise.mean(axis=0)
    values, axes = np.linalg.eigh(left)
    cleaned = (axes * np.maximum(values, 0.0)) @ axes.T
    if not np.trace(cleaned) > 0:
        cleaned = noise.mean(axis=0)
    noise_radius = radius.pooled(noise)
    shape = float(radius.containing(cleaned) / np.sqrt(np.trace(cleaned)))
    real = float(each.mean()) - mean_noise
    if real > 0:  # tails need not be normal
        far = float(np.quantile(np.sqrt(each), radius.COVERAGE)) ** 2 - noise_radius**2
        if far > 0 and real > mean_noise / np.sqrt(count):  # else chance alone makes the tail
            shape = max(shape, float(np.sqrt(far / real)))
    found = _Misses(each, mean_noise, shape)
    limits = found.limits(risk)
    decision = found.decide(within, limits)
    where = np.median(used.tool, axis=0) if tool is None else np.asarray(tool, float)
    return Acceptance(
        decision, within, risk, limits[1], limits[0], limits[2], noise_radius, count, len(miss), where, turned,
        _enough(found, within, risk) if decision is Decision.CANNOT_TELL else None,
        _instrument(found, within, risk) if decision is Decision.CANNOT_TELL else None, held, anew is not None,
    )  # fmt: skip


def _at_tool(
    error: np.ndarray, p: prediction.Prediction, data: Measurements, tool: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Misses (N, 3) [m] at the tool, NaN in rows that do not give them, covariances of their noise (N, 3, 3), and
    whether rotations were needed."""
    whole = data.covariance
    if whole is None:
        whole = data.sigma[:, :, None] ** 2 * np.eye(6)
    away = np.zeros((len(data), 3)) if tool is None else np.asarray(tool, float) - data.tool
    there = np.linalg.norm(away, axis=1) <= TOOL_MARGIN
    positions = ~np.isnan(error[:, :3]).any(axis=1)
    if (there & positions).any():
        miss = np.where(there[:, None], error[:, :3], np.nan)
        return miss, whole[:, :3, :3], False
    if not (positions & data.turned).any():
        raise InputError(
            "no row was measured with this tool, and none has a rotation from which its miss would follow",
            file=data.source, remedy="measure with this tool, or with an instrument that reads orientation as well",
        )
    # e at the tool = e of the point + ω × R·(t − t_measured)
    arm = (p.rotation @ away[..., None])[..., 0]
    carry = np.concatenate([np.broadcast_to(np.eye(3), (len(data), 3, 3)), -hat(arm)], axis=2)
    return (carry @ error[..., None])[..., 0], carry @ whole @ np.swapaxes(carry, 1, 2), True


def _enough(found: _Misses, within: float, risk: float) -> int | None:
    n = len(found.square)
    while n <= MOST:
        n = int(1.2 * n) + 1
        if found.decide(within, found.limits(risk, n)) is not Decision.CANNOT_TELL:
            return n
    return None


def _instrument(found: _Misses, within: float, risk: float) -> float | None:
    for sigma in np.sqrt(found.noise / 3) * np.array([0.7, 0.5, 0.3, 0.2, 0.1]):
        if found.decide(within, found.limits(risk, noise=3 * sigma**2)) is not Decision.CANNOT_TELL:
            return float(sigma)
    return None
