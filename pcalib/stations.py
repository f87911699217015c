"""Where to put stations and what to measure from them, for sensors that read no pose.

Such readings say nothing of where the base stands, and some of their rows only say where a station is. So rows are not
chosen D-optimally but for what they are wanted for (L-optimal design, Fedorov 1972, chapter 2.9): that the TCP with the
longest tool at hand is known best over the workspace, beside a rigid motion of all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pcalib import planning, prediction, rotation
from pcalib.data.readings import Readings
from pcalib.errors import InputError
from pcalib.fitting.identifiability import priors
from pcalib.fitting.linearisation import viewed
from pcalib.mechanics import kinematics
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot
from pcalib.sensors.base import Block, Sensor

STATIONS = 3
"""Stations of a sensor that measures to several: three balls or more fix where the robot stands among them."""
_TRIED = 60
"""Rows by which a place of a station is judged."""
_AROUND, _RINGS, _HEIGHTS = 8, (0.3, 0.6), (-0.35, 0.0, 0.25, 0.5)
"""Places that are tried: directions, distances from the axis as shares of the workspace's radius, and heights over the
lowest measured point as shares of the longest distance."""
_TARGETS = 60
"""Places at which the TCP is to be known."""


@dataclass(frozen=True)
class Asked:
    """A sensor at hand."""

    sensor: Sensor
    sigma: float
    """[m or rad] 1σ of its readings."""
    reach: tuple[float, float] = (0.0, np.inf)
    """[m] shortest and longest distance that it can measure."""
    places: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Name → (3,) [m] of stations that stand already; chosen where there are none."""


@dataclass(frozen=True)
class Rows:
    """What to measure."""

    q: np.ndarray
    """(n, nq) [rad or m]."""
    tool: np.ndarray
    """(n, 3) [m]."""
    position: np.ndarray
    """(n, 3) [m] measured points of the robot as drawn."""
    to: np.ndarray
    """(n,) str, station of each row; '' where no sensor measures to any."""
    places: Mapping[str, np.ndarray]
    """Name → (3,) [m] of the stations."""
    identified: int
    """Directions of the level that these rows identify, of"""
    unknowns: int


def plan(
    robot: Robot,
    n: int,
    asked: Sequence[Asked],
    *,
    tools: np.ndarray | None = None,
    level: str = "complete",
    candidates: int = 1500,
    seed: int = 0,
    tick: Callable[[float], None] | None = None,
) -> Rows:
    """Poses, tools and stations whose readings tell most about the geometry.

    Args:
        tools: (T, 3) [m] tools at hand.
        tick: called with the share done.

    Raises:
        InputError: too few poses are within reach of the stations, or two sensors that need stations.
    """
    tools = np.zeros((1, 3)) if tools is None else np.atleast_2d(tools)
    rng = np.random.default_rng(seed)
    found = planning.reachable(robot, max(candidates, 4 * n), rng)
    tool = tools[rng.integers(0, len(tools), len(found.q))]
    x = kinematics.forward(robot.mechanism, robot.mechanism.nominal, found.q).pose.tcp(tool)
    there = _There(robot, found.q, tool, x)
    ranging = [one for one in asked if one.sensor.to == "station"]
    if len(ranging) > 1:
        raise InputError("two instruments that measure to stations", remedy="plan for one after the other")
    places: dict[str, np.ndarray] = {}
    to = np.full(len(there.q), "", object)
    if ranging:
        wanted = _wanted(robot, tools, level, np.random.default_rng([seed, 1]))
        places = dict(ranging[0].places) or _placed(there, ranging[0], level, wanted)
        to, inside = _dealt(there.x, places, ranging[0].reach, rng)
        there, to = there.take(inside), to[inside]
        if len(to) < 1.5 * n:
            raise InputError(
                f"only {len(to)} of {len(inside)} poses are within reach of the stations",
                remedy="move the stations closer to the poses, or ask for fewer rows",
            )
    blocks, free = _blocks(there, asked, to, places, level)
    wanted = _wanted(robot, tools, level, np.random.default_rng([seed, 1]))
    order = _best_rows(blocks, np.pad(wanted, ((0, 0), (0, blocks.shape[-1] - free))), n, to, tick)
    J = blocks[order].reshape(-1, blocks.shape[-1])
    seen = np.linalg.svd(_beside(J, free), compute_uv=False)
    chosen = there.take(order)
    return Rows(chosen.q, chosen.tool, chosen.x, to[order], places, int(np.sum(seen > 1e-2)), free)


@dataclass(frozen=True)
class _There:
    """Poses of the robot as drawn."""

    robot: Robot
    q: np.ndarray
    tool: np.ndarray
    x: np.ndarray
    """(C, 3) [m] measured points."""

    def take(self, rows: np.ndarray) -> _There:
        return replace(self, q=self.q[rows], tool=self.tool[rows], x=self.x[rows])


def _dealt(
    x: np.ndarray, places: Mapping[str, np.ndarray], reach: tuple[float, float], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A station (C,) within reach of each pose, by chance where there are several, and whether there is one."""
    names = np.array(list(places), object)
    d = np.linalg.norm(x[:, None] - np.stack([places[name] for name in names]), axis=-1)
    lot = np.where((d >= reach[0]) & (d <= reach[1]), rng.random(d.shape), -1.0)
    return names[np.argmax(lot, axis=1)], lot.max(axis=1) >= 0


def _wanted(robot: Robot, tools: np.ndarray, level: str, rng: np.random.Generator) -> np.ndarray:
    """(nz, nz) L with |L·z|² the mean square [m²] by which errors z, in units of their priors, move the TCP with the
    longest tool over the workspace, beside the rigid motion that takes most of it away."""
    chosen = robot.mechanism.levels[level]
    found = planning.reachable(robot, _TARGETS, rng)
    n = len(found.q)
    tool = np.broadcast_to(tools[int(np.argmax(np.linalg.norm(tools, axis=1)))], (n, 3))
    p = prediction.predict(Model.nominal(robot), found.q, Conditions.of(n, tool))
    at, JX = prediction.closure_of(Model.nominal(robot), p)
    G = prediction.geometry_columns(Model.nominal(robot), p, at, JX, chosen.basis)[:, :3] * priors(chosen.units)
    rigid = np.concatenate([np.tile(np.eye(3), (n, 1, 1)), -rotation.hat(p.position)], axis=-1).reshape(3 * n, 6)
    Q = np.linalg.qr(rigid)[0]
    flat = G.reshape(3 * n, -1)
    return np.linalg.qr(flat - Q @ (Q.T @ flat), mode="r") / np.sqrt(n)


def _best_rows(
    blocks: np.ndarray, wanted: np.ndarray, n: int, to: np.ndarray, tick: Callable[[float], None] | None = None
) -> np.ndarray:
    """Indices of n rows, one after the other the one that brings trace(L·C·Lᵀ) down most, with C = (I + Σ BᵀB)⁻¹.

    Stations (C,) take turns: the first rows to each only say where it is, and would never be chosen by themselves.
    """
    C, eye = np.eye(blocks.shape[-1]), np.eye(blocks.shape[1])
    left, chosen, names = np.ones(len(blocks), bool), [], sorted(set(to))
    for i in range(n):
        free = left & (to == names[i % len(names)])
        free = free if free.any() else left
        BC = blocks @ C
        S = eye + BC @ np.swapaxes(blocks, 1, 2)
        Z = BC @ wanted.T
        gain = np.where(free, np.sum(Z * np.linalg.solve(S, Z), axis=(1, 2)), -np.inf)
        pick = int(np.argmax(gain))
        C = C - BC[pick].T @ np.linalg.solve(S[pick], BC[pick])
        C, left[pick] = 0.5 * (C + C.T), False
        chosen.append(pick)
        if tick:
            tick((i + 1) / n)
    return np.array(chosen)


def _placed(there: _There, asked: Asked, level: str, wanted: np.ndarray) -> dict[str, np.ndarray]:
    """Places for stations, one after the other where it brings most for the TCP beside those before."""
    low, longest = there.x[:, 2].min(), min(asked.reach[1], there.robot.workspace.radius)
    angles = 2 * np.pi * np.arange(_AROUND) / _AROUND
    grid = [
        np.array([share * r * np.cos(a), share * r * np.sin(a), low + height * longest])
        for r in [there.robot.workspace.radius] for share in _RINGS for a in angles for height in _HEIGHTS
    ]  # fmt: skip
    rows: list[np.ndarray] = []
    for place in grid:
        d = np.linalg.norm(there.x - place, axis=1)
        near = np.flatnonzero((d >= asked.reach[0]) & (d <= asked.reach[1]))[:_TRIED]
        some, names = there.take(near), np.full(len(near), "A", object)
        if len(near) < _TRIED // 2:
            rows.append(np.zeros((0, len(wanted))))
        else:
            rows.append(_beside(*_flat(*_blocks(some, [asked], names, {"A": place}, level))))
    M, taken = np.eye(len(wanted)), []
    for _ in range(STATIONS):
        left = [
            np.trace(wanted @ np.linalg.solve(M + r.T @ r, wanted.T)) if i not in taken and len(r) else np.inf
            for i, r in enumerate(rows)
        ]
        if not np.isfinite(min(left)):
            raise InputError(
                "no place for a station is within reach of enough poses", remedy="say where they stand: --station"
            )
        taken.append(int(np.argmin(left)))
        M = M + rows[taken[-1]].T @ rows[taken[-1]]
    return {chr(ord("A") + i): grid[best] for i, best in enumerate(taken)}


def _flat(blocks: np.ndarray, free: int) -> tuple[np.ndarray, int]:
    return blocks.reshape(-1, blocks.shape[-1]), free


def _beside(J: np.ndarray, free: int) -> np.ndarray:
    """The columns of the geometry, the first `free` ones, without what the set-up could take up."""
    own = J[:, free:]
    held = np.vstack([own, np.eye(own.shape[1])])  # its priors
    Q = np.linalg.qr(held)[0]
    G = np.vstack([J[:, :free], np.zeros((own.shape[1], free))])
    return G - Q @ (Q.T @ G)


def _blocks(
    there: _There, asked: Sequence[Asked], to: np.ndarray, places: Mapping[str, np.ndarray], level: str
) -> tuple[np.ndarray, int]:
    """(C, r, n) whitened derivatives of all readings of each pose, by the level's columns and the set-up, scaled by
    priors; and how many of the columns are the level's."""
    robot, n = there.robot, len(there.q)
    chosen = robot.mechanism.levels[level]
    plain = prediction.predict(Model.nominal(robot), there.q, Conditions.of(n, there.tool))
    blocks, setup = [], _setup(asked, places, there)
    model = replace(Model.nominal(robot), setup=setup)
    at, JX = prediction.closure_of(model, plain)
    for one in asked:
        mine = to if one.sensor.to == "station" else np.full(n, "A" if one.sensor.to else "", object)
        readings = Readings(np.full(n, one.sensor.name, object), mine, np.full((n, 6), np.nan))
        p = viewed(model, plain, readings)
        G = prediction.geometry_columns(model, p, at, JX, chosen.basis) * priors(chosen.units)
        S = prediction.setup_columns(p, sum(len(b.theta) for b in setup)) * np.concatenate([b.prior for b in setup])
        seen = [place for place, _ in one.sensor.quantities.values()]
        blocks.append(np.concatenate([G, S], axis=-1)[:, seen] / one.sigma)
    return np.concatenate(blocks, axis=1), len(chosen.columns)


def _setup(asked: Sequence[Asked], places: Mapping[str, np.ndarray], there: _There) -> tuple[Block, ...]:
    """The set-up at values that suit the plan: stations where they stand, a plane below the poses, all else zero."""
    out: dict[str, Block] = {}
    for one in asked:
        names = list(places) if one.sensor.to == "station" else ["A"] if one.sensor.to else [""]
        for name in names:
            for block in one.sensor.blocks(name, {}):
                theta = np.zeros(len(block.parameters))
                if name in places and block.parameters == ("x", "y", "z"):
                    theta = places[name]
                elif "height" in block.parameters:
                    theta[block.parameters.index("height")] = there.x[:, 2].min()
                out.setdefault(block.name, block.at(theta))
    return tuple(out.values())


def metadata(asked: Sequence[Asked], rows: Rows) -> dict[str, str]:
    """Lines of a plan's metadata that a measurement file made of it keeps: σ and about where the stations stand."""
    units = {"length": ("um", 1e-6), "angle": ("urad", 1e-6)}
    out = {}
    for one in asked:
        unit, factor = units[next(iter(one.sensor.quantities.values()))[1]]
        out[f"{one.sensor.sigma}_{unit}"] = f"{one.sigma / factor:.6g}"
    for name, place in rows.places.items():
        out[f"station_{name}_mm"] = " ".join(f"{1e3 * v:.1f}" for v in place)
    return out
