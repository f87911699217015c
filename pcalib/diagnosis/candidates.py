"""What may be missing: effects of the library and of the user's own in all their variants, and geometry levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib import effects, prediction
from pcalib.diagnosis.channels import Point
from pcalib.diagnosis.screen import LARGE, NOT_SEARCHED, Search
from pcalib.effects.base import Effect, Situation
from pcalib.effects.gear_ripple import GearRipple
from pcalib.errors import EffectError
from pcalib.model import Model

ALONE = "add a compliance first: it is seen only through one"
"""Why what acts through others, as a crooked robot does, moves nothing while nothing in the model gives way."""
IDLE = "under these conditions it moves nothing"
WEIGHTLESS = "the robot file has no [mass] and there is no payload: nothing loads the robot"
"""Why an effect of load moves nothing."""


@dataclass(frozen=True)
class Candidate:
    """One hypothesis: an effect in one variant, or a geometry level."""

    name: str
    """The effect's or level's name: variants of an effect share it."""
    spec: str
    """How a command line names this variant."""
    effect: Effect | None
    """None for a geometry level."""
    columns: np.ndarray
    """(N, 6, p) derivative of the readings [m, rad] by each parameter."""
    scale: np.ndarray
    """(p,) [SI] usual size of each parameter."""
    low: np.ndarray
    high: np.ndarray
    """(p,) [SI] physical range."""
    search: Search = NOT_SEARCHED
    """How it was found, where it was searched for."""

    @property
    def limit(self) -> np.ndarray:
        """(p,) [SI] largest possible size; several times the usual one where nothing says what is."""
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
    """All hypotheses on these poses beyond what the model already has.

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
                found += [replace(_candidate(effect, point), search=search) for effect, search in scan()]
            continue
        for per in kind.variants:
            effect = effects.get(name, per, robot)
            if name in present and len(present[name].parameters) >= len(effect.parameters):
                continue
            found.append(_candidate(effect, point))
    for effect in own:
        if effect.name in present:
            continue
        if lacking := effects.missing(effect, at.columns):
            unavailable.append(Unavailable(effect.name, f"the data have no {' '.join(lacking)}"))
            continue
        found.append(_candidate(effect, point))
    idle = {c.name: c.effect for c in found if c.effect is not None and not c.columns.any()}
    unavailable += [Unavailable(name, _why_idle(effect, point)) for name, effect in idle.items()]
    return [c for c in found if c.columns.any()], unavailable


def require_seen(effect: Effect, point: Point) -> None:
    """Refuse an effect that moves nothing on these poses: its size would be zero whatever it is.

    Raises:
        EffectError: it says why, and what would show it.
    """
    if not _candidate(effect, point).columns.any():
        why = f"{_why_idle(effect, point)}\n  {shown_by(effect)}"
        raise EffectError(f"effect {effect.name} cannot be fitted to these data: {why}")


def _why_idle(effect: Effect, point: Point) -> str:
    """Why an effect moves nothing on these poses: for want of partners that it acts through, or of loads, if under some
    it would move something."""
    if effect.indirect and not {f.effect.name for f in point.model.effects} - {effect.name}:
        return ALONE
    at = point.situation
    if any(point.model.robot.mass.values()) or at.payload.any():
        return IDLE
    loaded = replace(at, payload=np.ones(len(at))).under(at.g)
    return WEIGHTLESS if _columns(effect, point, loaded).any() else IDLE


def _columns(effect: Effect, point: Point, at: Situation) -> np.ndarray:
    """(N, 6, p) derivative of the readings by each parameter of an effect, in a situation beside the model's others."""
    partners = tuple((fitted.effect, fitted.theta) for fitted in point.model.effects)
    return point.columns(effect.basis(replace(at, partners=partners)))


def shown_by(effect: Effect | None) -> str:
    """What the data must vary for an effect to be seen, as a remedy."""
    if effect is None or not effect.wants:
        return "measure under conditions that show it"
    return f"it is seen best with: {', '.join(effect.wants)}"


def _candidate(effect: Effect, point: Point) -> Candidate:
    parameters = effect.parameters
    return Candidate(
        name=effect.name,
        spec=effect.spec,
        effect=effect,
        columns=_columns(effect, point, point.situation),
        scale=np.array([p.prior for p in parameters]),
        low=np.array([p.low for p in parameters]),
        high=np.array([p.high for p in parameters]),
    )


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


def level_columns(point: Point, level: str) -> np.ndarray:
    """Derivative of the readings by a level's coordinates, (N, 6, nz)."""
    basis = point.model.robot.mechanism.levels[level].basis
    return prediction.geometry_columns(point.model, point.prediction, point.closure, point.JX, basis)
