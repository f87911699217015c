"""Omnibus patterns: smooth functions of what was recorded, in every channel a robot can err in.

They name no cause. They tell where a model fails (the heat map), and they keep a diagnosis honest: an effect is
adequate only where no pattern improves on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.adequacy import corrected
from pcalib.diagnosis.point import Point, Response
from pcalib.diagnosis.screen import NOT_SEARCHED, Screen, Search
from pcalib.diagnosis.searched import Break
from pcalib.effects.base import Contribution, Situation

CHANNELS = {
    "actuator": "motor angles",
    "parallelogram": "rods of a pair against each other",
    "rod": "rod lengths",
    "body": "the plate as a whole",
    "tool": "the tool on the plate",
}
"""Channel → how it is called in a sentence."""
SLIDING = {"actuator": "motor positions"}
"""How channels are called instead where actuator values are lengths."""
HIGHEST = 4
"""Degree of the richest patterns."""
HOT = 0.05
"""Corrected p below which a cell of the map counts as hot."""
FLAT = 0.05
"""Share of the largest extent below which a place does not vary along an axis: the heights at which a probe touches a
bed are all alike but for the noise, of which a variable must know nothing."""
STEADY = 1e-2
"""Share of its size by which a load must vary over the poses to be a variable."""
BREAKS = {"step": "a step", "slope": "a change of slope"}
"""Shape of a break → variable of its cell."""
FINE = "q, in fine waves"
"""Variable of errors that go up and down many times over the range of a motor."""
BY_POSE = {"q", "place", FINE}
"""Variables that follow from the commands alone."""


@dataclass(frozen=True)
class Pattern:
    """One cell of the map: a channel as a smooth function of a variable."""

    channel: str
    variable: str
    columns: np.ndarray
    """(N, 6, p) derivative of the readings [m, rad] by each coefficient, whose unit size is `size`."""
    size: float
    """[rad or m] usual deviation in this channel, the scale of the coefficients."""
    search: Search = NOT_SEARCHED
    """How it was found, where it was searched for."""
    sliding: bool = False
    """Whether actuator values are lengths."""
    found: Break | None = None
    """The step or change of slope that the pattern describes; None for other patterns."""


@dataclass(frozen=True)
class Cell:
    """What the data say about one pattern."""

    channel: str
    variable: str
    p: float
    """Corrected for everything that was looked at."""
    s: float
    """Norm of what it could take up, noise units."""
    d: int
    """Columns."""
    sliding: bool = False
    """Whether actuator values are lengths."""
    found: Break | None = None
    """The step or change of slope of the pattern; None for other patterns."""
    theta: np.ndarray | None = None
    """(p,) [SI] size of that break, fitted alone."""
    s_left: float = 0.0
    """Norm of what it takes up beside the hottest group, noise units."""
    p_left: float = 0.0
    """p of that, corrected as `p` is."""


def cells(patterns: Sequence[Pattern], first: int, screen: Screen, p: np.ndarray, null: np.ndarray) -> tuple[Cell, ...]:
    """The map of a screen whose groups from `first` on are the patterns, hottest cell first.

    Args:
        p: (G,) single p values of the screen's groups.
        null: (n,) smallest p of noise draws, ascending.
    """
    order = sorted(range(len(patterns)), key=lambda i: p[first + i])
    taken = np.array([float(np.sum((b.T @ screen.y) ** 2)) for b in screen.blocks])
    worth = np.where(screen.visible > 0, taken - screen.visible * np.log(max(len(screen.residual), 2)), -np.inf)
    hottest = [int(np.argmax(worth))] if len(worth) and worth.max() > 0 else []
    beside = screen.allowing(hottest)
    left = np.array([float(np.sum((b.T @ screen.y) ** 2)) for b in beside])
    d_left = np.array([b.shape[1] for b in beside])
    p_left = np.where(d_left > 0, screen.p_value(left, np.maximum(d_left, 1)), 1.0)
    return tuple(
        Cell(
            patterns[i].channel,
            patterns[i].variable,
            float(corrected(p[first + i], null)),
            float(np.linalg.norm(screen.blocks[first + i].T @ screen.y)),
            int(screen.visible[first + i]),
            patterns[i].sliding,
            patterns[i].found,
            screen.estimate([first + i])[0][0] if patterns[i].found else None,
            float(np.sqrt(left[first + i])),
            float(corrected(p_left[first + i], null)),
        )
        for i in order
    )


def spoken(channel: str, sliding: bool) -> str:
    """How a channel is called in a sentence; `sliding` where actuator values are lengths."""
    return {**CHANNELS, **(SLIDING if sliding else {})}.get(channel, channel)


def load_name(sliding: bool) -> str:
    """How the load of an actuator is called: the variable that `Situation.torque` holds."""
    return "drive force" if sliding else "torque"


def legendre(values: np.ndarray, low: int, high: int) -> np.ndarray:
    """Legendre polynomials of degree low … high over the range of `values` (...); (..., high − low + 1).

    As few as the number of distinct values allows; none where the values are all alike.
    """
    known = values[np.isfinite(values)]
    distinct = len(np.unique(np.round(known, 9)))
    high = min(high, distinct - 1)
    if high < low:
        return np.zeros((*values.shape, 0))
    lowest, highest = known.min(), known.max()
    x = np.nan_to_num((2 * values - lowest - highest) / (highest - lowest))
    return np.polynomial.legendre.legvander(x, high)[..., low:]


def patterns(point: Point, budget: int, total: int, seen: np.ndarray | None = None) -> list[Pattern]:
    """All cells that the data can fill.

    Args:
        budget: largest number of columns of one cell.
        total: largest number of columns of all. Every cell is there at degree 1 as long as there is room, the first
            before the last; what room is left then raises their degrees up to 4, by turns and in the same order.
        seen: (6,) bool, which motions of the measured body show at all; all where absent.
    """
    sliding = point.situation.robot.mechanism.actuator_dimension == "length"
    cells = list(_cells(point, point.response(), np.ones(6, bool) if seen is None else seen))
    columns = [np.zeros((len(point.situation), 6, 0))] * len(cells)
    used = 0
    for degree in range(1, HIGHEST + 1):
        for i, (_, _, build) in enumerate(cells):
            if degree > 1 and not columns[i].shape[-1]:
                continue  # there was no room for its simplest form
            larger = build(degree)
            more = larger.shape[-1] - columns[i].shape[-1]
            if larger.shape[-1] <= budget and used + more <= max(total, budget):
                columns[i], used = larger, used + more
    return [
        Pattern(channel, variable, found, _SIZE[channel], sliding=sliding)
        for (channel, variable, _), found in zip(cells, columns, strict=True)
        if found.shape[-1]
    ]


def ripple(point: Point, cycles: int, search: Search) -> Pattern:
    """Motor angles that err in waves of some cycles per turn, the best that was found: no polynomial describes them."""
    q = point.situation.q
    waves = [np.stack([np.sin(cycles * angle), np.cos(cycles * angle)], axis=-1) for angle in q.T]
    columns = _each(point.response().actuator, lambda i: waves[i])
    return Pattern("actuator", FINE, columns, _SIZE["actuator"], search)


def broken(found: Break, point: Point) -> Pattern:
    """A step or a change of slope as a pattern."""
    sliding = point.situation.robot.mechanism.actuator_dimension == "length"
    return Pattern(
        found.channel, BREAKS[found.shape], found.columns, _SIZE[found.channel], found.search, sliding, found
    )


_SIZE = {"actuator": 3e-4, "parallelogram": 1e-4, "rod": 1e-4, "body": 1e-4, "tool": 3e-4}


def _cells(point: Point, response: Response, seen: np.ndarray) -> Iterator:
    """(channel, variable, degree → columns) of every cell."""
    at = point.situation
    actuators, rods = response.actuator, response.rod
    mechanism = at.robot.mechanism
    arm = mechanism.actuator
    direction = at.directions()

    def shared(response: np.ndarray, values: np.ndarray, less: int):
        """Every place of a channel by one variable (N,)."""
        return lambda degree: _each(response, lambda i: legendre(values, 1, max(1, degree - less)))

    def products(response: np.ndarray, factors: np.ndarray):
        """Every place of a channel by given functions (N, F)."""
        return lambda degree: _each(response, lambda i: factors)

    yield "actuator", "q", lambda degree: _each(actuators, lambda i: legendre(at.q[:, i], 1, degree + 1))
    load = load_name(mechanism.actuator_dimension == "length")
    yield "actuator", load, lambda degree: _each(actuators, lambda i: legendre(_load(at.torque[:, i]), 1, degree))
    if np.any(direction):
        sided = np.stack([direction, direction * np.abs(at.torque) / (np.abs(at.torque).mean() + 1e-12)], axis=-1)
        yield "actuator", "direction", lambda degree: _each(actuators, lambda i: sided[:, i])
    pair = _pairs(rods, arm)
    if pair is not None:
        yield "parallelogram", "q", lambda degree: _each(pair, lambda i: legendre(at.q[:, i], 1, degree))
    yield (
        "rod",
        "tension",
        lambda degree: _each(rods, lambda r: legendre(_load(at.tension[:, r]), 1, max(1, degree - 1))),
    )
    yield "rod", "sign of the rod force", lambda degree: _each(rods, lambda r: _sides(at.tension[:, r]))
    body = point.rigid()[:, :, seen]
    place = point.prediction.pose.x
    yield "body", "place", lambda degree: _each(body, lambda i: _place(place, 2 if degree > 2 else 1))
    if np.any(direction):
        yield "body", "direction", products(body, direction)
    turn = _lever(point)
    for variable, values in recorded(at).items():
        less = 1 if variable == "time" else 2  # degrees below that of angles: what is recorded acts smoothly
        yield "body", variable, shared(body, values, less)
        if variable.startswith("tool"):
            continue  # to the robot itself a tool is a load, and shows in torques and tensions
        yield "actuator", variable, shared(actuators, values, less)
        if pair is not None:
            yield "parallelogram", variable, shared(pair, values, less)
        if turn is not None and variable in ("payload", "time"):
            yield "tool", variable, shared(turn, values, less)
    if np.ptp(at.payload) > 0:
        loaded = at.payload[:, None] / at.payload.max()
        # With a payload the plate may sink by place, and each motor by its angle.
        yield "body", "payload × place", products(body, loaded * _place(place, 1))
        yield "actuator", "payload × q", lambda degree: _each(actuators, lambda i: loaded * legendre(at.q[:, i], 0, 2))
        yield (
            "actuator", "payload × place",
            lambda degree: _each(actuators, lambda i: loaded * _place(place, 2 if degree > 2 else 1)),
        )  # fmt: skip


def recorded(at: Situation) -> Mapping[str, np.ndarray]:
    """Variables recorded once per pose that take more than one value, each content once, (N,) by name."""
    named = {"payload": at.payload} | {c: v for c, v in at.columns.items() if not c.startswith("dir")}
    if {"temp_arms", "temp_rods", "temp_base"} & named.keys():
        named.pop("temp", None)
    for axis, name in enumerate(("tool x", "tool y", "tool length")):
        named[name] = at.tool[:, axis]
    out: dict[str, np.ndarray] = {}
    for name, values in named.items():
        if not np.isfinite(values).all() or np.ptp(values) <= 1e-9 * max(1.0, np.abs(values).max()):
            continue
        same = [n for n, v in out.items() if abs(np.corrcoef(v, values)[0, 1]) > 1 - 1e-9]
        if same and same[0].startswith("temp_") and name.startswith("temp_"):
            out["temperature"] = out.pop(same[0])
        elif not same:
            out[name] = values
    return out


def _lever(point: Point) -> np.ndarray | None:
    """(N, 6, 3) response to turns of the tool on the plate; None where all rows have one tool, which hides them."""
    tool = point.situation.tool
    if not np.ptp(tool, axis=0).any():
        return None
    return point.columns([Contribution(tool=np.cross(axis, tool)) for axis in np.eye(3)])


def _each(response: np.ndarray, functions) -> np.ndarray:
    """Columns (N, 6, Σ) of every place of a channel times functions (N, F) of it."""
    parts = [response[:, :, i, None] * functions(i)[:, None, :] for i in range(response.shape[-1])]
    return np.concatenate(parts, axis=-1)


def _pairs(rods: np.ndarray, arm: np.ndarray) -> np.ndarray | None:
    """Response of every arm's two rods against each other; None where arms have no pairs."""
    each = [np.flatnonzero(arm == i) for i in range(arm.max() + 1)]
    if any(len(r) != 2 for r in each):
        return None
    return np.stack([rods[:, :, r[0]] - rods[:, :, r[1]] for r in each], axis=-1)


def _load(values: np.ndarray) -> np.ndarray:
    """A load (N,); nothing where it hardly varies, because its rounding would then be the variable."""
    return values if np.ptp(values) > STEADY * np.abs(values).max(initial=0.0) else np.zeros(len(values))


def _sides(tension: np.ndarray) -> np.ndarray:
    """sign T as one column; none where it never changes."""
    sign = np.sign(tension)[:, None]
    return sign if np.ptp(sign) > 0 else sign[:, :0]


def varies(x: np.ndarray) -> np.ndarray:
    """(3,) bool, the axes along which places x (N, 3) [m] vary by more than noise makes them."""
    extent = np.ptp(x, axis=0)
    return extent > FLAT * extent.max()


def _place(x: np.ndarray, degree: int) -> np.ndarray:
    """Polynomials (N, F) of the place up to a degree, scaled to its extent, by the axes along which it varies."""
    x = x[:, varies(x)]
    if not x.shape[1]:
        return np.zeros((len(x), 0))
    u = (x - 0.5 * (x.max(axis=0) + x.min(axis=0))) / (0.5 * np.ptp(x, axis=0))
    out = [u]
    if degree > 1:
        out += [u[:, i : i + 1] * u[:, i:] for i in range(u.shape[1])]
    return np.hstack(out)
