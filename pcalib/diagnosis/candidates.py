"""What may be missing, on the poses of a data set: every hypothesis with what it does to the readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib import effects
from pcalib.diagnosis.hypothesis import Hypothesis, richer_levels
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.screen import LARGE, NOT_SEARCHED, Search
from pcalib.effects.base import Effect
from pcalib.effects.gear_ripple import GearRipple
from pcalib.errors import EffectError

ALONE = "add a compliance first: it shows only through one"
"""Why an effect that acts through others (a robot that hangs crooked) moves nothing while nothing in the model gives
way."""
IDLE = "under these conditions it moves nothing"
WEIGHTLESS = "the robot file has no [mass] and there is no payload: nothing loads the robot"
"""Why an effect of load moves nothing."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with its derivatives on the poses of a data set."""

    hypothesis: Hypothesis
    columns: np.ndarray
    """(N, 6, p) derivative of the readings [m, rad] by each parameter."""
    scale: np.ndarray
    """(p,) [SI] usual size of each parameter."""
    low: np.ndarray
    high: np.ndarray
    """(p,) [SI] physical range."""
    search: Search = NOT_SEARCHED
    """What it costs that it was searched for, where it was."""

    @classmethod
    def of(cls, hypothesis: Hypothesis, point: Point) -> Candidate:
        """The candidate of a hypothesis: its derivatives at the poses of a point."""
        scale = hypothesis.scale(point.model)
        low, high = np.full(len(scale), -np.inf), np.full(len(scale), np.inf)
        if hypothesis.effect is not None:
            parameters = hypothesis.effect.parameters
            low, high = np.array([p.low for p in parameters]), np.array([p.high for p in parameters])
        return cls(hypothesis, hypothesis.columns(point), scale, low, high)

    @property
    def name(self) -> str:
        """The hypothesis' name, which variants of an effect share."""
        return self.hypothesis.name

    @property
    def spec(self) -> str:
        """How a command line names it."""
        return self.hypothesis.spec

    @property
    def effect(self) -> Effect | None:
        """None where it is about the geometry."""
        return self.hypothesis.effect

    @property
    def limit(self) -> np.ndarray:
        """(p,) [SI] largest possible size; LARGE usual sizes where no physical range is stated."""
        furthest = np.maximum(np.abs(self.low), np.abs(self.high))
        return np.where(np.isfinite(furthest), furthest, LARGE * self.scale)


@dataclass(frozen=True)
class Unavailable:
    """An effect that these data or this robot cannot speak about, and why."""

    name: str
    why: str


def candidates(
    point: Point, own: Sequence[Effect] = (), scan: Callable[[], list[tuple[GearRipple, Search]]] | None = None
) -> tuple[list[Candidate], list[Unavailable]]:
    """All effects, then all geometry levels, that the model lacks and that these poses may show.

    Args:
        own: the user's own effects.
        scan: finds the gear ripples to consider, and says what the search costs, where the robot file names no cycles.
    """
    model, at = point.model, point.situation
    robot = model.robot
    present = {fitted.effect.name: fitted.effect for fitted in model.effects}
    found: list[Candidate] = []
    unavailable: list[Unavailable] = []
    for name in effects.names():
        kind = effects.get(name)
        if why := kind.unsuited(robot.mechanism):
            unavailable.append(Unavailable(name, why))
            continue
        if lacking := effects.missing(kind if not kind.needs else effects.get(name, None, robot), at.columns):
            unavailable.append(Unavailable(name, f"the data have no {' '.join(lacking)}"))
            continue
        if name == "gear_ripple" and scan is not None and not robot.drive.get("ripple_per_turn"):
            if name not in present:
                found += [replace(_of(effect, point), search=search) for effect, search in scan()]
            continue
        for per in kind.variants:
            effect = effects.get(name, per, robot)
            if name in present and len(present[name].parameters) >= len(effect.parameters):
                continue
            found.append(_of(effect, point))
    for effect in own:
        if effect.name in present:
            continue
        if lacking := effects.missing(effect, at.columns):
            unavailable.append(Unavailable(effect.name, f"the data have no {' '.join(lacking)}"))
            continue
        found.append(_of(effect, point))
    idle = {c.name: c.effect for c in found if c.effect is not None and not c.columns.any()}
    unavailable += [Unavailable(name, _why_idle(effect, point)) for name, effect in idle.items()]
    levels = [Candidate.of(Hypothesis.level(name, model), point) for name in richer_levels(model)]
    return [c for c in found if c.columns.any()] + levels, unavailable


def require_seen(effect: Effect, point: Point) -> None:
    """Refuse an effect that moves nothing on these poses: its size would be zero whatever it is.

    Raises:
        EffectError: it says why, and what would show it.
    """
    if not _of(effect, point).columns.any():
        why = f"{_why_idle(effect, point)}\n  {shown_by(effect)}"
        raise EffectError(f"effect {effect.name} cannot be fitted to these data: {why}")


def _of(effect: Effect, point: Point) -> Candidate:
    return Candidate.of(Hypothesis.of(effect), point)


def _why_idle(effect: Effect, point: Point) -> str:
    """Why an effect moves nothing on these poses: because nothing in the model gives way, or because nothing loads the
    robot."""
    if effect.indirect and not {f.effect.name for f in point.model.effects} - {effect.name}:
        return ALONE
    at = point.situation
    if any(point.model.robot.mass.values()) or at.payload.any():
        return IDLE
    loaded = replace(point, situation=replace(at, payload=np.ones(len(at))).under(at.g))
    return WEIGHTLESS if Hypothesis.of(effect).columns(loaded).any() else IDLE


def shown_by(effect: Effect | None) -> str:
    """What the data must vary for an effect to be seen, as a remedy."""
    wants = () if effect is None else effect.wants
    return f"it is seen best with: {', '.join(wants)}" if wants else "measure under conditions that show it"
