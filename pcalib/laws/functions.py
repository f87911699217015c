"""What a law may be a function of, and which functions: one line of `VARIABLES` or `SHAPES` each.

A variable is something that was recorded or that the model knows at the command: never a residual. A shape is a
dimensionless function of one variable, or of the product of two, scaled to about one over the data, so that the
amplitude of a law has the unit of its channel. Every entry has its text, from which law files are written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pcalib.diagnosis.patterns import STEADY, varies
from pcalib.effects.base import Situation


@dataclass(frozen=True)
class Variable:
    """Something that a law may depend on."""

    name: str
    """Key in JSON: q, torque, tension, dir, x, y, z, or a column without its unit."""
    words: str
    per: str
    """'pose', 'arm' or 'rod': once per row, per motor or per rod."""
    values: Callable[[Situation], np.ndarray]
    """(N,), (N, nq) or (N, m), SI."""
    text: str
    """Python text of the same computation from `at`."""
    unit: str = ""
    """SI unit in words; empty where none is known."""
    origin: float | None = None
    """Value at which nothing deviates; None: the middle of the data."""
    column: str = ""
    """Column of the data that is needed, where one is."""


@dataclass(frozen=True)
class Scaled:
    """A variable scaled to about one over the data: u = (value − origin)/unit."""

    variable: Variable
    origin: float
    unit: float

    @property
    def text(self) -> str:
        """u as Python text."""
        sign = "-" if self.origin > 0 else "+"
        shifted = self.variable.text if self.origin == 0 else f"({self.variable.text} {sign} {abs(self.origin):.6g})"
        return shifted if self.unit == 1 else f"{shifted} / {self.unit:.6g}"

    def values(self, at: Situation) -> np.ndarray:
        """u (N,), (N, nq) or (N, m)."""
        return (self.variable.values(at) - self.origin) / self.unit

    @property
    def sorts(self) -> set[str]:
        """Words by which the lines of `SHAPES` ask for it."""
        own = {("angle" if self.variable.unit == "rad" else "travel")} if self.variable.text == "at.q" else set()
        return {self.variable.name, self.variable.per} | own

    @classmethod
    def of(cls, variable: Variable, at: Situation) -> Scaled | None:
        """A variable at the scale of some data, its constants rounded as they are written; None where it is constant
        or has blanks. A load that hardly varies counts as constant, because its rounding would then be the variable."""
        raw = variable.values(at)
        largest = float(np.abs(raw).max(initial=0.0))
        least = STEADY * largest if variable.name in ("torque", "tension") else 1e-9 * max(1.0, largest)
        if not np.isfinite(raw).all() or np.ptp(raw) <= least:
            return None
        middle = 0.5 * float(raw.max() + raw.min())
        origin = float(f"{middle if variable.origin is None else variable.origin:.4g}")
        reach = float(np.abs(raw - origin).max())
        # An angle in rad and a direction of ±1 stay as they are: their laws are then read without a constant.
        unit = 1.0 if variable.name == "dir" or variable.unit == "rad" else float(f"{reach:.3g}")
        return cls(variable, origin, unit)


def variables(at: Situation) -> list[Variable]:
    """What laws may depend on, for the columns that the data have."""
    turning = at.robot.mechanism.actuator_dimension == "angle"
    load, unit, place = ("N·m", "rad", "angle") if turning else ("N", "m", "position")
    torque = "torque" if turning else "force"
    out = [
        Variable("q", f"its own {place}", "arm", lambda s: s.q, "at.q", unit, 0.0 if turning else None),
        Variable("torque", f"its own {torque}", "arm", lambda s: s.torque, "at.torque", load, 0.0),
        Variable("tension", "its own tension", "rod", lambda s: s.tension, "at.tension", "N", 0.0),
        Variable("q", f"the next arm's {place}", "arm", lambda s: np.roll(s.q, -1, 1),
                 "np.roll(at.q, -1, axis=1)", unit, 0.0 if turning else None),
        Variable("q", f"the previous arm's {place}", "arm", lambda s: np.roll(s.q, 1, 1),
                 "np.roll(at.q, 1, axis=1)", unit, 0.0 if turning else None),
        Variable("torque", f"the next arm's {torque}", "arm", lambda s: np.roll(s.torque, -1, 1),
                 "np.roll(at.torque, -1, axis=1)", load, 0.0),
        Variable("torque", f"the previous arm's {torque}", "arm", lambda s: np.roll(s.torque, 1, 1),
                 "np.roll(at.torque, 1, axis=1)", load, 0.0),
        *(_place(axis) for axis in np.flatnonzero(varies(at.pose.x)).tolist()),
        Variable("payload", "the payload", "pose", lambda s: s.payload, "at.payload", "kg", 0.0),
        Variable("tool_length", "the length of the tool", "pose", lambda s: s.tool[:, 2], "at.tool[:, 2]", "m",
                 0.0),
    ]  # fmt: skip
    if np.any(at.directions()):
        out.append(Variable("dir", "its own direction", "arm", lambda s: s.directions(), "at.directions()", "", 0.0))
        out.append(Variable("dir", "the next arm's direction", "arm", lambda s: np.roll(s.directions(), -1, 1),
                            "np.roll(at.directions(), -1, axis=1)", "", 0.0))  # fmt: skip
        for i in range(at.q.shape[1]):
            out.append(Variable("dir", f"the direction of motor {i + 1}", "pose", _direction(i),
                                f"at.directions()[:, {i}]", "", 0.0))  # fmt: skip
    for name in _distinct(at):
        warm = name.startswith("temp")
        origin = 20.0 if warm else 0.0 if name == "time" else None
        unit = "K" if warm else "s" if name == "time" else ""
        words = f"the temperature of {name[5:]}" if name.startswith("temp_") else name.replace("_", " ")
        out.append(Variable(name, words, "pose", _reader(name), f'at.column("{name}")', unit, origin, name))
    return out


def _place(axis: int) -> Variable:
    """The plate's position along one axis, by its index."""
    name = "xyz"[axis]
    words = "the height" if name == "z" else f"the place along {name}"
    return Variable(name, words, "pose", lambda s: s.pose.x[:, axis], f"at.pose.x[:, {axis}]", "m")


def _direction(i: int) -> Callable[[Situation], np.ndarray]:
    return lambda at: at.directions()[:, i]


def _reader(name: str) -> Callable[[Situation], np.ndarray]:
    return lambda at: at.column(name)


def _distinct(at: Situation) -> list[str]:
    """Columns that vary, one name for each content: temperatures that are one column under several names come once."""
    kept: list[str] = []
    for name in sorted(at.columns, key=lambda n: (n.startswith("temp"), n)):
        values = at.columns[name]
        if name.startswith("dir") or not np.isfinite(values).all() or np.ptp(values) == 0:
            continue
        if all(abs(np.corrcoef(values, at.columns[other])[0, 1]) < 1 - 1e-9 for other in kept):
            kept.append(name)
    return kept


@dataclass(frozen=True)
class Shape:
    """A dimensionless function of a scaled variable u."""

    name: str
    """Key in JSON."""
    words: str
    """What a sentence says; `{v}` is the variable in words, `{c}` the constant."""
    values: Callable[[np.ndarray, float], tuple[np.ndarray, ...]]
    """One or two functions (…) of u (…) and the constant c."""
    text: tuple[str, ...]
    """Python text of the same computation from `{u}` and `{c}`."""
    on: str
    """Which variables it is tried on: names, 'angle' or 'travel' for the motor's own angle or travel alone, 'pose' for
    all that are recorded once per row."""
    constants: Callable[[np.ndarray], np.ndarray] = lambda u: np.zeros(1)
    """Values of c that are searched, for given u (…)."""
    searched: bool = False
    """Whether c is searched for; it then counts as a parameter."""
    refined: bool = False
    """Whether c is refined beside the best of the searched values."""


def _frequencies(u: np.ndarray) -> np.ndarray:
    """Cycles per turn from 0.5 to 60; neighbours share 90 % of their square sum over the range of the angle."""
    step = 0.6 * np.pi / max(float(np.ptp(u)), 0.2)
    return np.arange(0.5, 60.0, min(step, 1.0) * 0.5)


def _places(u: np.ndarray) -> np.ndarray:
    """Middles between the ordered values of u, at most 160 of them, with five rows or more on either side."""
    ordered = np.unique(u)
    if len(ordered) < 12:
        return np.zeros(0)
    middle = 0.5 * (ordered[5:-4] + ordered[4:-5])
    return middle[:: max(1, len(middle) // 160)]


def _settling(u: np.ndarray) -> np.ndarray:
    """Time constants from 3 % of the session to the whole of it, in steps of a factor of 1.35."""
    return float(u.max()) * 1.35 ** -np.arange(12)


SHAPES = (
    Shape("linear", "{v}", lambda u, c: (u,), ("{u}",), "q torque tension dir pose"),
    Shape("square", "the square of {v}", lambda u, c: (u * u,), ("({u}) ** 2",), "q torque pose"),
    Shape("cube", "the cube of {v}", lambda u, c: (u**3,), ("({u}) ** 3",), "q torque"),
    Shape("signed square", "the signed square of {v}", lambda u, c: (u * np.abs(u),), ("{u} * np.abs({u})",),
          "torque tension"),
    Shape("absolute", "the size of {v}", lambda u, c: (np.abs(u),), ("np.abs({u})",), "torque tension q"),
    Shape("sign", "the sign of {v}", lambda u, c: (np.sign(u),), ("np.sign({u})",), "torque tension"),
    Shape("saturating", "{v}, levelling off", lambda u, c: (np.tanh(u / c),), ("np.tanh({u} / {c})",), "torque payload",
          lambda u: float(np.abs(u).max()) * np.array([0.1, 0.2, 0.4]), True),
    Shape("kink", "{v} beyond {c}", lambda u, c: (np.maximum(u - c, 0.0),), ("np.maximum({u} - {c}, 0)",),
          "q torque pose", lambda u: np.quantile(u, [0.2, 0.35, 0.5, 0.65, 0.8]), True),
    Shape("sine", "waves of {v}, {c} per turn", lambda u, c: (np.sin(c * u), np.cos(c * u)),
          ("np.sin({c} * {u})", "np.cos({c} * {u})"), "angle", _frequencies, True, True),
    Shape("waves", "waves along {v}", lambda u, c: (np.sin(c * u), np.cos(c * u)),
          ("np.sin({c} * {u})", "np.cos({c} * {u})"), "x y z travel", lambda u: np.arange(2.0, 14.0, 0.75), True,
          True),
    Shape("step", "a step of {v} at {c}", lambda u, c: (np.where(u > c, 1.0, 0.0),), ("np.where({u} > {c}, 1.0, 0.0)",),
          "time", _places, True),
    Shape("settling", "1 − exp(−t/τ), τ = {c}", lambda u, c: (1 - np.exp(-u / c),), ("1 - np.exp(-{u} / {c})",),
          "time", _settling, True, True),
)  # fmt: skip


@dataclass(frozen=True)
class Term:
    """A function of what was recorded: one shape of one variable, times a second variable where there is one."""

    shape: Shape
    of: Scaled
    constant: float = 0.0
    times: Scaled | None = None

    @property
    def variables(self) -> tuple[Scaled, ...]:
        """What it is a function of."""
        return (self.of,) if self.times is None else (self.of, self.times)

    @property
    def per(self) -> str:
        """'pose', 'arm' or 'rod'."""
        kinds = {s.variable.per for s in self.variables}
        return next((kind for kind in ("rod", "arm") if kind in kinds), "pose")

    @property
    def function(self) -> str:
        """Key in JSON."""
        return self.shape.name if self.times is None else "product"

    def values(self, at: Situation) -> tuple[np.ndarray, ...]:
        """One or two functions (N, 1 or places)."""
        factor = 1.0 if self.times is None else _wide(self.times.values(at))
        return tuple(factor * f for f in self.shape.values(_wide(self.of.values(at)), self.constant))

    def text(self, vector: bool) -> list[str]:
        """The function as Python text, of shape (N, 1 or places) for channels with places and (N,) for vectors."""
        out = []
        for pattern in self.shape.text:
            u = _column(self.of, vector)
            written = pattern.format(u=f"({u})" if pattern != "{u}" and " " in u else u, c=f"{self.constant:.6g}")
            out.append(written if self.times is None else f"({written}) * ({_column(self.times, vector)})")
        return out

    @property
    def reference(self) -> str:
        """Where an amplitude is counted, e.g. ' at 25 N·m': the value that the variable is scaled to."""
        known = self.shape.name in ("linear", "square", "cube", "signed square", "absolute") and self.of.unit != 1
        if not known or self.times is not None:
            return ""
        beyond = "" if self.of.origin == 0 else f" beyond {self.of.origin:.3g}"
        return f" at {self.of.unit:.3g} {self.of.variable.unit}{beyond}".replace("  ", " ")

    def words(self) -> str:
        """What it is a function of, as a sentence says it."""
        shown = self.constant * self.of.unit + self.of.origin if self.shape.name in ("step", "kink") else self.constant
        if self.shape.name == "settling":
            said = f"{self.constant * self.of.unit / 60:.3g} min"
        else:
            said = f"{shown:.4g}" + (" s" if self.of.variable.name == "time" else "")
        main = self.shape.words.format(v=self.of.variable.words, c=said)
        return main if self.times is None else f"{main} × {self.times.variable.words}"


def _wide(values: np.ndarray) -> np.ndarray:
    return values[:, None] if values.ndim == 1 else values


def _column(scaled: Scaled, vector: bool) -> str:
    """Text of a variable, as a column where the channel has places."""
    if vector or scaled.variable.per != "pose":
        return scaled.text
    return Scaled(_as_column(scaled.variable), scaled.origin, scaled.unit).text


def _as_column(variable: Variable) -> Variable:
    from dataclasses import replace

    if "[:, " in variable.text:  # at.pose.x[:, 0] → at.pose.x[:, [0]]
        head, _, tail = variable.text.rpartition("[:, ")
        return replace(variable, text=f"{head}[:, [{tail[:-1]}]]")
    return replace(variable, text=f"{variable.text}[:, None]")


PRODUCTS = (
    ("payload", "q"), ("payload", "x"), ("payload", "y"), ("payload", "z"), ("dir", "torque"), ("dir", "q"),
    ("temp", "q"), ("temp", "x"), ("temp", "y"), ("temp", "z"), ("temp", "torque"), ("temp", "tension"),
    ("x", "y"), ("y", "z"), ("x", "z"), ("time", "q"), ("time", "x"), ("time", "y"), ("time", "z"),
    ("column", "q"), ("column", "torque"), ("dir", "temp"), ("dir", "payload"), ("q", "torque"), ("torque", "torque"),
    ("q", "q"),
)  # fmt: skip
"""Pairs of variables whose product is tried; `temp` is every temperature, `column` every column of the user's own."""


def terms(at: Situation) -> Iterator[Term]:
    """Every function of the grammar that these data can tell, scaled to them."""
    found = [s for v in variables(at) if (s := Scaled.of(v, at)) is not None]
    for shape in SHAPES:
        for scaled in found:
            if scaled.sorts.isdisjoint(shape.on.split()):
                continue
            for c in shape.constants(scaled.values(at)):
                yield Term(shape, scaled, float(f"{c:.6g}"))
    linear = SHAPES[0]
    for i, a in enumerate(found):
        for b in found[i:]:
            if {(_sort(a), _sort(b)), (_sort(b), _sort(a))}.isdisjoint(PRODUCTS) or a is b:
                continue
            if {a.variable.per, b.variable.per} != {"arm", "rod"}:
                yield Term(linear, a, 0.0, b)


def _sort(scaled: Scaled) -> str:
    name = scaled.variable.name
    if name.startswith("temp"):
        return "temp"
    return "column" if scaled.variable.column and name != "time" else name
