"""The sets of effects that explain what is missing, over all geometry levels.

Levels beyond the model's are refitted before anything is asked there: large errors are not linear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.diagnosis import adequacy, plausibility
from pcalib.diagnosis.candidates import Candidate
from pcalib.diagnosis.held_out import HeldOut, refitted
from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.diagnosis.problem import Problem, problem
from pcalib.diagnosis.screen import ALIAS, NUISANCE, Screen, project_out, span
from pcalib.diagnosis.verdict import LOUD, NEARLY, TRACE, Doubt, Explanation, Nearly
from pcalib.effects.base import Effect
from pcalib.errors import FitError, InputError
from pcalib.fitting import identification, least_squares
from pcalib.fitting import memory as memories

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


@dataclass(frozen=True)
class World:
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


def explanations(
    start: World,
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
        found |= _levels_as_good(worlds, found, level)
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


def _levels_as_good(
    worlds: Sequence[World], found: Mapping[tuple[str, ...], Explanation], level: float
) -> dict[tuple[str, ...], Explanation]:
    """Geometry levels with far fewer parameters than what was found, which fit if σ is somewhat larger than stated.

    Where no replicates show the noise, σ is known to a quarter. If the noise is larger than
    stated, a level with many more parameters absorbs the excess and would hide the simple level that is right.
    """
    best = min((e.bic for e in found.values()), default=-np.inf)
    out = {}
    for world in worlds:
        screen = world.screen
        if not world.prefix or world.prefix in found or world.problem.noise.verified:
            continue
        rest = float(screen.residual @ screen.residual) / LOUD**2
        if screen.p_value(rest, max(screen.free, 1)) > level:
            explained = _explanation(world, ())
            if explained.bic < best - CLEARLY:
                out[explained.names] = explained
    return out


@dataclass(frozen=True)
class _Event:
    pattern: int
    bic: float
    p: float
    """Of the pattern by itself. It orders events, because BIC would ask much more of the six numbers of a frame than of
    the one of a motor."""


def _events(world: World, level: float) -> list[_Event]:
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


def nearly_all(world: World, data: Measurements, held: HeldOut | None) -> Nearly | None:
    """The effects that take up nearly everything; None where they leave more, or with too many outliers."""
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
        before, after = refitted(made.model, data, []), refitted(made.model, data, best.pairs)
        best = replace(best, held_out=held.compared(before, after))
    return Nearly(best, min(taken / excess, 1.0), left, where)


def shown_by_held_out(
    world: World, data: Measurements, held: HeldOut, level: float, chance: float
) -> list[Explanation]:
    """The single effects that held-out rows confirm although the rows to fit show no more of them than noise would.

    `pcalib add` confirms such an effect, so that a diagnosis that finds one does not say that nothing is missing.

    Args:
        level: at which the rows to fit speak against an effect.
        chance: with which held-out rows may confirm a wrong effect.
    """
    model, out = world.problem.model, []
    chosen_sets = world.adequate(1, level)
    before = refitted(model, data, []) if chosen_sets else None
    for chosen in chosen_sets:
        found = _explanation(world, chosen)
        change = held.compared(before, refitted(model, data, found.pairs))
        if change is not None and change.confirmed and change.p < chance:
            out.append(replace(found, held_out=change, doubts=(Doubt.SMALL,)))
    return sorted(out, key=lambda e: (bool(e.implausible), e.bic))


def beside_parts(best: Explanation, made: Problem, n_draws: int, seed: int, level: float) -> list[Explanation]:
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
    world = World((), wider, screen, adequacy.null_distribution(screen), {})
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
    scale = np.concatenate([screen.scale[g] for g in chosen])
    F = np.hstack([screen.parts[g] for g in chosen]) * scale
    bounded = least_squares.bounded(F, screen.y, low / scale, high / scale)
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
    start: World,
    data: Measurements,
    own: Sequence[Effect],
    n_draws: int,
    seed: int,
    without: Sequence[str],
) -> list[World]:
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
        out.append(World((candidate.name,), rebuilt, screen, null, start.widened))
    return out


def _explanation(world: World, chosen: tuple[int, ...]) -> Explanation:
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


def _columns(made: Problem) -> int:
    return int(np.linalg.matrix_rank(made.nuisance, NUISANCE))
