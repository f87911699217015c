"""A law: channel × sharing × function, as an effect that everything else can use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pcalib import units
from pcalib.effects.base import Contribution, EffectParameter, Situation
from pcalib.laws.channels import CHANNELS, Channel
from pcalib.laws.functions import Term, terms
from pcalib.wording import figure

COMMON, EACH = "common", "each"


@dataclass(frozen=True)
class Law:
    """One law of the grammar, scaled to some data; its amplitudes are its parameters."""

    channel: Channel
    sharing: str
    """'common': one amplitude for all places; 'each': one per place or component; else the name of a single place."""
    term: Term
    places: tuple[str, ...]
    """Names of the channel's places on the robot."""

    @property
    def chosen(self) -> tuple[int, ...]:
        """Indices into `places` at which the law acts."""
        return tuple(range(len(self.places))) if self.sharing in (COMMON, EACH) else (self.places.index(self.sharing),)

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the parameters: function by function, place by place."""
        functions = ("sine", "cosine") if len(self.term.shape.text) == 2 else ("amplitude",)
        if self.sharing != EACH:
            return functions
        return tuple(f"{f}.{place}" for f in functions for place in self.places)

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """An effect parameter for every amplitude, in the unit of the channel."""
        return tuple(EffectParameter(name, self.channel.unit, self.channel.size) for name in self.amplitudes)

    @property
    def columns(self) -> int:
        """Number of amplitudes."""
        return len(self.amplitudes)

    @property
    def complexity(self) -> int:
        """Number of amplitudes, and one more where the constant of the term was searched for."""
        return self.columns + self.term.shape.searched

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns of the data that it uses."""
        return tuple(dict.fromkeys(s.variable.column for s in self.term.variables if s.variable.column))

    def deviation(self, at: Situation, theta: np.ndarray) -> np.ndarray:
        """Deviations (N, places) at amplitudes theta (columns,) [SI]."""
        functions = at_places(self.term, self.channel, at)
        out = np.zeros((len(at), len(self.places)))
        for f, size in zip(functions, np.asarray(theta, float).reshape(len(functions), -1), strict=True):
            chosen = list(self.chosen)
            out[:, chosen] += size * (f if f.shape[1] == 1 else f[:, chosen])
        return out

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        """What the law adds at amplitudes theta (columns,) [SI]."""
        return self.channel.contribution(at, self.deviation(at, theta))

    def words(self) -> str:
        """The law without its figures."""
        where = self.channel.words
        if self.sharing not in (COMMON, EACH):
            where = f"{where}, {self.sharing} alone"
        each = ", each by its own amount" if self.sharing == EACH and not self.channel.vector else ""
        told = self.term.words()
        if by_arm(self.term, self.channel):
            told = told.replace("its own", "its arm's")
        return f"{where} by {told}{each}"

    def describe(self, theta: np.ndarray) -> str:
        """The amplitudes with their unit, at the largest value of the function."""
        shown = np.asarray(theta, float) / units.factor(self.channel.unit)
        unit = units.spoken(self.channel.unit)
        values = shown.reshape(len(self.term.shape.text), -1)
        if len(values) == 2:  # waves: amplitude of each place
            values = np.hypot(*values)[None]
        return f"{', '.join(figure(float(v)) for v in values[0])} {unit}{self.term.reference}"


def by_arm(term: Term, channel: Channel) -> bool:
    """Whether every rod of the channel takes the value that the function has at its arm."""
    return channel.places == "rod" and term.per == "arm"


def repeated(term: Term, channel: Channel) -> bool:
    """Whether a law of a single rod by this function is one by a direction of the whole robot as well: motor by motor,
    directions stand among its variables too."""
    return by_arm(term, channel) and all(s.variable.name == "dir" for s in term.variables if s.variable.per == "arm")


def at_places(term: Term, channel: Channel, at: Situation) -> tuple[np.ndarray, ...]:
    """One or two functions (N, 1 or places) at the places of a channel."""
    found = term.values(at)
    return tuple(f[:, at.robot.mechanism.actuator] for f in found) if by_arm(term, channel) else found


def laws(at: Situation) -> Iterator[tuple[Channel, tuple[str, ...], list[Term]]]:
    """The grammar on some data: every channel that the robot has, its places, and the functions that fit it."""
    mechanism = at.robot.mechanism
    found = list(terms(at))
    for channel in CHANNELS:
        if not channel.suits(mechanism):
            continue
        accepted = {"pose"} if channel.vector else {"pose", "arm", channel.places}
        yield channel, channel.names(mechanism), [term for term in found if term.per in accepted]


def sharings(channel: Channel, places: tuple[str, ...]) -> list[str]:
    """Ways in which the places of a channel may share a law, the simplest first."""
    return [*([] if channel.vector else [COMMON]), *places, EACH]
