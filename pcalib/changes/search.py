"""Which part changed: parts, effects and slips within the session, judged as the hypotheses of a diagnosis are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from pcalib import prediction, rotation
from pcalib.changes.results import Changed, Changes, ChangeSet, Slip, Verdict
from pcalib.changes.session import FRAME_PRIOR, LinearisedSession, at, session
from pcalib.data.measurement import Measurements
from pcalib.diagnosis import adequacy
from pcalib.diagnosis.candidates import Candidate, candidates
from pcalib.diagnosis.hypothesis import Hypothesis, Kind
from pcalib.diagnosis.patterns import cells, patterns
from pcalib.diagnosis.screen import Group, Known, Screen, Search, project_out, screen, smallest_seen, span
from pcalib.errors import InputError
from pcalib.fitting import linearisation
from pcalib.model import Model

SLIPPERY = 3
"""Most directions of a part that may slip within a session: zeros, single joints and rods, and the frame's place."""
WIDE = 6
"""Most directions of a part that counts as one change: a rigid motion, or two ball joints."""
EDGE = 3
"""Rows before and after a slip that it takes to tell it from outliers."""
SPLITS = 160
"""Most places that are tried for a slip; of more rows every second, third … is a place."""
DRAWS = 256
"""Draws of pure noise on which the search for a slip is repeated, to learn what it finds by chance."""
LARGE = 12.0
"""Noise units of a change from which on the residuals are linearised anew at its size: the second order of a change
δ of a length L is δ²/L, a tenth of the noise for 12 noise units of 20 µm on a lever of 300 mm."""
REFINED = 5
"""Single hypotheses, those that take up most, that are linearised anew at their size."""
CLEAR = 6.0
"""Difference of BIC from which on the evidence for the simpler of two nested sets is strong (Kass & Raftery 1995)."""
AGAINST = (0.005, 0.02)
"""Levels at which data speak against an explanation, a single one and two at once. Parts contain each other: where the
one that changed is dropped by chance, a wider one that contains it stands alone and passes for established."""
ROUNDS = 4
SETTLED = 1e-3
"""Most rounds of that, and the step in tolerances below which it ends: 0.1 µm."""


def changes(
    model: Model,
    data: Measurements,
    same_setup: bool = False,
    alpha: float = adequacy.ALPHA,
    against: tuple[float, float] = AGAINST,
    seed: int = 0,
) -> Changes:
    """What changed since the session of a model.

    Args:
        data: the new session; every row is used.
        same_setup: the instrument and its target were not touched.
        alpha: chance of an alarm where nothing changed.
        against: share of true explanations that may be dropped, single ones and pairs.

    Raises:
        InputError: the model keeps no uncertainty, or the robot of the model cannot take the commands.
    """
    new = session(model, data, same_setup)
    asked = _Asked.of(new, seed)
    start = adequacy.p_values(asked.screen)
    null = adequacy.null_distribution(asked.screen)
    critical = float(np.quantile(null, alpha))
    p = float(adequacy.corrected(start.smallest, null))
    sets: list[ChangeSet] = []
    if start.smallest < critical:
        sets = _change_sets(asked, null, same_setup, against)
    verdict = _decide(sets) if start.smallest < critical else Verdict.NOTHING
    n = len(asked.candidates)
    findings = [asked.finding(g, float(adequacy.corrected(start.p[g], null)), critical) for g in range(n)]
    screened = asked.screen
    return Changes(
        verdict=verdict,
        sets=tuple(sets),
        findings=tuple(sorted(findings, key=lambda f: (f.p, -f.s))),
        cells=cells(asked.patterns, n, screened, start.p, null),
        frame=_since(model, data, asked.frame(sets[0].names if sets else ())),
        chi2_dof=float(screened.residual @ screened.residual) / max(screened.free, 1),
        p=p,
        critical=critical,
        session=new,
    )


@dataclass(frozen=True, eq=False)
class _Asked:
    """A session with everything that may have changed in it."""

    session: LinearisedSession
    candidates: tuple[Candidate, ...]
    slips: tuple[Slip | None, ...]
    patterns: list
    screen: Screen

    @classmethod
    def of(cls, new: LinearisedSession, seed: int, slips: bool = True) -> _Asked:
        point = new.point
        found = [Candidate.of(h, point) for h in hypotheses(new.model)]
        found += [c for c in candidates(point)[0] if c.hypothesis.kind is Kind.EFFECT and _simplest(c)]
        found += [Candidate.of(Hypothesis.of(fitted.effect), point) for fitted in new.model.effects]
        found = [c for c in found if np.any(c.columns)]
        where: list[Slip | None] = [None] * len(found)
        groups = [Group(c.spec, new.whitened(c.columns), c.scale, limit=None) for c in found]
        if slips:
            for candidate, slip, columns, search in _slips(new, found):
                found.append(candidate)
                where.append(slip)
                groups.append(Group(candidate.name, columns, candidate.scale, search=search))
        room = len(new.y) - new.frame.shape[1]
        measured = np.asarray(new.data.mask.any(axis=0))
        omnibus = patterns(point, max(3, min(60, room // 6)), max(20, room // 3), measured)
        for pattern in omnibus:
            size = np.full(pattern.columns.shape[-1], pattern.size)
            name = f"{pattern.channel} × {pattern.variable}"
            groups.append(Group(name, new.whitened(pattern.columns), size, search=pattern.search))
        known = Known(np.zeros(len(new.y), int), np.array([new.left.dof]))
        made = screen(new.y, new.frame, groups, known, seed=seed)
        return cls(new, tuple(found), tuple(where), omnibus, made)

    def finding(self, g: int, p: float, critical: float) -> Changed:
        """What one candidate says on its own."""
        screened = self.screen
        theta, sigma = (a[0] for a in screened.estimate([g]))
        return Changed(
            candidate=self.candidates[g],
            theta=theta,
            sigma=sigma,
            s=float(np.linalg.norm(screened.blocks[g].T @ screened.y)),
            p=p if screened.visible[g] else 1.0,
            smallest=smallest_seen(screened, g, critical),
            slip=self.slips[g],
            before=self.before(g),
        )

    def before(self, g: int) -> np.ndarray | None:
        """Parameters of an effect that the model has; None for all other hypotheses."""
        name, effects = self.candidates[g].name, self.session.model.effects
        return next((f.theta for f in effects if self.candidates[g].effect is not None and f.effect.name == name), None)

    def frame(self, changed: Sequence[str]) -> np.ndarray:
        """Least-squares step of the session's frame (0, 6, 9 or 12) [m, rad], beside the changes of these names."""
        new, n = self.session, self.session.n_frame
        beside = [
            new.whitened(c.columns) * c.scale
            for c, slip in zip(self.candidates, self.slips, strict=True)
            if c.name in changed and slip is None
        ]
        both = np.hstack([new.frame, *beside])
        return np.linalg.lstsq(both, new.y, rcond=1e-10)[0][:n] * FRAME_PRIOR[:n]


def _since(before: Model, data: Measurements, step: np.ndarray) -> np.ndarray:
    """Change of the measuring frame (0 or 6) [m, rad] since the model was made: displacement of the readings' centroid,
    and rotation.

    The readings are registered to what the model predicts in its own frame. A fit of the new frame would share its
    change with the base, whose place in a tracker's frame is uncertain.
    """
    if not len(step) or before.frame is None or data.frame != "tracker":
        return step
    was = prediction.predict(before, data.q, linearisation.conditions_of(data)).position
    seen = np.isfinite(was).all(axis=1) & data.mask[:, :3].all(axis=1)
    if seen.sum() < 3:
        return step
    R, _ = rotation.registered(was[seen], data.position[seen])
    return np.concatenate([np.mean(data.position[seen] - was[seen], axis=0), rotation.log(R)])


def hypotheses(model: Model) -> list[Hypothesis]:
    """Every part of the robot as a hypothesis."""
    return [Hypothesis.part(part, model) for part in model.robot.mechanism.parts]


def _simplest(candidate: Candidate) -> bool:
    """Whether this is the first variant of its effect: others are not tried, because every trial costs power."""
    return candidate.spec == candidate.name or candidate.search.trials > 1


def _slips(new: LinearisedSession, found: Sequence[Candidate]) -> list[tuple[Candidate, Slip, np.ndarray, Search]]:
    """The best place of a slip for every part that can slip, and what the search for it costs."""
    rows = len(new.data)
    places = np.arange(EDGE, rows - EDGE + 1)
    if not len(places):
        return []
    places = places[:: max(1, -(-len(places) // SPLITS))]
    U = span(new.frame, 1e-9)
    rest = project_out(new.y, U)
    rng = np.random.default_rng(1)
    draws = project_out(rng.standard_normal((len(new.y), DRAWS), dtype=np.float32), U.astype(np.float32))
    out = []
    for candidate in found:
        p = len(candidate.scale)
        if candidate.hypothesis.kind is not Kind.PART or p > SLIPPERY:
            continue
        raw = new.noise.whiten(candidate.columns)
        best, by_chance, chosen = -1.0, np.zeros(DRAWS), int(places[0])
        for place in places:
            E = project_out(new.factor @ np.where((new.row >= place)[:, None], raw, 0.0), U)
            Q = span(E / np.maximum(np.linalg.norm(E, axis=0), 1e-300), 1e-3)
            gain = float(np.sum((Q.T @ rest) ** 2))
            by_chance = np.maximum(by_chance, np.sum((Q.astype(np.float32).T @ draws) ** 2, axis=0))
            if gain > best:
                best, chosen = gain, int(place)
        columns = new.factor @ np.where((new.row >= chosen)[:, None], raw, 0.0)
        named = replace(
            candidate.hypothesis,
            name=f"{candidate.name}@{chosen}",
            spec=f"{candidate.name}@{chosen}",
            words=f"{candidate.hypothesis.words}, from row {chosen + 1} on",
        )
        made = Candidate(named, candidate.columns, candidate.scale, candidate.low, candidate.high)
        out.append((made, Slip(candidate.hypothesis, chosen), columns, Search.of(by_chance, p)))
    return out


def _change_sets(asked: _Asked, null: np.ndarray, same_setup: bool, against: tuple[float, float]) -> list[ChangeSet]:
    """The smallest adequate sets, single changes first, then pairs; the best BIC first.

    A part with very many directions, as the plate with all its joints, stands beside the pairs: it can imitate them.
    """
    screened, n = asked.screen, len(asked.candidates)
    gains = [float(np.sum((b.T @ screened.y) ** 2)) for b in screened.blocks[:n]]
    every = sorted((g for g in range(n) if screened.visible[g]), key=lambda g: len(asked.candidates[g].scale))
    order = [g for g in every if len(asked.candidates[g].scale) <= WIDE]
    names = [c.name for c in asked.candidates] + [""] * (len(screened.blocks) - n)
    reference = float(np.quantile(null, against[0]))
    found = adequacy.adequate_sets(screened, order, 1, against[0], reference, names)
    single = [_explained(asked, chosen) for chosen in found]
    known = {e.names for e in single}
    large = [g for g in order if gains[g] > LARGE**2]
    for g in sorted(large, key=lambda g: -gains[g])[:REFINED]:  # of a large change the residuals are not linear
        if (asked.candidates[g].name,) not in known and (better := _refined(asked, [g], same_setup, against[0])):
            single.append(better)
    if single:
        return _ordered(single)
    reference = float(np.quantile(null, against[1]))
    found = adequacy.adequate_sets(screened, order, 2, against[1], reference, names)
    found += adequacy.adequate_sets(screened, [g for g in every if g not in order], 1, against[0], reference, names)
    if found or not large:
        return _ordered([_explained(asked, chosen) for chosen in found])
    pairs = [pair for pair in combinations(order, 2) if set(pair) & set(large)]
    best = sorted(pairs, key=lambda pair: -float(np.sum((screened.joint(pair).T @ screened.y) ** 2)))[:REFINED]
    return _ordered([e for c in best if (e := _refined(asked, c, same_setup, against[1]))])


def _explained(asked: _Asked, chosen: Sequence[int]) -> ChangeSet:
    screened = asked.screen
    theta, sigma = screened.estimate(list(chosen))
    Q = screened.joint(list(chosen))
    rest = float(screened.y @ screened.y - np.sum((Q.T @ screened.y) ** 2))
    members = []
    for g, value, spread in zip(chosen, theta, sigma, strict=True):
        s = float(np.linalg.norm(screened.blocks[g].T @ screened.y))
        nothing = np.full(len(value), np.inf)
        members.append(Changed(asked.candidates[g], value, spread, s, 0.0, nothing, asked.slips[g], asked.before(g)))
    columns = sum(len(m.theta) + (m.slip is not None) for m in members)
    return ChangeSet(tuple(members), rest + columns * float(np.log(len(asked.session.y))))


def _ordered(found: Sequence[ChangeSet]) -> list[ChangeSet]:
    """The sets by BIC; a slip is named only where no change that holds for the whole session does as well."""
    ordered = sorted(found, key=lambda e: e.bic)
    constant = min((e.bic for e in ordered if not e.slips), default=np.inf)
    return [e for e in ordered if not (e.slips and e.bic > constant)]


def _decide(sets: Sequence[ChangeSet]) -> Verdict:
    """The verdict on the adequate sets of something that changed, the best BIC first.

    A joint that moved also fits as the whole arm that carries it. Such wider parts are no rivals where the data prefer
    the joint clearly; they are named beside it.
    """
    if not sets:
        return Verdict.UNEXPLAINED
    first, *others = sets
    clear = all(other.bic > first.bic + CLEAR and _within(first, other) for other in others)
    return Verdict.ESTABLISHED if clear else Verdict.AMBIGUOUS


def _within(small: ChangeSet, large: ChangeSet) -> bool:
    """Whether a set of changes is a special case of another one with more directions."""
    a, b = (
        [m.candidate.hypothesis.basis for m in e.members if m.slip is None and m.candidate.hypothesis.basis is not None]
        for e in (small, large)
    )
    if len(a) != len(small.members) or len(b) != len(large.members):
        return False
    inside, whole = np.hstack(a), np.hstack(b)
    left = inside - whole @ np.linalg.lstsq(whole, inside, rcond=1e-12)[0]
    return bool(np.abs(left).max() < 1e-9)


def _refined(asked: _Asked, chosen: Sequence[int], same_setup: bool, level: float) -> ChangeSet | None:
    """Large changes of one or several parts, linearised at their fitted size; None where not adequate there."""
    parts, start = [asked.candidates[g] for g in chosen], asked.session.model
    if any(c.hypothesis.basis is None for c in parts) or any(asked.slips[g] is not None for g in chosen):
        return None
    basis = np.hstack([c.hypothesis.basis for c in parts])  # type: ignore[list-item]
    scale = np.concatenate([c.scale for c in parts])
    total, new = np.zeros(len(scale)), asked.session
    for _ in range(ROUNDS):
        columns = np.concatenate([c.hypothesis.columns(new.point) for c in parts], axis=-1)
        both = np.hstack([new.frame, new.whitened(columns) * scale])
        step = np.linalg.lstsq(both, new.y, rcond=1e-6)[0][new.frame.shape[1] :] * scale
        total = total + step
        try:
            new = at(start.with_geometry(start.k + basis @ total), asked.session.data, same_setup)
        except InputError:  # a robot that is changed so much cannot take the commands
            return None
        if np.abs(step / scale).max() < SETTLED:
            break
    here = _Asked.of(new, 0, slips=False)
    places = [i for c in parts for i, other in enumerate(here.candidates) if other.name == c.name]
    if len(places) < len(parts):
        return None
    reference = float(np.quantile(adequacy.null_distribution(here.screen), level))
    if not adequacy.is_adequate(here.screen, places, level, reference):
        return None
    made = _explained(here, places)
    sizes = np.split(total, np.cumsum([len(c.scale) for c in parts])[:-1])
    members = tuple(
        replace(m, theta=size, s=float(np.linalg.norm(asked.screen.blocks[g].T @ asked.screen.y)))
        for m, size, g in zip(made.members, sizes, chosen, strict=True)
    )
    return replace(made, members=members)
