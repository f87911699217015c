"""Adding an effect or a level to a model, and taking it out again: full refits, compared before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib import effects
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.candidates import require_seen
from pcalib.diagnosis.held_out import FEWEST, Change, HeldOut
from pcalib.diagnosis.hypothesis import resolve, start_of
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.problem import problem
from pcalib.effects.base import Effect
from pcalib.errors import EffectError, unknown
from pcalib.fitting import identification
from pcalib.fitting.identification import Fit
from pcalib.fitting.linearisation import conditions_of, predicted
from pcalib.model import Model


@dataclass(frozen=True)
class Step:
    """One change of a model, with the fits on either side."""

    action: str
    """'add' or 'drop'."""
    spec: str
    before: Fit
    after: Fit

    held: Change | None = None
    """What held-out rows say of it; None where none are held out."""

    @property
    def fell(self) -> bool | None:
        """Whether held-out χ² fell by more than chance (on dropping: rose by no more than chance); None where too few
        rows are held out to say."""
        if self.held is None or self.held.rows < FEWEST:
            return None
        return self.held.confirmed if self.action == "add" else not self.held.refuted

    def moved(self, least: float = 1.0) -> list[tuple[str, float, float]]:
        """Parameters whose value changed by more than `least` of their former σ: (name, change [SI], in σ)."""
        a, b = self.before.candidate, self.after.candidate
        names = a.robot.mechanism.parameters
        sigma = np.full(len(names), np.nan) if a.sigma is None else a.sigma
        change = b.k - a.k
        with np.errstate(invalid="ignore", divide="ignore"):
            times = np.where(sigma > 0, np.abs(change) / sigma, 0.0)
        order = [int(i) for i in np.argsort(-times) if times[i] > least]
        return [(names[i], float(change[i]), float(times[i])) for i in order]


def add(model: Model, data: Measurements, spec: str, own: Sequence[Effect] = ()) -> Step:
    """Refit geometry, effects and frame with an effect, or at a geometry level, that the model lacks.

    Raises:
        EffectError: unknown, present already, without the columns it needs, or without any trace in these poses.
        FitError: the data do not support it.
    """
    wanted = resolve(spec, model, own)
    before = identification.fit(data, model, model.level)
    start, level = start_of(before.model, [(wanted, np.zeros(len(wanted.scale(model))))])
    if wanted.effect is not None:
        effects.require(wanted.effect, data.columns, data.source)
        _require_seen(wanted.effect, before.model, data)
    return _step("add", wanted.spec, model, data, own, before, identification.fit(data, start, level))


def _step(
    action: str, spec: str, model: Model, data: Measurements, own: Sequence[Effect], before: Fit, after: Fit
) -> Step:
    held = HeldOut.of(problem(model, data, own), data) if data.check.any() else None
    return Step(action, spec, before, after, held.change(before.candidate, after.candidate) if held else None)


def _require_seen(effect: Effect, model: Model, data: Measurements) -> None:
    fitted = data.take(~data.check)
    conditions = conditions_of(fitted)
    require_seen(effect, Point.of(model, predicted(model, fitted), conditions))


def _no_effect(level: str, model: Model) -> str:
    """Why a geometry level cannot be dropped, and how to get rid of it."""
    if level != model.level:
        return f"{level} is a geometry level, no effect, and the model is of level {model.level}"
    remedy = "for a simpler model: 'pcalib fit … --level'"
    other = [i for i, entry in enumerate(model.history, 1) if entry.get("level") != level]
    if other:
        remedy = f"'pcalib log … --back-to {other[-1]}' goes back to the step before it"
    return f"{level} is the model's geometry level, no effect\n  {remedy}"


def drop(model: Model, data: Measurements, spec: str, own: Sequence[Effect] = ()) -> Step:
    """Refit without an effect.

    Raises:
        EffectError: the model does not have it.
    """
    if spec in model.robot.mechanism.levels:
        raise EffectError(_no_effect(spec, model))
    name = spec.partition(":")[0].partition("@")[0] if ".py" not in spec else spec
    kept = tuple(f for f in model.effects if f.effect.name != name and f.spec != spec)
    if len(kept) == len(model.effects):
        have = [f.effect.name for f in model.effects]
        raise EffectError(unknown("effect of the model", spec, have) if have else "the model has no effects to drop")
    before = identification.fit(data, model, model.level)
    after = identification.fit(data, replace(before.model, effects=kept), model.level)
    return _step("drop", spec, model, data, own, before, after)
