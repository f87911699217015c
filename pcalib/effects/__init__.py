"""The library of physical effects: one file each, found by itself.

A file of this folder that defines ``EFFECT`` is an effect of that file's name; nothing else has to be told about it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from pcalib.effects.base import Contribution, Effect, EffectParameter, Situation
from pcalib.effects.library import LibraryEffect, Places
from pcalib.errors import EffectError, unknown
from pcalib.mechanics.mechanism import Pose
from pcalib.robot import Robot

__all__ = [
    "Contribution",
    "Effect",
    "EffectParameter",
    "Situation",
    "basis",
    "get",
    "missing",
    "names",
    "parse",
    "require",
    "situation",
]


@lru_cache(maxsize=1)
def _library() -> dict[str, type[LibraryEffect]]:
    found = {}
    for module in pkgutil.iter_modules(__path__):
        effect = getattr(importlib.import_module(f"{__name__}.{module.name}"), "EFFECT", None)
        if effect is not None:
            found[module.name] = effect
    return dict(sorted(found.items()))


def names() -> list[str]:
    """The effects of the library."""
    return list(_library())


def get(
    name: str, per: str | None = None, robot: Robot | None = None, cycles: Sequence[int] | None = None
) -> LibraryEffect:
    """An effect of the library, fitted to a robot.

    Args:
        per: 'common', 'arm' or 'rod'; what the effect tries first when absent.
        robot: whose arms and rods separate parameters are counted over; the Delta's when absent.
        cycles: of gear_ripple, per turn; those of the robot file, else 24, when absent.

    Raises:
        EffectError: no such effect or variant, or one that makes no sense on this robot.
    """
    if name not in _library():
        raise EffectError(unknown("effect", name, names()) + "\n  an effect of your own is given as file.py:ClassName")
    kind = _library()[name]
    places = Places() if robot is None else Places.of(robot.mechanism)
    options = {}
    if hasattr(kind, "cycles"):
        wanted = cycles if cycles is not None else (robot.drive.get("ripple_per_turn") if robot is not None else None)
        if wanted is not None:
            options["cycles"] = tuple(int(n) for n in np.atleast_1d(wanted))
    elif cycles is not None:
        raise EffectError(f"effect {name} has no cycles per turn")
    effect = kind(per=per or kind.variants[0], places=places, **options)
    if robot is not None and (why := effect.unsuited(robot.mechanism)):
        raise EffectError(f"effect {name} makes no sense on robot '{robot.name}': {why}")
    return effect


def parse(spec: str, robot: Robot | None = None) -> Effect:
    """An effect as a command line names it: NAME, NAME:arm, NAME:rod, gear_ripple@24, or file.py:ClassName.

    Code is loaded only for a file named here.

    Raises:
        EffectError: it cannot be read that way; the message lists what is accepted.
    """
    if ".py" in spec:
        from pcalib.effects.user import load

        return load(spec, robot)
    text, _, cycles = spec.partition("@")
    name, _, per = text.partition(":")
    try:
        turns = [int(n) for n in cycles.split("+")] if cycles else None
        if turns is not None and min(turns) < 1:
            raise ValueError
    except ValueError:
        problem = f"'{spec}': '{cycles}' is not a list of cycles per turn"
        raise EffectError(f"{problem}\n  write positive whole numbers, e.g. gear_ripple@24+48") from None
    return get(name, per or None, robot, turns)


def missing(effect: Effect, columns: Mapping[str, np.ndarray]) -> list[str]:
    """Columns that an effect needs and the data lack, or have blanks in; `temp` serves for every temperature."""
    out = []
    for name in effect.needs:
        source = "temp" if name.startswith("temp_") and name not in columns and "temp" in columns else name
        if source not in columns or not np.isfinite(columns[source]).all():
            out.append(name)
    return out


def require(effect: Effect, columns: Mapping[str, np.ndarray], source: str | Path) -> None:
    """Refuse a file without the columns that an effect needs.

    Raises:
        EffectError: a column is absent, or has blanks.
    """
    if lacking := missing(effect, columns):
        raise EffectError(
            f"{source}: effect {effect.name} needs columns that the data do not have: {', '.join(lacking)}\n"
            "  add them to the file, with a value in every row"
        )


def basis(effect: Effect, at: Situation, theta: np.ndarray | None = None) -> list[Contribution]:
    """∂(contribution)/∂θ_j as one Contribution per parameter, at theta (zero when absent).

    Exact where the effect is linear; otherwise central differences with steps of 1e-3 prior.
    """
    own = getattr(effect, "basis", None)
    if own is not None:
        return own(at)
    parameters = effect.parameters
    eye = np.eye(len(parameters))
    if getattr(effect, "linear", False):
        return [effect.contribution(at, row) for row in eye]
    zero = np.zeros(len(parameters)) if theta is None else np.asarray(theta, float)
    out = []
    for row, parameter in zip(eye, parameters, strict=True):
        h = 1e-3 * parameter.prior
        plus, minus = effect.contribution(at, zero + h * row), effect.contribution(at, zero - h * row)
        out.append((plus + minus.scaled(-1.0)).scaled(0.5 / h))
    return out


def situation(
    robot: Robot,
    k: np.ndarray,
    q: np.ndarray,
    pose: Pose,
    tool: np.ndarray | float = 0.0,
    payload: np.ndarray | float = 0.0,
    columns: Mapping[str, np.ndarray] | None = None,
    partners: Sequence[tuple[Effect, np.ndarray]] = (),
    position: np.ndarray | None = None,
) -> Situation:
    """What effects see at N poses, with the loads of pcalib's own statics.

    Args:
        tool: (3,) or (N, 3) [m], plate frame.
        payload: scalar or (N,) [kg] at the tool point.
        columns: (N,) arrays in SI by name without unit.
        position: (N, 3) [m] measured point in the measuring frame; the TCP in the base frame when absent.
    """
    from pcalib.mechanics import statics

    q = np.atleast_2d(np.asarray(q, float))
    tool = np.broadcast_to(np.asarray(tool, float), pose.x.shape)
    payload = np.broadcast_to(np.asarray(payload, float), (len(q),))
    loads = statics.loads(robot, k, q, pose, tool, payload)
    return Situation(
        robot=robot, q=q, pose=pose, rods=loads.rods, arms=loads.levers, tension=loads.tension, torque=loads.torque,
        tool=tool, payload=payload, columns=dict(columns or {}), k=k, position=position, partners=tuple(partners),
    )  # fmt: skip
