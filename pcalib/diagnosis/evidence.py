"""The evidence for and against one candidate, whatever the verdict says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.diagnosis import adequacy
from pcalib.diagnosis.adequacy import Test
from pcalib.diagnosis.candidates import Candidate, shown_by
from pcalib.diagnosis.diagnose import Diagnosis, Finding, diagnose
from pcalib.diagnosis.explanations import possible
from pcalib.diagnosis.held_out import Change, HeldOut
from pcalib.diagnosis.hypothesis import resolve, start_of
from pcalib.diagnosis.scatters import apparent, axis_of, values_of
from pcalib.diagnosis.screen import Screen
from pcalib.effects.base import Effect
from pcalib.errors import EffectError, FitError, InputError
from pcalib.fitting import identification
from pcalib.fitting.identification import Fit
from pcalib.model import Model

TIED = 1e-12
"""p below which everything is equally sure, and p no longer orders."""


@dataclass(frozen=True)
class AddedVariable:
    """The added-variable plot: what is left of the readings against what is left of the effect's prediction.

    Both have lost what the geometry can take up; points about a line of slope 1 speak for the effect.
    """

    predicted: np.ndarray
    """(M,) noise units, at the fitted size."""
    residual: np.ndarray
    """(M,) noise units."""
    slope: float
    """1 by construction of the fit; ± σ below."""
    sigma: float


@dataclass(frozen=True)
class ByVariable:
    """Component-plus-residual against the variable that tells most, one series per arm or rod."""

    variable: str
    channel: str
    x: np.ndarray
    """(n,) [SI], the variable."""
    y: np.ndarray
    """(n,) [SI of the channel] apparent deviation."""
    series: np.ndarray
    """(n,) int, arm or rod."""
    names: tuple[str, ...]
    curve: np.ndarray
    """(n,) [SI] what the fitted effect adds there."""
    sliding: bool = False
    """Whether actuator values are lengths."""

    @property
    def axis(self) -> tuple[float, str]:
        """Factor from SI, and the variable with its unit as people write it."""
        return axis_of(self.variable, self.sliding)


@dataclass(frozen=True)
class Evidence:
    """What the data say for and against one candidate."""

    candidate: Candidate
    finding: Finding
    diagnosis: Diagnosis
    before: Fit | None
    after: Fit | None
    """Full non-linear fits without and with it; None where a fit failed."""
    held_out: Change | None
    """What held-out rows say of it; None where none are held out, or where a fit failed."""
    rest_p: float
    """Corrected p of the hottest thing with the candidate in place: small means it is not enough."""
    rest: str
    """What that hottest thing is."""
    rivals: tuple[str, ...]
    """Other explanations that the data cannot rule out."""
    in_range: bool
    """Fitted parameters are physically possible."""
    plot: AddedVariable | None
    by_variable: ByVariable | None


def evidence(model: Model, data: Measurements, spec: str, own: Sequence[Effect] = ()) -> Evidence:
    """Everything the data say about one candidate.

    Args:
        spec: an effect as the command line names it; a bare name takes the variant that the data speak for most.
        own: the user's own effects, `spec` among them if it is one.

    Raises:
        EffectError: no such candidate on these data; the message says why.
    """
    found = diagnose(model, data, own)
    finding = _finding(found, spec, own)
    made, g = found.problem, found.problem.candidates.index(finding.candidate)
    screen = made.screen()
    null = adequacy.null_distribution(screen, (g,))
    rest = adequacy.p_values(screen, (g,))
    hottest = "what no group holds" if rest.hottest < 0 else screen.names[_hottest(found, screen, rest)]
    candidate = finding.candidate
    before, after = _fits(model, data, finding)
    held = HeldOut.of(made, data)
    change = held.change(before.candidate, after.candidate) if held and before and after else None
    return Evidence(
        candidate=candidate,
        finding=finding,
        diagnosis=found,
        before=before,
        after=after,
        held_out=change,
        rest_p=float(adequacy.corrected(rest.smallest, null)),
        rest=hottest,
        rivals=tuple("+".join(e.names) for e in found.sets if e.names and candidate.name not in e.names),
        in_range=possible(made, screen, (g,)),
        plot=_added_variable(screen, g, finding),
        by_variable=_by_variable(found, screen, g, finding, after, data),
    )


def _hottest(found: Diagnosis, screen: Screen, rest: Test) -> int:
    """Group of the smallest p; of those too small to be told apart a level first, then the largest per column."""
    if rest.smallest > TIED:
        return rest.hottest
    blocks, candidates = screen.allowing(rest.chosen), found.problem.candidates
    tied = [int(g) for g in np.flatnonzero(rest.p <= TIED) if blocks[g].shape[1]]
    levels = [g for g in tied if g < len(candidates) and candidates[g].effect is None]
    return max(levels or tied, key=lambda g: float(np.mean((screen.y @ blocks[g]) ** 2)))


def _finding(found: Diagnosis, spec: str, own: Sequence[Effect]) -> Finding:
    wanted = resolve(spec, found.problem.model, own)
    mine = [f for f in found.findings if f.candidate.name == wanted.name]
    for finding in mine:
        if finding.candidate.spec == spec:
            return finding
    if mine:  # findings come hottest first; the simplest of those about as hot
        return min(mine, key=lambda f: (f.p > 4 * mine[0].p, len(f.candidate.scale)))
    why = next((u.why for u in found.unavailable if u.name == wanted.name), "it was not considered")
    raise EffectError(f"effect {wanted.name} cannot be judged on these data: {why}\n  {shown_by(wanted.effect)}")


def _fits(model: Model, data: Measurements, finding: Finding) -> tuple[Fit | None, Fit | None]:
    candidate = finding.candidate
    out: list[Fit | None] = []
    for adding in (False, True):
        theta = np.clip(finding.theta, candidate.low, candidate.high)
        start, level = start_of(model, [(candidate.hypothesis, theta)] if adding else [])
        try:
            fitted = identification.fit(data, start, level)
            out.append(fitted if fitted.status == "converged" else None)
        except (FitError, InputError):
            out.append(None)
    return out[0], out[1]


def _added_variable(screen: Screen, g: int, finding: Finding) -> AddedVariable | None:
    predicted = screen.parts[g] @ finding.theta
    size2 = float(predicted @ predicted)
    if size2 <= 0:
        return None
    slope = float(predicted @ screen.y / size2)
    return AddedVariable(screen.basis @ predicted, screen.residual, slope, float(1 / np.sqrt(size2)))


def by_variable_of(found: Diagnosis, data: Measurements) -> ByVariable | None:
    """Component-plus-residual plot of the most significant effect in drives or rods, the best explanation first."""
    inside = {spec for e in found.sets[:1] for spec in e.specs}
    ranked = sorted(found.findings, key=lambda f: (f.candidate.spec not in inside, f.p, -f.s))
    for finding in ranked[:3]:
        effect = finding.candidate.effect
        if effect is not None and effect.channels and effect.channels[0] in ("actuator", "rod"):
            made = found.problem
            screen = made.screen(2)
            after = _fits(made.model, data, finding)[1]
            return _by_variable(found, screen, made.candidates.index(finding.candidate), finding, after, data)
    return None


def _by_variable(
    found: Diagnosis, screen: Screen, g: int, finding: Finding, after: Fit | None, data: Measurements
) -> ByVariable | None:
    """Component plus residual of an effect in the actuators or rods; None where it acts elsewhere."""
    effect, made = finding.candidate.effect, found.problem
    if effect is None or after is None or not effect.channels or effect.channels[0] not in ("actuator", "rod"):
        return None
    channel = effect.channels[0]
    variable = _telling(found, screen, g, finding, channel)
    at = made.point.situation
    x = values_of(at, variable, channel)
    if x is None:
        return None
    theta = next(f.theta for f in after.candidate.effects if f.effect.name == effect.name)
    component = effect.contribution(at, theta)[channel]
    kept = np.delete(made.rows, made.set_aside)
    error = after.error[kept]
    off = apparent(made, error, channel)
    if off is None:
        return None
    y, full = off
    names = made.model.robot.mechanism.actuators if channel == "actuator" else made.model.robot.mechanism.rods
    n = len(names)
    return ByVariable(
        variable=variable,
        channel=channel,
        x=x[full].ravel(),
        y=(component[full] + y).ravel(),
        series=np.tile(np.arange(n), int(full.sum())),
        names=tuple(names),
        curve=component[full].ravel(),
        sliding=made.model.robot.mechanism.actuator_dimension == "length",
    )


def _telling(found: Diagnosis, screen: Screen, g: int, finding: Finding, channel: str) -> str:
    """The variable whose smooth pattern in that channel resembles the effect most, the simplest first."""
    made = found.problem
    signal = screen.parts[g] @ finding.theta
    best, score = "q" if channel == "actuator" else "tension", -np.inf
    for i, pattern in enumerate(made.patterns):
        block = screen.blocks[len(made.candidates) + i]
        if pattern.channel != channel or not block.shape[1]:
            continue
        alike = float(np.sum((block.T @ signal) ** 2) / max(signal @ signal, 1e-300)) - 0.01 * block.shape[1]
        if alike > score:
            best, score = pattern.variable, alike
    return best
