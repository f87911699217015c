"""Laws that no one has listed: something deviates as a function of what happens to a robot, row by row.

A seed draws where (channel), which parts (sharing) and of what it is a function: bounded, kinked and periodic
functions, functions with a memory of the rows before, products of two, and two laws at once. :func:`draw` is the whole
of it. None of it comes from a library of effects, nor from the grammar in which laws are searched for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

STREAM = 0x1A3
ALONE, SIMPLE = 0.75, 0.6
"""Shares of the seeds with one law, and of the laws with one factor."""
CHANNELS = {
    "motor": ("actuator", 1e-4), "rod": ("rod", 2e-5), "pair": ("actuator", 2e-5), "elbow": ("rod", 2e-5),
    "plate_anchor": ("rod", 2e-5), "tool_point": ("axis", 5e-5), "tool_turn": ("axis", 2e-4),
    "base_shift": ("axis", 3e-5), "base_turn": ("axis", 5e-5),
}  # fmt: skip
"""Channel → its places, and the usual size of a deviation [m or rad]."""
LATE = ("motor", "rod", "pair")
"""Channels that may depend on loads and on where the plate stands, which are known once a row has been solved."""
RECORDED = {"payload": 2.0, "time": 3600.0, "temp_arms": 6.0, "temp_rods": 6.0, "temp_base": 6.0, "tool": 0.2}
"""Variable → change [SI] that is a usual one."""
LOADS = {"actuator": 10.0, "rod": 20.0}
"""[N·m, N] usual loads of a motor and of a rod."""


@dataclass(frozen=True)
class Term:
    """One factor: a shape of one variable, which is of the order of one."""

    variable: str
    """'q', 'neighbour', 'load', 'x', 'y', 'z', 'direction', a recorded column, or 'play' and 'fading': with memory."""
    shape: str
    first: float
    """First number of the shape: slope, threshold or cycles per turn."""
    second: float
    """Second number of the shape: phase or place."""

    def of(self, u: np.ndarray) -> np.ndarray:
        """Return the factor, shape of u, at values u of the variable; u is of the order of one."""
        return SHAPES[self.shape](u, self.first, self.second)

    @property
    def words(self) -> str:
        """As a table has it."""
        return f"{self.shape}({self.variable}, {self.first:.2g}, {self.second:.2g})"


SHAPES: Mapping[str, Callable[[np.ndarray, float, float], np.ndarray]] = {
    "linear": lambda u, a, b: u,
    "square": lambda u, a, b: u**2,
    "cube": lambda u, a, b: u**3,
    "absolute": lambda u, a, b: np.abs(u - 0.5 * b),
    "kink": lambda u, a, b: np.maximum(u - 0.5 * b, 0.0),
    "saturated": lambda u, a, b: np.tanh(a * u),
    "dead_zone": lambda u, a, b: u - np.clip(u, -0.3, 0.3),
    "sigmoid": lambda u, a, b: 1.0 / (1.0 + np.exp(-8.0 * (u - 0.5 * b))),
    "gaussian": lambda u, a, b: np.exp(-0.5 * ((u - b) * 2.0 * a) ** 2),
    "wave": lambda u, a, b: np.sin(6.0 * a * u + np.pi * b),
    "step": lambda u, a, b: np.where(u > 0.5 * b, 1.0, 0.0),
    "settling": lambda u, a, b: 1.0 - np.exp(-3.0 * a * np.abs(u)),
}  # fmt: skip


PLAIN = {
    "q": "linear square cube wave", "neighbour": "linear", "direction": "linear", "payload": "linear square",
    "time": "linear square step settling", "temp_arms": "linear square", "temp_rods": "linear square",
    "temp_base": "linear square", "load": "linear absolute saturated", "x": "linear square", "y": "linear square",
    "z": "linear square",
}  # fmt: skip
"""Variable → shapes that a short list of laws would have: those on which a search is asked for the right one."""


@dataclass(frozen=True)
class Law:
    """A deviation: amplitudes per place times a product of terms."""

    channel: str
    sharing: str
    """'common', 'each' (every place has an amplitude of its own) or 'one' (one place alone)."""
    amplitude: np.ndarray
    """(places,) [m or rad]."""
    terms: tuple[Term, ...]

    @property
    def words(self) -> str:
        """As a table has it."""
        return f"{self.channel}: {' × '.join(term.words for term in self.terms)}"

    def deviation(self, known: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return (places,) [m or rad] from the variables' values, each a number or one per place."""
        out = self.amplitude
        for term in self.terms:
            out = out * term.of(known[term.variable])
        return out


def draw(counts: Mapping[str, int], seed: int, plain: bool = False) -> tuple[Law, ...]:
    """Return the law, or the two laws, of a seed, for a robot with so many actuators, rods and axes.

    Args:
        plain: one law with one factor of PLAIN.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
    count = 1 if plain or rng.random() < ALONE else 2
    return tuple(_law(counts, rng, plain) for _ in range(count))


def _law(counts: Mapping[str, int], rng: np.random.Generator, plain: bool) -> Law:
    channel = str(rng.choice(list(CHANNELS)))
    places, size = CHANNELS[channel]
    n = counts[places]
    sharing = str(rng.choice(["common", "each", "one"] if places != "axis" else ["each", "one"]))
    amplitude = size * rng.choice([-1.0, 1.0]) * np.ones(n)
    if sharing == "each":
        amplitude = size * rng.standard_normal(n)
    elif sharing == "one":
        amplitude = amplitude * (np.arange(n) == rng.integers(n))
    own = ["fading"] if places == "axis" else ["q", "q", "q", "neighbour", "play"]
    late = ["load", "load", "x", "y", "z"] if channel in LATE else []
    variables = [*RECORDED, "direction", *own, *late]
    if plain:
        terms = (_term([v for v in variables if v in PLAIN], rng, PLAIN),)
    else:
        terms = tuple(_term(variables, rng) for _ in range(1 if rng.random() < SIMPLE else 2))
    return Law(channel, sharing, amplitude, terms)


def _term(variables: list[str], rng: np.random.Generator, of: Mapping[str, str] | None = None) -> Term:
    variable = str(rng.choice(variables))
    shapes = list(SHAPES) if of is None else of[variable].split()
    shape = "linear" if variable in ("direction", "play", "fading") else str(rng.choice(shapes))
    return Term(variable, shape, float(np.exp(rng.uniform(np.log(0.5), np.log(6.0)))), float(rng.uniform(-1, 1)))
