"""From a model and its data to the plain arrays that are tested: whitened residuals, nuisance columns and groups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.diagnosis import outliers
from pcalib.diagnosis import tails as heavy
from pcalib.diagnosis.candidates import Candidate, Unavailable, candidates
from pcalib.diagnosis.outliers import Outliers
from pcalib.diagnosis.patterns import BY_POSE, Pattern, broken, patterns, ripple
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.screen import NUISANCE, Group, Known, Screen, joint_span, outside, project_out, screen, span
from pcalib.diagnosis.searched import breaks, scanned
from pcalib.diagnosis.tails import Tails
from pcalib.diagnosis.taking import MOST, taken
from pcalib.effects.base import Effect
from pcalib.fitting import linearisation
from pcalib.fitting import memory as memories
from pcalib.fitting import noise_level as noises
from pcalib.fitting.noise_level import Blocks, NoiseLevel
from pcalib.fitting.sufficiency import require_reach
from pcalib.fitting.unknowns import Unknowns, unknowns_of
from pcalib.model import Model

VARIANCES = 2
"""Noise variances of a class of readings where an error of the rotation also moves the measured point."""
SHORTEST = 0.01
"""[m] lever of a tool from which on turns of the measured body show in positions: 1 cm turns 100 µrad into 1 µm."""


@dataclass(frozen=True)
class Reading:
    """Scaling of readings [m, rad] to noise units: first by the stated noise, then by the noise that was found."""

    stated: Noise
    whitener: np.ndarray
    """(N, 6, 6) from stated noise units to those of the noise level."""
    serial: tuple[np.ndarray, ...] = ()
    """Per component (n, n), over its measured rows, against correlation in time; none where there is none."""

    @property
    def row(self) -> np.ndarray:
        """(M,) row of each measured reading."""
        return self.stated.row

    @property
    def component(self) -> np.ndarray:
        """(M,) 0…5."""
        return self.stated.component

    def padded(self, values: np.ndarray) -> np.ndarray:
        """Values (N, 6, …) in noise units, of the same shape; 0 where nothing is measured."""
        out = self.whitener @ self.stated.padded(values).reshape(*values.shape[:2], -1)
        for c, factor in enumerate(self.serial):
            seen = self.stated.measured[:, c]
            out[seen, c] = factor @ out[seen, c]
        return out.reshape(values.shape)

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Values (N, 6, …) as (M, …) in noise units."""
        return _gather(self.padded(values), self.row, self.component)


@dataclass(frozen=True)
class Problem:
    """One model on its fit rows, with everything that may be missing from it."""

    model: Model
    data: Measurements
    """The fit rows that count, σ as stated."""
    point: Point
    y: np.ndarray
    """(M,) whitened residuals."""
    nuisance: np.ndarray
    """(M, n) whitened columns of what the model has already, scaled by priors."""
    row: np.ndarray
    """(M,) pose of each reading."""
    component: np.ndarray
    """(M,) 0…5."""
    candidates: tuple[Candidate, ...]
    patterns: tuple[Pattern, ...]
    unavailable: tuple[Unavailable, ...]
    noise: NoiseLevel
    whitener: np.ndarray
    """(N, 6, 6) from stated noise units to those of the noise level."""
    serial: tuple[np.ndarray, ...]
    """As in :class:`Reading`."""
    outliers: Outliers
    """Rows of `given` that were set aside."""
    given: Measurements
    """The fit rows that were looked at, before any were set aside."""
    rows: np.ndarray
    """Rows of the data that `given` holds."""
    of: int
    """How many rows to fit the data have: more than those of `given` in a large file."""
    tails: Tails | None = None
    """How heavy tails of the noise are met; None where it has none."""

    def in_noise_units(self, columns: np.ndarray) -> np.ndarray:
        """Columns (N, 6, p) [m, rad] in noise units, zero where nothing is measured."""
        return self.reading.padded(columns)

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        """Columns (N, 6, p) [m, rad] as (M, p) in noise units."""
        return self.reading.whiten(columns)

    @property
    def reading(self) -> Reading:
        """The whitening of the readings."""
        return Reading(Noise.of(self.data), self.whitener, self.serial)

    def elsewhere(self, data: Measurements) -> tuple[Reading, np.ndarray]:
        """The whitening of other rows, and the columns (m, n) there of what the model has, scaled by priors."""
        unknowns = unknowns_for(self.model, self.data)
        stated = Noise.of(data)
        linear = linearisation.linearise(self.model, data, unknowns)
        point = Point.of(self.model, linear.prediction, linearisation.conditions_of(data))
        blocks = _blocks_of(point, data, np.zeros(data.mask.shape))
        memory = self.noise.memory
        serial = tuple(memory.whitener(data)) if memory else ()
        reading = Reading(stated, noises.whitener(self.noise, blocks), serial)
        columns = linear.padded * (unknowns.scale * spread(self.model, unknowns))
        plain = replace(reading, stated=replace(stated, sigma=np.ones(stated.sigma.shape), covariance=None))
        return reading, np.nan_to_num(plain.whiten(columns))

    @cached_property
    def groups(self) -> list[Group]:
        """Candidates, then patterns."""
        out = [
            Group(c.spec, self.whitened(c.columns), c.scale, search=c.search, limit=c.limit) for c in self.candidates
        ]
        for p in self.patterns:
            size = np.full(p.columns.shape[-1], p.size)
            out.append(Group(f"{p.channel} × {p.variable}", self.whitened(p.columns), size, search=p.search))
        return out

    @property
    def set_aside(self) -> np.ndarray:
        """Indices into `given` of the outliers that were left out."""
        return np.zeros(0, int) if self.outliers.kept else self.outliers.rows

    @property
    def classes(self) -> np.ndarray:
        """(M,) 0 for positions, 1 for rotations."""
        return (self.component >= 3).astype(int)

    @property
    def known(self) -> Known:
        """How well the noise level is known.

        Where an error of the rotation also moves the measured point, each class of readings has two noise variances,
        and half of its degrees of freedom for each. Combinations of readings in which that error cancels are the most
        precise; their variance is known from one class alone. With the degrees of freedom of all, reflectors 200 mm off
        raised alarms in 8.3 % of 400 data sets; with these, in 5.0 %.
        """
        if self.noise.lever:
            return Known(self.classes, self.noise.dof / VARIANCES, pooled=False)
        return Known(self.classes, self.noise.dof)

    def screen(self, n_draws: int = 4096, seed: int = 0) -> Screen:
        """The reduced arrays that all tests run on; the diagnosis, the laws and the evidence of one problem share
        them."""
        key = n_draws, seed
        if key not in self._screens:
            from_rest = self.noise.source == "residuals" or self.noise.pooled
            self._screens[key] = screen(
                self.y, self.nuisance, self.groups, self.known, from_rest=from_rest, n_draws=n_draws, seed=seed
            )
        return self._screens[key]

    @cached_property
    def _screens(self) -> dict[tuple[int, int], Screen]:
        """The screens that were made, by the number of their draws and the seed."""
        return {}


def problem(
    model: Model,
    data: Measurements,
    own: Sequence[Effect] = (),
    noise: NoiseLevel | None = None,
    all_rows: bool = False,
    without: Sequence[str] = (),
    most: int = MOST,
) -> Problem:
    """Set up the diagnosis of a model on data.

    Args:
        data: all rows; only those of ``set = fit`` are used, and of very many some that stand for all.
        own: the user's own effects.
        noise: a level found before; estimated where absent.
        all_rows: set no outliers aside.
        without: names of effects that are not considered.
        most: rows that are looked at, about.
    """
    fit = data.take(~data.check)
    some = taken(fit, most)
    rows, of, fit = np.flatnonzero(~data.check)[some], len(fit), fit.take(some) if len(some) < len(fit) else fit
    model = linearisation.seen_from(model, fit)
    made = replace(_linearised(model, fit, own, without), rows=rows, of=of)
    Q = joint_span(made.nuisance, made.groups)
    if not all_rows:
        events = [p for p in made.patterns if p.found is not None and p.found.clear]
        steps = [made.whitened(p.columns) * p.size for p in events]  # rows after a step are no outliers
        known = span(np.hstack([made.nuisance, *steps]), NUISANCE)
        odd = outliers.find(made.y, Q, made.row, len(fit), known)
        # What was searched for may have been found for the sake of a single wild row, and then hides it.
        smooth = [g for g in made.groups if g.search.trials == 1]
        plain = span(made.nuisance, NUISANCE)
        alone = outliers.find(made.y, joint_span(made.nuisance, smooth), made.row, len(fit), plain)
        if len(alone.rows) > len(odd.rows) and alone.single:
            odd = alone
        if len(odd.rows) and not odd.kept:
            keep = np.ones(len(fit), bool)
            keep[odd.rows] = False
            made = replace(_linearised(model, fit.take(keep), own, without), outliers=odd, given=fit, rows=rows, of=of)
            Q = joint_span(made.nuisance, made.groups)
        else:
            made = replace(made, outliers=odd)
    blocks = _blocks(made)
    level = noise or _level(made, blocks, Q)
    if level.source == "stated":
        return replace(made, noise=level)
    whitener = noises.whitener(level, blocks)

    def turned(columns: np.ndarray) -> np.ndarray:
        return _gather(whitener @ _scatter(columns, made), made.row, made.component)

    made = replace(
        made, y=turned(made.y[:, None])[:, 0], nuisance=turned(made.nuisance), noise=level, whitener=whitener
    )
    return _tempered(_shaped(made))


def _tempered(made: Problem) -> Problem:
    """The problem with residuals of heavy tails clipped, as robust regression does it (Huber's pseudo-values).

    Clipped residuals ψ(r) over the share of those that were not clipped have the signal of r and less noise. Normal
    draws then stand for them, which they do not for single wild readings.
    """
    U = span(made.nuisance, NUISANCE)
    rest = project_out(made.y, U)
    tails = heavy.find(made.y, made.nuisance, made.groups, made.classes)
    if tails is None:
        return made
    inside = made.y - rest
    clipped = _scatter((inside + tails.clipped(rest, made.classes))[:, None], made)[..., 0]
    blocks = Blocks(made.data.mask, clipped, np.zeros((*made.data.mask.shape, 1)))
    left = noises.left_over(blocks, _scatter(joint_span(made.nuisance, made.groups), made), _luck(made))
    level = noises.from_rest(made.data, blocks, left, noises.ENOUGH_BESIDE, joints=False)
    if level is None:
        return made
    tails = replace(tails, size=tails.size / level.ratio)
    y = inside + tails.clipped(rest, made.classes)
    return replace(made, y=y, noise=replace(made.noise, dof=level.dof, pooled=True), tails=tails)


def _shaped(made: Problem) -> Problem:
    """The problem with correlation in time of its noise allowed for, and the level found anew."""
    U = span(made.nuisance, NUISANCE)
    if not made.noise.memory and not memories.stands_out(made.data, made.y, U, made.row, made.component):
        return made
    by_pose: set[int] = set()
    if memories.unordered(made.data):  # errors that depend on the pose alone are white in time
        first = len(made.candidates)
        by_pose = {i + first for i, p in enumerate(made.patterns) if p.variable in BY_POSE}
    slow = joint_span(made.nuisance, [g for i, g in enumerate(made.groups) if i not in by_pose])
    memory = made.noise.memory or memories.memory(
        made.data, made.y, U, slow, made.row, made.component, made.noise.excess
    )
    if memory is None:
        return made
    serial = tuple(memory.whitener(made.data))

    def turned(columns: np.ndarray) -> np.ndarray:
        eye = np.ones(made.data.mask.shape)
        plain = Reading(Noise(made.data.mask, eye), np.broadcast_to(np.eye(6), (len(eye), 6, 6)), serial)
        return plain.whiten(_scatter(columns, made))

    y, nuisance = turned(made.y[:, None])[:, 0], turned(made.nuisance)
    changed = replace(made, y=y, nuisance=nuisance, serial=serial)
    Q = joint_span(nuisance, changed.groups)
    blocks = Blocks(made.data.mask, _scatter(y[:, None], made)[..., 0], np.zeros((*made.data.mask.shape, 1)))
    left = noises.left_over(blocks, _scatter(Q, made), _luck(made))
    rest = noises.from_rest(made.data, blocks, left, noises.ENOUGH_BESIDE, joints=False)
    ratio = np.ones(2) if rest is None else rest.ratio
    level = noises.reshaped(made.noise, made.data, ratio, rest, memory)
    by = np.repeat(1.0 / ratio, 3)
    return replace(
        changed, y=y * by[made.component], nuisance=nuisance * by[made.component][:, None], noise=level,
        whitener=made.whitener * by[:, None],
    )  # fmt: skip


def _linearised(model: Model, fit: Measurements, own: Sequence[Effect], without: Sequence[str]) -> Problem:
    unknowns = unknowns_for(model, fit)
    linear = linearisation.linearise(model, fit, unknowns)
    require_reach(linear.prediction, fit)
    point = Point.of(model, linear.prediction, linearisation.conditions_of(fit))
    nuisance = linear.jacobian * unknowns.scale * spread(model, unknowns)

    whiten = Noise.of(fit).whiten
    found, unavailable = candidates(point, own, lambda: scanned(point, linear.residual, nuisance, whiten))
    unavailable += [Unavailable(name, "left out, as asked") for name in {c.name for c in found} & set(without)]
    found = [c for c in found if c.name not in without]
    # The patterns together leave half of what the data can say to judge the noise by, each a fair share to others.
    room = len(linear.residual) - int(np.linalg.matrix_rank(nuisance, NUISANCE))
    seen = np.any(np.abs(point.rigid()) * fit.mask[:, :, None] > 0, axis=(0, 1))
    cells = patterns(point, max(3, min(60, room // 6)), max(30, room // 2 - 20), seen)
    if point.situation.robot.mechanism.actuator_dimension == "angle" and not any(c.search.trials > 1 for c in found):
        # No effect that is searched for speaks for fast errors of the motors: the patterns have to.
        best, search = scanned(point, linear.residual, nuisance, whiten)[-1]
        cells.append(ripple(point, best.cycles[0], search))
    read = np.asarray(fit.mask.any(axis=0))
    cells += [broken(b, point) for b in breaks(point, linear.residual, nuisance, linear.row, read, whiten)]
    eye = np.broadcast_to(np.eye(6), (len(fit), 6, 6))
    return Problem(
        model, fit, point, linear.residual, nuisance, linear.row, linear.component,
        tuple(found), tuple(cells), tuple(unavailable), noises.as_stated(fit), eye, (),
        Outliers(np.zeros(0, int), np.zeros(0)), fit, np.arange(len(fit)), len(fit),
    )  # fmt: skip


def unknowns_for(model: Model, data: Measurements) -> Unknowns:
    """What a refit of the model to the data would free."""
    how = model.options
    return unknowns_of(model, model.level, model.effects, data.frame == "tracker", fixed=how.fixed, prior=how.prior)


def spread(model: Model, unknowns: Unknowns) -> np.ndarray:
    """(n,) by how much each unknown's prior must be widened for this robot: geometry by its own errors, never less."""
    out = np.ones(len(unknowns.names))
    g = unknowns.n_geometry
    if g:
        errors = unknowns.coordinates(model.errors) / unknowns.scale[:g]
        out[:g] = np.clip(np.sqrt(np.mean(errors**2)), 1.0, 100.0)
    return out


def _blocks(made: Problem) -> Blocks:
    return _blocks_of(made.point, made.data, _scatter(made.y[:, None], made)[..., 0])


def _blocks_of(point: Point, data: Measurements, y: np.ndarray) -> Blocks:
    """Residuals y (N, 6) in stated noise units with what joints and a turn of the measured body do to readings.

    A file that states how the readings of a row are correlated leaves no lever to be found.
    """
    stated = Noise.of(data)
    joint = stated.padded(point.response().actuator)
    poses = data.readings is None and data.correlation is None
    if not poses or not all(data.kinds) or np.max(np.abs(point.lever()), initial=0.0) < SHORTEST:
        return Blocks(data.mask, y, joint)
    return Blocks(data.mask, y, joint, stated.padded(point.turn()))


def _level(made: Problem, blocks: Blocks, Q: np.ndarray) -> NoiseLevel:
    """The best noise level that the data allow, with the joint span Q of nuisance and groups."""
    drift = [c for c in made.candidates if c.name == "base_drift"]
    between = [drift[0].columns * drift[0].scale] if drift else []
    between += [p.columns * p.size for p in made.patterns if p.found is not None and p.found.clear]
    columns = np.concatenate([np.zeros((*blocks.y.shape, 0)), *between], axis=-1)
    V = noises.contrasts(made.data, made.data.mask, Noise.of(made.data).padded(columns))
    repeated = noises.from_replicates(made.data, blocks, V)
    if repeated is not None:
        Q = np.hstack([Q, outside(_gather(V, made.row, made.component), Q)])
    # What was chosen to suit the noise took of it in all directions alike: some outside all else.
    luck = _luck(made) * (1 - Q.shape[1] / len(made.y))
    enough = noises.ENOUGH_REST if repeated is None else noises.ENOUGH_BESIDE
    joints = repeated is None or repeated.sigma_q > 0
    left = noises.left_over(blocks, _scatter(Q, made), luck)
    rest = noises.from_rest(made.data, blocks, left, enough, joints)
    if repeated is None:
        level = rest or noises.as_stated(made.data)
    else:
        level = replace(noises.pooled(repeated, rest), excess=noises.excess(repeated, rest))
        if rest is not None and not level.pooled and not repeated.sigma_q:
            with_joints = noises.from_rest(made.data, blocks, left, enough)
            level = replace(level, repeatable=with_joints.sigma_q if with_joints else 0.0)
    usual = noises.STEPS[made.point.situation.robot.mechanism.actuator_dimension]
    return noises.with_steps(level, blocks, left, usual)


def _luck(made: Problem) -> float:
    """χ² by which searches reduce pure noise beyond what their columns would: the largest of all ripple searches, which
    share their waves, plus that of every other search."""
    ripples = [c.search.luck for c in made.candidates] + [p.search.luck for p in made.patterns if p.found is None]
    return max(ripples, default=0.0) + sum(p.search.luck for p in made.patterns if p.found is not None)


def _scatter(columns: np.ndarray, made: Problem) -> np.ndarray:
    """(M, p) as (N, 6, p)."""
    out = np.zeros((len(made.data), 6, columns.shape[1]))
    out[made.row, made.component] = columns
    return out


def _gather(columns: np.ndarray, row: np.ndarray, component: np.ndarray) -> np.ndarray:
    """(N, 6, p) as (M, p)."""
    return columns[row, component]
