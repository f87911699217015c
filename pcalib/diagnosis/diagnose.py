"""The whole diagnosis of a model on data: from residuals to a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.diagnosis import adequacy, rounds
from pcalib.diagnosis.adequacy import AGAINST, SEARCH, Test
from pcalib.diagnosis.candidates import Candidate, Unavailable
from pcalib.diagnosis.explanations import (
    World,
    beside_parts,
    explanations,
    nearly_all,
    possible,
    shown_by_held_out,
)
from pcalib.diagnosis.held_out import HeldOut, refitted
from pcalib.diagnosis.hypothesis import Kind
from pcalib.diagnosis.patterns import Cell, cells
from pcalib.diagnosis.problem import Problem, problem, spread, unknowns_for
from pcalib.diagnosis.screen import NUISANCE, Misfit, Screen, misfit, smallest_seen, span
from pcalib.diagnosis.verdict import (
    RARE,
    AsGiven,
    Doubt,
    Explanation,
    Nearly,
    decide,
    refuted,
    shared,
)
from pcalib.effects.base import Effect
from pcalib.errors import InputError
from pcalib.fitting import linearisation
from pcalib.fitting import memory as memories
from pcalib.fitting import noise_level as noises
from pcalib.fitting.noise_level import NoiseLevel
from pcalib.model import Model
from pcalib.shown import Shown

N_DRAWS = 4096
FEWEST_LEFT = 10
"""Degrees of freedom that the fit must leave for anything to be established: with nine the scale of the residuals is
known to a quarter, and a wrong effect of four parameters takes nearly half of them."""
SLOW = 12.0
"""s up to which slow noise may pass for an effect of time or temperature: with half of the variance correlated over six
rows, and replicates back to back, thermal effects reached 9 noise units by chance."""


class Why(StrEnum):
    """Why a candidate cannot be what is missing."""

    UNSEEN = "these poses cannot show it"
    IMPOSSIBLE = "it would have to be outside its physical range"


@dataclass(frozen=True)
class Finding:
    """What the data say about one candidate on its own."""

    candidate: Candidate
    kappa: float
    """Visible share of its signal after the geometry is projected out."""
    s: float
    """Norm of what is visible at the fitted size, noise units."""
    p: float
    """Corrected for everything that was looked at."""
    theta: np.ndarray
    sigma: np.ndarray
    """(np,) [SI] fitted on its own, and 1σ."""
    adequate: bool
    """It stands in a smallest adequate set."""
    smallest_seen: np.ndarray
    """(np,) [SI] size that would have been found with 90 % power."""
    why: Why | None = None
    """Why it cannot be what is missing, where that is clear."""


@dataclass(frozen=True)
class Diagnosis(Shown):
    """What is missing from a model, as far as the data can tell."""

    verdict: str
    established: tuple[str, ...]
    sets: tuple[Explanation, ...]
    """The smallest adequate sets, by BIC; one empty set where nothing is missing."""
    refuted: tuple[str, ...]
    findings: tuple[Finding, ...]
    """Every candidate, hottest first."""
    cells: tuple[Cell, ...]
    """Hottest first."""
    unavailable: tuple[Unavailable, ...]
    noise: NoiseLevel
    misfit: Misfit
    problem: Problem
    given: AsGiven
    """The model as it stands, without a refit."""
    checked: Measurements | None
    """Held-out rows that were used; None where there are none."""
    events: tuple[Cell, ...]
    """Steps and changes of slope each of which explains as much as the sets do, or everything where there are none."""
    critical: float
    """Single p below which something counts as found, all that was looked at considered."""
    nearly: Nearly | None = None
    """Effects that take up nearly everything, where nothing explains all."""
    round: int = 1
    """Number of the round of measuring and diagnosing: later ones ask for more."""


def diagnose(
    model: Model,
    data: Measurements,
    own: Sequence[Effect] = (),
    largest: int = 2,
    alpha: float = SEARCH,
    n_draws: int = N_DRAWS,
    seed: int = 0,
    without: Sequence[str] = (),
    against: tuple[float, float] = AGAINST,
    widened: Mapping[str, float] | None = None,
) -> Diagnosis:
    """Which effect is missing from a model.

    Args:
        own: the user's own effects, beside those of the library.
        largest: most effects in one explanation.
        alpha: false alarms allowed for in a first round, over everything that is looked at.
        n_draws: Monte-Carlo draws of pure noise.
        without: names of effects that are not considered, because they are known not to be there.
        against: share of true explanations that may be dropped, single ones and larger ones.
        widened: effect → factor by which the range of its plausible sizes is widened, for robots known to be odd.

    Raises:
        InputError: too few readings to say anything.
    """
    made = problem(model, data, own, without=without)
    poses = len(np.unique(np.round(made.data.q, 9), axis=0))
    if len(made.y) * poses / len(made.data) <= made.nuisance.shape[1] // 2:
        few = "1 pose leaves" if poses == 1 else f"{poses} poses leave"
        raise InputError(
            f"{few} nothing to judge a model of level {model.level} by",
            file=data.source,
            remedy="measure more poses; three times as many as the fit needs is usual",
        )
    spent = rounds.share(data.rounds)
    alpha *= spent
    screen = made.screen(n_draws, seed)
    start = adequacy.p_values(screen)
    null = adequacy.null_distribution(screen)
    critical = adequacy.limit(null, alpha)
    levels = (alpha, against[0], *[against[1]] * (largest - 1))[: largest + 1]
    world = World((), made, screen, null, widened or {})
    sets, events = explanations(world, data, own, levels, n_draws, seed, without)
    if [h.kind for e in sets for h in e.members] == [Kind.LEVEL]:
        sets = beside_parts(sets[0], made, n_draws, seed, levels[1])
    held = HeldOut.of(made, data)
    given = replace(_as_given(made, screen, held), spent=spent)
    if sets and not sets[0].names:
        if made.outliers.too_many or given.against:
            sets = []  # what a refit leaves of the rows to fit may look like noise, but the rest does not
        elif held is not None:
            sets = shown_by_held_out(world, data, held, levels[1], RARE * spent) or sets
    sets = _doubted(sets, made, screen, held, data)
    nearly = None if sets or events else nearly_all(world, data, held)
    hot = cells(made.patterns, len(made.candidates), screen, start.p, null)
    verdict, established = decide(sets)
    findings = _findings(made, screen, start, null, sets, critical)
    tested = [f.candidate.name for f in findings if f.why is None and f.candidate.effect is not None]
    return Diagnosis(
        verdict=verdict,
        established=established,
        sets=tuple(sets),
        refuted=refuted(tested, sets),
        findings=findings,
        cells=hot,
        unavailable=made.unavailable,
        noise=made.noise,
        misfit=misfit(screen),
        problem=made,
        given=given,
        checked=held.data if held else None,
        events=tuple(c for i in events for c in hot if c.found is made.patterns[i].found),
        critical=critical,
        nearly=nearly,
        round=data.rounds,
    )


def _refit_p(made: Problem, screen: Screen, y: np.ndarray, nuisance: np.ndarray) -> float:
    """Probability that noise alone lets χ² of residuals y (M,) fall as far as a refit of what the model has does."""
    U = span(nuisance, NUISANCE)
    if not U.shape[1]:
        return 1.0
    inside = U.T @ y
    # Where a refit leaves more than noise, the weights of its rows decide where it ends: by as much as it leaves.
    left = max(float(y @ y - inside @ inside) / max(screen.free, 1), 1.0)
    # χ² of heavy tails scatters like a multiple of one with fewer degrees of freedom (Box 1953).
    times = 1.0 if made.tails is None else made.tails.widened
    return float(screen.p_value(float(inside @ inside) / left / times, U.shape[1] / times))


def _as_given(made: Problem, screen: Screen, held: HeldOut | None) -> AsGiven:
    refit_p = _refit_p(made, screen, made.y, made.nuisance)
    if refit_p < RARE:
        # A fit weighs as the file states. It is stale where a refit with these weights would move it too.
        unknowns = unknowns_for(made.model, made.data)
        linear = linearisation.linearise(made.model, made.data, unknowns)
        nuisance = linear.jacobian * unknowns.scale * spread(made.model, unknowns)
        refit_p = max(refit_p, _refit_p(made, screen, linear.residual, nuisance))
    out = AsGiven(fit=float(np.sqrt(np.mean(made.y**2))), refit_p=refit_p)
    if made.noise.source == "residuals" and all(made.data.stated):
        stated = noises.as_stated(made.data)
        times = [a / b for a, b in zip(made.noise.total, stated.total, strict=True) if np.isfinite(a)]
        out = replace(out, stated=max(times))
    if held is None:
        return out
    chi2, readings, tails = held.score(made.model)
    p = float(screen.p_value(chi2 / tails, readings / tails)) if readings else 1.0
    return replace(out, check=held.times_noise(made.model), check_p=p)


def _doubted(
    sets: list[Explanation], made: Problem, screen: Screen, held: HeldOut | None, data: Measurements
) -> list[Explanation]:
    """The explanations with what held-out rows say of the best one, and with what keeps it from being established."""
    if not sets or not shared(sets):
        return sets
    best, doubts = sets[0], list(sets[0].doubts)
    if held is None:
        doubts.append(Doubt.NOTHING_HELD_OUT)
    else:
        before, after = refitted(made.model, data, []), refitted(made.model, data, best.pairs)
        change = held.compared(before, after)
        best = replace(best, held_out=change)
        if change is None or not change.confirmed:
            doubts.append(Doubt.UNCONFIRMED)
        elif len(best.members) > 1:
            best = replace(best, unconfirmed=_unconfirmed(best, after, made, held, data))
            if set(best.unconfirmed) >= set(shared(sets)):
                doubts.append(Doubt.UNCONFIRMED)
    if made.noise.memory is not None:
        doubts.append(Doubt.CORRELATED)
    if _slow_and_small(best, made, screen):
        doubts.append(Doubt.CLOSE)
    if screen.free < FEWEST_LEFT:
        doubts.append(Doubt.FEW)
    if best.at_edge:
        doubts.append(Doubt.EDGE)
    return [replace(best, doubts=tuple(doubts)), *sets[1:]]


def _unconfirmed(
    best: Explanation, after: Model | None, made: Problem, held: HeldOut, data: Measurements
) -> tuple[str, ...]:
    """Members of an explanation that held-out rows do not confirm beside the others: `add` would advise to drop them.

    Args:
        after: the model refitted with all members.
    """
    out = []
    for member in best.members:
        without = [pair for pair in best.pairs if pair[0] is not member]
        change = held.compared(refitted(made.model, data, without), after)
        if change is None or not change.confirmed:
            out.append(member.name)
    return tuple(sorted(set(out)))


def _slow_and_small(best: Explanation, made: Problem, screen: Screen) -> bool:
    """Whether an explanation only follows time or temperatures, and slow noise of that size would not be noticed."""
    slow = [any(need.startswith(("time", "temp")) for need in h.needs) for h in best.members]
    if not all(slow) or not memories.close(made.data):
        return False
    specs = [c.spec for c in made.candidates]
    chosen = [specs.index(spec) for spec in best.specs if spec in specs]
    return bool(chosen) and float(np.linalg.norm(screen.joint(chosen).T @ screen.y)) < SLOW


def _findings(
    made: Problem, screen: Screen, start: Test, null: np.ndarray, sets: Sequence[Explanation], critical: float
) -> tuple[Finding, ...]:
    inside = {name for e in sets for name in e.names}
    out = []
    for g, candidate in enumerate(made.candidates):
        d = int(screen.visible[g])
        theta, sigma = (a[0] for a in screen.estimate([g]))
        why = Why.UNSEEN if d == 0 else None if possible(made, screen, [g]) else Why.IMPOSSIBLE
        out.append(
            Finding(
                candidate=candidate,
                kappa=screen.kappa(g),
                s=float(np.linalg.norm(screen.blocks[g].T @ screen.y)) if d else 0.0,
                p=float(adequacy.corrected(start.p[g], null)) if d else 1.0,
                theta=theta,
                sigma=sigma,
                adequate=candidate.name in inside,
                smallest_seen=smallest_seen(screen, g, critical),
                why=why,
            )
        )
    return tuple(sorted(out, key=lambda f: (f.p, -f.s)))
