"""What may be missing from a model, or may have changed: an effect, a law, a geometry level or a part of the robot.

Every command that takes the name of one (add, next, explain) reads it with :func:`resolve`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from pcalib import effects, prediction
from pcalib.diagnosis.point import Point
from pcalib.effects.base import Effect
from pcalib.errors import EffectError, unknown
from pcalib.fitting.identifiability import PRIOR
from pcalib.fitting.unknowns import unknowns_of
from pcalib.mechanics.mechanism import Part
from pcalib.model import FittedEffect, Model


class Kind(StrEnum):
    """What a hypothesis is about."""

    EFFECT = "effect"
    """A physical effect of the library, or of the user's own."""
    LAW = "law"
    """A channel that follows a function of what was recorded, without a named cause. It acts as an effect does."""
    LEVEL = "level"
    """A geometry level richer than the model's."""
    PART = "part"
    """A part of the robot whose geometry is another than the model's."""


@dataclass(frozen=True)
class Hypothesis:
    """One answer to the question what is missing: it moves the readings by its effect, or by its geometry."""

    kind: Kind
    name: str
    """Variants of one effect (common, per arm) share it."""
    spec: str
    """How a command line names this variant."""
    effect: Effect | None = None
    """The effect or law that the hypothesis adds; None for a level or a part."""
    basis: np.ndarray | None = None
    """(nk, p) directions of the geometric parameters that a level or a part frees; None for an effect or a law."""
    units: tuple[str, ...] = ()
    """(p,) unit of each direction of the geometry: 'm', 'rad' or '1'."""
    words: str = ""
    """What a technician calls it."""

    @classmethod
    def of(cls, effect: Effect, kind: Kind = Kind.EFFECT) -> Hypothesis:
        """An effect or a law as a hypothesis."""
        return cls(kind, effect.name, effect.spec, effect, words=effect.title)

    @classmethod
    def level(cls, name: str, model: Model) -> Hypothesis:
        """A geometry level of the model's mechanism."""
        level = model.robot.mechanism.levels[name]
        return cls(Kind.LEVEL, name, name, None, level.basis, level.units, f"geometry of level {name}")

    @classmethod
    def part(cls, part: Part, model: Model) -> Hypothesis:
        """A part of the model's robot that may have changed."""
        mechanism = model.robot.mechanism
        units = tuple(mechanism.units[int(np.argmax(column))] for column in np.abs(part.basis).T)
        return cls(Kind.PART, part.name, part.name, None, part.basis, units, part.words)

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns of the data without which it cannot be computed, by name without unit."""
        return () if self.effect is None else self.effect.needs

    @property
    def wants(self) -> tuple[str, ...]:
        """What the data must vary for it to be seen, in the user's words."""
        return () if self.effect is None else self.effect.wants

    def scale(self, model: Model) -> np.ndarray:
        """(p,) [SI] usual size of each parameter."""
        if self.effect is not None:
            return np.array([p.prior for p in self.effect.parameters])
        if self.kind is Kind.LEVEL:
            unknowns = unknowns_of(model, self.name)
            return unknowns.scale[: unknowns.n_geometry]
        return np.array([model.options.prior.get(unit, PRIOR[unit]) for unit in self.units])

    def columns(self, point: Point) -> np.ndarray:
        """(N, 6, p) derivative of the readings [m, rad] by each parameter."""
        if self.effect is not None:
            partners = tuple((fitted.effect, fitted.theta) for fitted in point.model.effects)
            return point.columns(self.effect.basis(replace(point.situation, partners=partners)))
        return prediction.geometry_columns(point.model, point.prediction, point.closure, point.JX, self.basis)

    def describe(self, theta: np.ndarray) -> str:
        """Parameters (p,) [SI] of the hypothesis in plain words; empty where it has none of its own."""
        return "" if self.effect is None else self.effect.describe(theta)

    def sentence(self, theta: np.ndarray) -> str:
        """What it is, how a command line names it, and its size."""
        if self.effect is None:
            return self.words
        said = self.describe(theta)
        return f"{self.words} [{self.spec}]" + (f": {said}" if said else "")


def start_of(model: Model, added: Sequence[tuple[Hypothesis, np.ndarray]]) -> tuple[Model, str]:
    """The model and the level from which a refit with hypotheses starts, at their parameters θ (p,) each."""
    fitted = [FittedEffect(h.effect, theta, h.spec) for h, theta in added if h.effect is not None]
    level = next((h.name for h, _ in added if h.kind is Kind.LEVEL), model.level)
    return with_effects(model, fitted), level


def with_effects(model: Model, added: Sequence[FittedEffect]) -> Model:
    """A model with effects added; one of the same name is replaced."""
    names = {f.effect.name for f in added}
    return replace(model, effects=(*(f for f in model.effects if f.effect.name not in names), *added))


def resolve(spec: str, model: Model, own: Sequence[Effect] = (), parts: bool = False) -> Hypothesis:
    """The hypothesis that a command line names, which the model must lack.

    Args:
        spec: NAME or NAME:variant of the library, FILE.py:Class, a geometry level, or a part of the robot.
        own: the user's own effects that were loaded already.
        parts: whether a part of the robot is asked about: as what changed, and not as what is missing.

    Raises:
        EffectError: unknown, in the model already, or a level that is no extension of the model's.
    """
    for part in model.robot.mechanism.parts if parts else ():
        if part.name == spec:
            return Hypothesis.part(part, model)
    if spec in model.robot.mechanism.levels:
        if spec == model.level:
            remedy = "'pcalib diagnose' says what else may be missing"
            raise EffectError(f"the model is of level {spec} already\n  {remedy}")
        if spec not in (richer := richer_levels(model)):
            raise EffectError(
                f"level {spec} is no extension of the model's level {model.level}\n"
                f"  richer than {model.level}: {', '.join(richer) or 'no level is'}; "
                f"for a simpler model: pcalib fit --level {spec}, or pcalib log --back-to"
            )
        return Hypothesis.level(spec, model)
    mine = [e for e in own if spec in (e.name, e.spec)]
    effect = mine[0] if mine else _parsed(spec, model)
    present = {f.effect.name: f.effect for f in model.effects}
    if effect.name in present and len(effect.parameters) <= len(present[effect.name].parameters):
        raise EffectError(
            f"effect {spec} is in the model already\n  'pcalib drop {effect.name} …' shows what it is needed for"
        )
    return Hypothesis.of(effect)


def _parsed(spec: str, model: Model) -> Effect:
    name = spec.partition(":")[0].partition("@")[0]
    if ".py" not in spec and name not in effects.names():
        accepted = [*effects.names(), *(n for n in model.robot.mechanism.levels if n != model.level)]
        raise EffectError(unknown("effect or level", name, accepted))
    return effects.parse(spec, model.robot)


def richer_levels(model: Model) -> list[str]:
    """Named levels that let vary more than the model's own does: what geometry may be missing, simplest first."""
    levels = model.robot.mechanism.levels
    mine = levels[model.level].basis
    out = []
    for name, level in levels.items():
        both = np.hstack([mine, level.basis])
        rank = np.linalg.matrix_rank
        if level.basis.shape[1] and rank(both) == rank(level.basis) > (rank(mine) if mine.shape[1] else 0):
            out.append(name)
    return sorted(out, key=lambda name: levels[name].basis.shape[1])
