"""The whole diagnosis of a model on data: from residuals to a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.diagnosis import adequacy, plausibility, rounds
from pcalib.diagnosis.adequacy import AGAINST, SEARCH, Test
from pcalib.diagnosis.candidates import Candidate, Unavailable
from pcalib.diagnosis.held_out import HeldOut, refitted
from pcalib.diagnosis.hypothesis import Hypothesis, Kind
from pcalib.diagnosis.patterns import Cell, cells
from pcalib.diagnosis.problem import Problem, problem, spread, unknowns_for
from pcalib.diagnosis.screen import ALIAS, NUISANCE, Misfit, Screen, misfit, project_out, smallest_seen, span
from pcalib.diagnosis.verdict import (
    NEARLY,
    RARE,
    TRACE,
    AsGiven,
    Doubt,
    Explanation,
    Nearly,
    decide,
    refuted,
    shared,
)
from pcalib.effects.base import Effect
from pcalib.errors import FitError, InputError
from pcalib.fitting import identification, linearisation
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
CLEARLY = 6.0
"""Difference of BIC from which one explanation is clearly better than another ('strong' by Kass & Raftery 1995)."""
EARLY = 0.1
"""Share of the rows within which what begins to creep has crept from the start: a drift, and nothing that happened."""
LARGEST = 3
"""Effects at most that are named together where they explain nearly everything: one more than an explanation has."""
PARTS = 3
"""Parts of the robot that are named beside a geometry level; more of them say no more."""
BEYOND = 3.0
"""σ by which fitted parameters may lie beyond their physical range and still be possible."""


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


@dataclass(frozen=True)
class _World:
    """A model at one geometry level, ready to be tested."""

    prefix: tuple[str, ...]
    problem: Problem
    screen: Screen
    null: np.ndarray
    """(n,) smallest p of noise draws, ascending."""
    widened: Mapping[str, float]
    """Effect → factor by which what is plausible of it is widened."""

    def adequate(self, size: int, level: float) -> list[tuple[int, ...]]:
        """Sets of exactly `size` effects beside the geometry level, the simplest variant of each combination."""
        made, screen = self.problem, self.screen
        effects = [g for g, c in enumerate(made.candidates) if c.effect is not None]
        effects.sort(key=lambda g: len(made.candidates[g].scale))
        return adequacy.adequate_sets(
            screen, effects, size, level, adequacy.limit(self.null, level),
            names=[c.name for c in made.candidates], feasible=lambda chosen: possible(made, screen, chosen),
        )  # fmt: skip


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
    sets, events = _explanations(
        _World((), made, screen, null, widened or {}), data, own, levels, n_draws, seed, without
    )
    if [h.kind for e in sets for h in e.members] == [Kind.LEVEL]:
        sets = _beside_parts(sets[0], made, n_draws, seed, levels[1])
    held = HeldOut.of(made, data)
    given = replace(_as_given(made, screen, held), spent=spent)
    if sets and not sets[0].names and (made.outliers.too_many or given.against):
        sets = []  # what a refit leaves of the rows to fit may look like noise, but the rest does not
    sets = _doubted(sets, made, screen, held, data)
    nearly = None if sets or events else _nearly(_World((), made, screen, null, widened or {}), data, held)
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


def _nearly(world: _World, data: Measurements, held: HeldOut | None) -> Nearly | None:
    """The effects that take up nearly everything; None where they leave more, or where the rows are at fault."""
    made, screen = world.problem, world.screen
    if made.outliers.too_many:
        return None
    names = [c.name for c in made.candidates]
    effects = [g for g, c in enumerate(made.candidates) if c.effect is not None]
    feasible = lambda chosen: possible(made, screen, chosen)  # noqa: E731
    chosen = adequacy.nearest_set(screen, effects, LARGEST, names, feasible)
    if not chosen:
        return None
    Q = screen.joint(chosen)
    excess = float(screen.residual @ screen.residual) - screen.free
    taken = float(np.sum((Q.T @ screen.y) ** 2)) - Q.shape[1]
    if excess <= 0 or taken < NEARLY * excess:
        return None
    p = adequacy.p_values(screen, chosen).p
    first = len(made.candidates)
    where = int(np.argmin(p[first:])) if len(p) > first else None
    left = 0.0
    if where is not None:
        left = float(np.linalg.norm(screen.allowing(chosen)[first + where].T @ screen.y))
    best = _explanation(world, chosen)
    if best.implausible or left > TRACE:
        return None
    if held is not None:
        pairs = list(zip(best.members, best.theta, strict=True))
        before, after = refitted(made.model, data, []), refitted(made.model, data, pairs)
        best = replace(best, held_out=held.change(before, after) if before is not None and after is not None else None)
    return Nearly(best, min(taken / excess, 1.0), left, where)


def _beside_parts(best: Explanation, made: Problem, n_draws: int, seed: int, level: float) -> list[Explanation]:
    """The explanation by a geometry level, and the simplest parts of the robot beyond that level each of which explains
    as much: towers that lean and one rod that is too long tilt a plate alike."""
    mechanism = made.model.robot.mechanism
    named = np.hstack([mechanism.levels[name].basis for name in (made.model.level, *best.names)])
    known = span(named, ALIAS)
    parts = [Hypothesis.part(part, made.model) for part in mechanism.parts]
    beyond = [h for h in parts if np.linalg.norm(project_out(np.asarray(h.basis), known)) > ALIAS]
    if not beyond:
        return [best]
    wider = replace(made, candidates=(*made.candidates, *(Candidate.of(h, made.point) for h in beyond)))
    screen = wider.screen(n_draws, seed)
    world = _World((), wider, screen, adequacy.null_distribution(screen), {})
    reference, first = adequacy.limit(world.null, level), len(made.candidates)
    rivals: list[Explanation] = []
    spans: list[np.ndarray] = []
    for g in sorted(range(first, first + len(beyond)), key=lambda g: screen.visible[g]):
        block = screen.blocks[g]
        if any(s.shape == block.shape and np.linalg.norm(block - s @ (s.T @ block)) < 1e-2 for s in spans):
            continue  # the data see it as they see one that is listed
        if screen.visible[g] and adequacy.explains(screen, [g]) and adequacy.is_adequate(screen, [g], level, reference):
            spans.append(block)
            rivals.append(_explanation(world, (g,)))
    return [best, *sorted(rivals, key=lambda e: e.bic)[:PARTS]]


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
        pairs = list(zip(best.members, best.theta, strict=True))
        before, after = refitted(made.model, data, []), refitted(made.model, data, pairs)
        change = held.change(before, after) if before is not None and after is not None else None
        best = replace(best, held_out=change)
        if change is None or not change.confirmed:
            doubts.append(Doubt.UNCONFIRMED)
        elif len(pairs) > 1:
            best = replace(best, unconfirmed=_unconfirmed(pairs, after, made, held, data))
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
    pairs: Sequence[tuple[Hypothesis, np.ndarray]],
    after: Model | None,
    made: Problem,
    held: HeldOut,
    data: Measurements,
) -> tuple[str, ...]:
    """Members of an explanation that held-out rows do not ask for beside the others: `add` would say to drop them."""
    out = []
    for member, _ in pairs:
        without = refitted(made.model, data, [pair for pair in pairs if pair[0] is not member])
        change = held.change(without, after) if without is not None and after is not None else None
        if change is None or not change.confirmed:
            out.append(member.name)
    return tuple(sorted(set(out)))


def _slow_and_small(best: Explanation, made: Problem, screen: Screen) -> bool:
    """Whether an explanation only follows time or temperatures, and slow noise could have its size unseen."""
    slow = [any(need.startswith(("time", "temp")) for need in h.needs) for h in best.members]
    if not all(slow) or not memories.close(made.data):
        return False
    specs = [c.spec for c in made.candidates]
    chosen = [specs.index(spec) for spec in best.specs if spec in specs]
    return bool(chosen) and float(np.linalg.norm(screen.joint(chosen).T @ screen.y)) < SLOW


def _explanations(
    start: _World,
    data: Measurements,
    own: Sequence[Effect],
    levels: Sequence[float],
    n_draws: int,
    seed: int,
    without: Sequence[str] = (),
) -> tuple[list[Explanation], tuple[int, ...]]:
    """The smallest adequate sets over all geometry levels, one per combination of names, best first; and the
    patterns that are events which explain as much.

    Args:
        levels: at which data speak against a set, by its size from none on.
    """
    worlds, made = [start], start.problem
    for size, level in enumerate(levels):
        found: dict[tuple[str, ...], Explanation] = {}
        for world in worlds:
            room = size - len(world.prefix)
            if room < 0 or any(_simpler(names, world.prefix, made) for names in found):
                continue
            for chosen in world.adequate(room, level):
                explained = _explanation(world, chosen)
                found.setdefault(explained.names, explained)
        ordered = sorted(found.values(), key=lambda e: (bool(e.implausible), e.bic))
        events = _events(start, level) if size == 1 else []
        if events and not (ordered and ordered[0].bic < events[0].bic - CLEARLY):
            which = tuple(event.pattern for event in events)
            if not ordered or events[0].bic < ordered[0].bic - CLEARLY:
                return [], which
            return [replace(ordered[0], doubts=(Doubt.EVENT,)), *ordered[1:]], which
        if ordered:
            return ordered, ()
        if size == 0:  # something is missing: now it is worth the refits at richer levels
            worlds += _richer(start, data, own, n_draws, seed, without)
    return [], ()


@dataclass(frozen=True)
class _Event:
    pattern: int
    bic: float
    p: float
    """Of the pattern by itself. It orders events, because BIC would ask much more of the six numbers of a frame than of
    the one of a motor."""


def _events(world: _World, level: float) -> list[_Event]:
    """Steps and changes of slope that explain everything by themselves, best first."""
    made, screen, out = world.problem, world.screen, []
    reference, time = adequacy.limit(world.null, level), memories.time_of(made.data)
    for i, pattern in enumerate(made.patterns):
        g = len(made.candidates) + i
        if pattern.found is None or not screen.visible[g] or not adequacy.explains(screen, [g]):
            continue
        before = float(np.mean(time < time[pattern.found.row]))
        if pattern.found.shape == "slope" and before < EARLY:
            continue
        if adequacy.is_adequate(screen, [g], level, reference):
            # A place that was searched for costs as much as the tries it is the best of.
            cost = 2 * np.log(screen.trials[g]) + (screen.visible[g] + _columns(made)) * np.log(len(made.y))
            rest = float(screen.y @ screen.y - np.sum((screen.blocks[g].T @ screen.y) ** 2))
            p = float(adequacy.p_values(screen).p[g])
            out.append(_Event(i, rest + cost, p))
    return sorted(out, key=lambda event: event.p)


def _columns(made: Problem) -> int:
    return int(np.linalg.matrix_rank(made.nuisance, NUISANCE))


def possible(made: Problem, screen: Screen, chosen: Sequence[int]) -> bool:
    """Whether parameters within their physical ranges fit as well as any, give or take 3σ."""
    return not chosen or within_range(made, screen, chosen)[1] < BEYOND**2


def within_range(made: Problem, screen: Screen, chosen: Sequence[int]) -> tuple[list[np.ndarray], float]:
    """Least-squares parameters of a set within their physical ranges, and by how much χ² is above the unbounded one.

    Aliased effects share a signal in any proportion; what counts is whether some proportion is possible.
    """
    theta, _ = screen.estimate(chosen)
    low = np.concatenate([made.candidates[g].low for g in chosen])
    high = np.concatenate([made.candidates[g].high for g in chosen])
    free = np.concatenate(theta)
    if np.all((free >= low) & (free <= high)):
        return theta, 0.0
    from scipy.optimize import lsq_linear

    scale = np.concatenate([screen.scale[g] for g in chosen])
    F = np.hstack([screen.parts[g] for g in chosen]) * scale
    bounded = lsq_linear(F, screen.y, (low / scale, high / scale)).x
    rise = float(np.sum((screen.y - F @ bounded) ** 2) - np.sum((screen.y - F @ (free / scale)) ** 2))
    return np.split(bounded * scale, np.cumsum([len(t) for t in theta])[:-1]), rise


def _at_edge(made: Problem, chosen: Sequence[int], theta: Sequence[np.ndarray]) -> bool:
    """Whether a parameter lies at a bound of its physical range other than zero: an effect of size zero is none."""
    for g, values in zip(chosen, theta, strict=True):
        candidate = made.candidates[g]
        for bound in (candidate.low, candidate.high):
            near = np.abs(values - bound) <= 1e-3 * candidate.scale
            if np.any(near & (np.abs(bound) > 0.1 * candidate.scale)):
                return True
    return False


def _simpler(names: tuple[str, ...], prefix: tuple[str, ...], made: Problem) -> bool:
    """Whether what was found already does with a level below the one of `prefix`, which then does nothing more."""
    levels = made.model.robot.mechanism.levels
    mine = [levels[n].basis.shape[1] for n in names if n in levels]
    return bool(mine and prefix) and mine[0] < levels[prefix[0]].basis.shape[1]


def _richer(
    start: _World,
    data: Measurements,
    own: Sequence[Effect],
    n_draws: int,
    seed: int,
    without: Sequence[str],
) -> list[_World]:
    """The same data at every richer geometry level, refitted: large errors are not linear."""
    out, made = [], start.problem
    for candidate in made.candidates:
        if candidate.effect is not None:
            continue
        try:
            fitted = identification.fit(data, replace(made.model, history=()), candidate.name).model
        except (FitError, InputError):
            continue
        known = made.noise if made.noise.source == "replicates" else None
        rebuilt = problem(fitted, data, own, known, without=without)
        screen = rebuilt.screen(n_draws, seed)
        null = adequacy.null_distribution(screen)
        out.append(_World((candidate.name,), rebuilt, screen, null, start.widened))
    return out


def _explanation(world: _World, chosen: tuple[int, ...]) -> Explanation:
    made, screen = world.problem, world.screen
    theta, sigma = (within_range(made, screen, chosen)[0], screen.estimate(chosen)[1]) if chosen else ([], [])
    members = [Hypothesis.level(name, made.model) for name in world.prefix]
    values, spread = ([np.zeros(0)] * len(members) + each for each in (theta, sigma))
    members += [made.candidates[g].hypothesis for g in chosen]
    order = sorted(range(len(members)), key=lambda i: members[i].name)
    edge = bool(chosen) and _at_edge(made, chosen, theta)
    rest = screen.y @ screen.y
    if chosen:
        Q = screen.joint(chosen)
        rest = rest - np.sum((Q.T @ screen.y) ** 2)
    columns = sum(len(made.candidates[g].scale) for g in chosen) + _columns(made)
    parts = tuple(members[i] for i in order)
    theta, sigma = (tuple(each[i] for i in order) for each in (values, spread))
    return Explanation(
        members=parts,
        theta=theta,
        sigma=sigma,
        bic=float(rest + columns * np.log(len(made.y))),
        at_edge=edge,
        implausible=plausibility.judge(parts, theta, sigma, world.widened),
    )


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
