"""What a fit solves for: geometry, effects, measuring frame and the sensors' set-up, as one scaled vector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcalib.errors import InputError, unknown
from pcalib.fitting.identifiability import PRIOR
from pcalib.mechanics.mechanism import Level
from pcalib.model import FittedEffect, Frame, Model

EFFECT_PRIOR_WIDTH = 3.0
"""Effects are held by 3× what is usual: loose enough not to shrink what data can see."""
_FRAME_SCALE = 1e-3
_TURN_PRIOR = 1.0
"""[rad] Prior 1σ of the tracked body's turn about its registered value. No reading determines it in levels that leave
rotations out; elsewhere the readings outweigh this prior by far."""


@dataclass(frozen=True)
class Unknowns:
    """What a fit solves for, in order: level coordinates, effect parameters, frame, set-up of the sensors."""

    level: Level
    keep: np.ndarray
    """(nz,) bool: level columns that are free."""
    prior: np.ndarray
    """(n,) 1σ of every unknown; inf where there is none."""
    scale: np.ndarray
    """(n,) natural size of every unknown, finite."""
    lower: np.ndarray
    upper: np.ndarray
    """(n,) bounds on the change from nominal (from zero for effects)."""
    names: tuple[str, ...]
    n_geometry: int
    n_effects: int
    n_frame: int
    n_setup: int = 0

    @cached_property
    def basis(self) -> np.ndarray:
        """(nk, n_geometry) free directions of the level."""
        return self.level.basis[:, self.keep]

    def coordinates(self, errors: np.ndarray) -> np.ndarray:
        """Free level coordinates (n_geometry,) of raw geometric errors (nk,)."""
        return self.level.coordinates(errors)[self.keep]

    @property
    def n_registration(self) -> int:
        """Unknowns of frame and set-up that readings take up: the target's place is held by its prior."""
        return max(self.n_frame - 3, 0) + self.n_setup

    @cached_property
    def bounded(self) -> bool:
        """Whether any unknown has a bound."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())


def level_of(model: Model, name: str) -> Level:
    """The level of that name of the model's robot.

    Raises:
        InputError: there is none.
    """
    levels = model.robot.mechanism.levels
    if name not in levels:
        raise InputError(unknown("level", name, levels))
    return levels[name]


def unknowns_of(
    model: Model,
    level: str,
    effects: Sequence[FittedEffect] = (),
    frame: bool = False,
    fixed: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior: Mapping[str, float] | None = None,
    flat: bool = False,
) -> Unknowns:
    """The unknowns of a fit.

    Args:
        fixed: names of level columns held where the start has them: at nominal, or as in the model given.
        bounds: name → (low, high) of the change from nominal [SI].
        prior: 1σ by unit ('m', 'rad', '1') or by parameter name; manufacturing tolerances elsewhere.
        flat: no priors but those of the set-up and of the target's place, which a robot that hardly turns cannot tell
            from the frame's.
    """
    chosen = level_of(model, level)
    prior, bounds, fixed = dict(prior or {}), dict(bounds or {}), set(fixed)
    for name in [*fixed, *bounds, *(p for p in prior if p not in PRIOR)]:
        if name not in chosen.columns:
            raise InputError(unknown(f"parameter of level {level}", name, chosen.columns))
    if both := sorted(fixed & set(bounds)):
        raise InputError(f"{', '.join(both)}: both fixed and bounded", remedy="name each in one of --fix and --bound")
    keep = np.array([c not in fixed for c in chosen.columns], bool)
    names = [c for c in chosen.columns if c not in fixed]
    sizes = [
        prior.get(c, prior.get(u, PRIOR[u])) for c, u, k in zip(chosen.columns, chosen.units, keep, strict=True) if k
    ]
    n_geometry = len(names)
    for fitted in effects:
        for p in fitted.effect.parameters:
            names.append(f"{fitted.effect.name}.{p.name}")
            sizes.append(EFFECT_PRIOR_WIDTH * p.prior)
    n_effects = len(names) - n_geometry
    n_frame = 0 if not frame else 9 if model.frame is None else model.frame.unknowns()
    names += [f"{of}.{c}" for of in ("frame", "target") for c in ("x", "y", "z", "rx", "ry", "rz")][:n_frame]
    place = len(names) - n_frame + 6
    names += [name for block in model.setup for name in block.names]
    setup = [float(sigma) for block in model.setup for sigma in block.prior]
    scale = np.array(sizes + [_FRAME_SCALE] * (n_frame + len(setup)))
    free = np.array(sizes + [np.inf] * n_frame + setup)
    if flat:
        free[: n_geometry + n_effects] = np.inf
    if frame:
        free[place : place + 3] = (model.frame or Frame()).sigma_offset
    if n_frame == 12:
        free[place + 3 : place + 6] = _TURN_PRIOR
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for name, (low, high) in bounds.items():
        lower[names.index(name)], upper[names.index(name)] = low, high
    return Unknowns(chosen, keep, free, scale, lower, upper, tuple(names), n_geometry, n_effects, n_frame, len(setup))


def apply(model: Model, unknowns: Unknowns, step: np.ndarray) -> Model:
    """The model after a step (n,) of the unknowns."""
    g, e = unknowns.n_geometry, unknowns.n_effects
    k = model.k + unknowns.basis @ step[:g] if g else model.k
    effects, i = [], g
    for fitted in model.effects:
        n = len(fitted.theta) if e else 0
        effects.append(replace(fitted, theta=fitted.theta + step[i : i + n]) if e else fitted)
        i += n
    frame = model.frame
    if unknowns.n_frame:
        assert frame is not None
        frame = frame.moved(step[g + e : g + e + unknowns.n_frame])
    setup, i = [], g + e + unknowns.n_frame
    for block in model.setup:
        setup.append(block.at(block.theta + step[i : i + len(block.theta)]))
        i += len(block.theta)
    return replace(model, k=k, effects=tuple(effects), frame=frame, setup=tuple(setup))


def current(model: Model, unknowns: Unknowns) -> np.ndarray:
    """(n,) present values of the unknowns: change from nominal, effect values, target offset, set-up;
    the rest of the frame has no absolute value and reads 0."""
    g, e = unknowns.n_geometry, unknowns.n_effects
    values = np.zeros(len(unknowns.names))
    values[:g] = unknowns.coordinates(model.errors)
    if e:
        values[g : g + e] = np.concatenate([f.theta for f in model.effects])
    if unknowns.n_frame:
        assert model.frame is not None
        values[g + e + 6 : g + e + 9] = model.frame.offset
    if unknowns.n_setup:
        values[g + e + unknowns.n_frame :] = np.concatenate([block.theta for block in model.setup])
    return values
