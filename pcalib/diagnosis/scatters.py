"""One cell of the map, reading by reading: what a channel seems to be off by, against a variable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.patterns import BREAKS, FINE, load_name, recorded
from pcalib.diagnosis.problem import Problem
from pcalib.effects.base import Situation
from pcalib.fitting import memory as memories

BY = " × "
"""Between the factors of a variable that is a product."""


@dataclass(frozen=True)
class Scatter:
    """Points of one cell, in series."""

    channel: str
    variable: str
    x: np.ndarray
    """(n,) in `unit`."""
    y: np.ndarray
    """(n,) [rad or m] apparent error."""
    series: np.ndarray
    """(n,) int, place in `names`."""
    names: tuple[str, ...]
    axis: str
    """The variable of x with its unit."""
    angle: bool
    """Whether y is an angle."""


def scatter(made: Problem, error: np.ndarray, channel: str, variable: str) -> Scatter | None:
    """The points of a cell; None where no reading tells the channel by itself.

    Motors and rods show what they would have to be off by to explain a pose's residuals; the plate and the tool show
    the residuals of positions as they are, component by component. Of a product such as payload × place, the second
    factor is the axis, and rows are two series by the first.

    Args:
        error: (N, 6) measured − predicted [m, rad] of the rows of the problem.
    """
    mechanism = made.model.robot.mechanism
    sliding = mechanism.actuator_dimension == "length"
    if channel in ("actuator", "rod", "parallelogram"):
        own = "rod" if channel == "parallelogram" else channel
        found = apparent(made, error, own)
        if found is None:
            return None
        y, full = found
        names = mechanism.actuators if channel == "actuator" else mechanism.rods
        if channel == "parallelogram":
            pairs = [np.flatnonzero(mechanism.actuator == i) for i in range(mechanism.actuator.max() + 1)]
            y = np.stack([0.5 * (y[:, a] - y[:, b]) for a, b in pairs], axis=1)
            names = tuple(f"pair {i + 1}" for i in range(len(pairs)))
    else:
        y, names = error[:, :3], ("x", "y", "z")
        full = np.isfinite(y).all(axis=1)
        y = y[full]
    first, _, last = variable.rpartition(BY)
    axis = _axis(made, last, channel, len(names))
    if axis is None or not len(y):
        return None
    x, label = axis
    series = np.tile(np.arange(len(names)), len(y))
    if first:
        value = _axis(made, first, "body", 1)
        if value is None:
            return None
        high = value[0][full, 0] > np.median(value[0][full, 0])
        series, names = np.repeat(high.astype(int), len(names)), (f"small {first}", f"large {first}")
    angle = channel == "actuator" and not sliding
    return Scatter(channel, variable, x[full].ravel(), y.ravel(), series, tuple(names), label, angle)


def apparent(made: Problem, error: np.ndarray, channel: str) -> tuple[np.ndarray, np.ndarray] | None:
    """What each actuator or rod would have to be off by to explain a row's residuals, (n, places) [rad or m], and (N,)
    which rows determine it: those with as many readings as places. None where no row does.

    Args:
        error: (N, 6) measured − predicted [m, rad].
        channel: 'actuator' or 'rod'.
    """
    G = getattr(made.point.response(), channel)
    seen = made.data.mask & np.isfinite(error)
    full = seen.sum(axis=1) >= G.shape[-1]
    if not full.any():
        return None
    weight = np.where(seen, 1.0 / made.data.sigma, 0.0)
    off = (np.linalg.pinv(G * weight[..., None]) @ (np.nan_to_num(error) * weight)[..., None])[..., 0]
    return off[full], full


def values_of(at: Situation, variable: str, channel: str) -> np.ndarray | None:
    """(N, places) values of a variable at every arm or rod; None for those that are no number a row."""
    n = at.q.shape[1] if channel == "actuator" else at.tension.shape[1]
    sliding = at.robot.mechanism.actuator_dimension == "length"
    if channel == "actuator":
        own = {"q": at.q, FINE: at.q, load_name(sliding): at.torque, "direction": at.directions()}
    else:
        own = {"tension": at.tension, "sign of the rod force": at.tension}
    if variable in own:
        return own[variable]
    values = recorded(at).get(variable)
    return None if values is None else np.repeat(np.asarray(values, float)[:, None], n, axis=1)


def axis_of(variable: str, sliding: bool) -> tuple[float, str]:
    """Factor from SI, and the variable with its unit as people write it."""
    q = (1e3, "mm") if sliding else (180 / np.pi, "°")
    units = {
        "q": q, FINE: q, "torque": (1, "N·m"), "drive force": (1, "N"), "tension": (1, "N"), "payload": (1, "kg"),
        "time": (1 / 3600, "h"), "place": (1e3, "mm"), "tool x": (1e3, "mm"), "tool y": (1e3, "mm"),
        "tool length": (1e3, "mm"),
    }  # fmt: skip
    factor, unit = units.get(variable, (1.0, "°C" if variable.startswith("temp") else ""))
    said = {"place": "height z of the plate", FINE: "q"}.get(variable, variable.replace("temp_", "temperature of "))
    return factor, f"{said} [{unit}]" if unit else said


def _axis(made: Problem, variable: str, channel: str, places: int) -> tuple[np.ndarray, str] | None:
    """(N, places) values in the unit of the label, and the label."""
    at = made.point.situation
    factor, label = axis_of(variable, at.robot.mechanism.actuator_dimension == "length")
    if variable in BREAKS.values():
        time = memories.time_of(made.data)
        return np.repeat(time[:, None], places, axis=1), "time [s], or line"
    if variable == "place":
        return factor * np.repeat(made.point.prediction.pose.x[:, 2:], places, axis=1), label
    values = values_of(at, variable, channel if channel in ("actuator", "rod") else "actuator")
    if values is None:
        return None
    if values.shape[1] != places:  # one value a row, or one a drive, for the places of another channel
        values = np.repeat(values[:, :1], places, axis=1) if np.ptp(values, axis=1).max() == 0 else None
    return None if values is None else (factor * values, label)
