"""Grades: a diagnosis against what is known to be hidden, and rates against the bounds that they have to keep."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from pcalib import files
from pcalib.errors import InputError

VERDICTS = ("nothing_missing", "established", "ambiguous", "unexplained")
WRITTEN_BY = "write it with pcalib diagnose DATA.csv --model MODEL.toml --json FILE"
CLEAR = 6.0
"""s from which on a single effect has to be found."""
FAR = 8.0
"""s⊥ from which on what no library lists has to be called unexplained, and a pair needs both of its effects."""
SLACK = 0.95
"""Share of a wanted size that counts as reached."""


@dataclass(frozen=True)
class Facts:
    """What is hidden in one data set."""

    effects: tuple[str, ...]
    """Names that the right answer gives, sorted; empty where nothing is hidden, or nothing that a library lists."""
    faults: tuple[str, ...]
    """What the virtual robot calls it."""
    size: float = 0.0
    """s: norm of all that is visible, in noise units."""
    distance: float = 0.0
    """s⊥: of a pair, from the nearest single effect; of what no library lists, from the nearest two."""

    @property
    def kind(self) -> str:
        """'none', 'single', 'pair' or 'outside'."""
        if not self.faults:
            return "none"
        return {0: "outside", 1: "single"}.get(len(self.effects), "pair")


@dataclass(frozen=True)
class Answer:
    """What a diagnosis says."""

    verdict: str
    established: tuple[str, ...]
    adequate: tuple[tuple[str, ...], ...]

    @classmethod
    def of_json(cls, content: Mapping[str, Any], source: object = "diagnosis") -> Answer:
        """Return the answer in the JSON of `pcalib diagnose`.

        Raises:
            InputError: it is something else.
        """
        schema = content.get("schema") if isinstance(content, Mapping) else None
        if schema != "pcalib.diagnosis/1":
            raise InputError(
                f"schema is {schema!r}, not 'pcalib.diagnosis/1'", file=str(source),
                remedy=WRITTEN_BY,
            )  # fmt: skip
        shape = {"verdict": str, "established": [str], "adequate": [[str]]}
        files.require_shape(content, shape, str(source), WRITTEN_BY)
        adequate = tuple(tuple(sorted(names)) for names in content["adequate"])
        answer = cls(content["verdict"], tuple(sorted(content["established"])), adequate)
        if answer.verdict not in VERDICTS:
            problem = f"verdict is '{answer.verdict}', not one of {', '.join(VERDICTS)}"
            raise InputError(problem, file=str(source), remedy=WRITTEN_BY)
        return answer


class Mark(Enum):
    """How good a diagnosis is; the value is the text of tables and files."""

    RIGHT = "right"
    AMONG_RIVALS = "right, among rivals"
    IN_PART = "in part"
    NOT_AMONG_RIVALS = "not among the rivals"
    UNEXPLAINED = "unexplained"
    MISSED = "missed"
    WRONG = "wrong"
    FALSE_ALARM = "false alarm"
    TAKEN_FOR_KNOWN = "taken for a known effect"

    @property
    def is_right(self) -> bool:
        """Whether the diagnosis gives the truth, alone or among its rivals."""
        return self in (Mark.RIGHT, Mark.AMONG_RIVALS)

    @property
    def is_wrong(self) -> bool:
        """Whether the diagnosis asserts something that is not true."""
        return self in (Mark.WRONG, Mark.FALSE_ALARM, Mark.TAKEN_FOR_KNOWN)


@dataclass(frozen=True)
class Grade:
    """One diagnosis, judged."""

    facts: Facts
    answer: Answer

    @property
    def alarm(self) -> bool:
        """Whether the answer says that something is missing."""
        return self.answer.verdict != "nothing_missing"

    @property
    def inside(self) -> bool:
        """Whether the truth is one of the adequate sets."""
        return bool(self.facts.effects) and self.facts.effects in self.answer.adequate

    @property
    def found(self) -> bool:
        """Whether the answer names the truth, alone or beside rivals that fit as well."""
        return self.inside and self.answer.verdict in ("established", "ambiguous")

    @property
    def wrong(self) -> tuple[str, ...]:
        """Effects that are called established and are not there."""
        return tuple(sorted(set(self.answer.established) - set(self.facts.effects)))

    @property
    def unexplained(self) -> bool:
        """Whether the answer says that nothing known explains the data."""
        return self.answer.verdict == "unexplained"

    def to_json(self) -> dict[str, Any]:
        """Return the facts, the answer and the grade."""
        return {
            "kind": self.facts.kind, "truth": list(self.facts.effects), "faults": list(self.facts.faults),
            "s": self.facts.size, "s_outside": self.facts.distance, "verdict": self.answer.verdict,
            "established": list(self.answer.established), "adequate": [list(n) for n in self.answer.adequate],
            "grade": self.mark.value,
        }  # fmt: skip

    @property
    def mark(self) -> Mark:
        """How good the diagnosis is."""
        kind = self.facts.kind
        if self.wrong:
            return Mark.WRONG
        if kind == "none":
            return Mark.FALSE_ALARM if self.alarm else Mark.RIGHT
        if kind == "outside":
            return Mark.RIGHT if self.unexplained else Mark.TAKEN_FOR_KNOWN if self.alarm else Mark.MISSED
        if self.inside:
            return Mark.RIGHT if self.answer.verdict == "established" else Mark.AMONG_RIVALS
        if not self.alarm:
            return Mark.MISSED
        if self.unexplained:
            return Mark.UNEXPLAINED
        part = any(set(names) < set(self.facts.effects) for names in self.answer.adequate)
        return Mark.IN_PART if part and kind == "pair" else Mark.NOT_AMONG_RIVALS


@dataclass(frozen=True)
class Line:
    """One rate and the bound that it has to keep."""

    name: str
    what: str
    bound: float
    at_most: bool
    hits: int
    n: int

    @property
    def rate(self) -> float:
        """hits / n; NaN where nothing was asked."""
        return self.hits / self.n if self.n else float("nan")

    @property
    def sigma(self) -> float:
        """1σ of the rate; at a rate of 0 or 1, the σ for one hit more or less."""
        seen = min(max(self.hits, 1), self.n - 1) / self.n if self.n > 1 else 0.5
        return float((seen * (1 - seen) / max(self.n, 1)) ** 0.5)

    @property
    def holds(self) -> bool:
        """Whether the rate itself keeps the bound."""
        return self.n > 0 and (self.rate <= self.bound if self.at_most else self.rate >= self.bound)

    @property
    def chance(self) -> float:
        """Probability of a figure at least this bad where the true rate is the bound exactly."""
        from scipy.stats import binom

        if not self.n:
            return 1.0
        if self.at_most:
            return float(binom.sf(self.hits - 1, self.n, self.bound))
        return float(binom.cdf(self.hits, self.n, self.bound))

    @property
    def verdict(self) -> str:
        """'holds', 'within chance', 'falls short', 'not tested' or 'for comparison'."""
        if not self.n:
            return "not tested"
        if self.bound != self.bound:
            return "for comparison"
        if self.holds:
            return "holds"
        return "within chance" if self.chance > 0.05 else "falls short"

    def to_json(self) -> dict[str, Any]:
        """Return a record with stable keys."""
        return {
            "name": self.name, "what": self.what, "bound": self.bound, "at_most": self.at_most, "hits": self.hits,
            "n": self.n, "rate": self.rate, "sigma": self.sigma, "p_if_at_bound": self.chance, "verdict": self.verdict,
        }  # fmt: skip


def line(
    name: str, what: str, bound: float, at_most: bool, asked: Iterable[Grade], hit: Callable[[Grade], bool]
) -> Line:
    """Return a rate over the grades that are asked."""
    hits = [hit(g) for g in asked]
    return Line(name, what, bound, at_most, sum(hits), len(hits))


def lines(grades: Sequence[Grade]) -> list[Line]:
    """Return the bounds that every set of diagnoses has to keep."""
    clear = [g for g in grades if g.facts.kind == "single" and g.facts.size >= SLACK * CLEAR]
    pairs = [g for g in grades if g.facts.kind == "pair" and g.facts.distance >= SLACK * FAR]
    outside = [g for g in grades if g.facts.kind == "outside" and g.facts.distance >= SLACK * FAR]
    none = [g for g in grades if g.facts.kind == "none"]
    return [
        line("false_alarms", "nothing hidden, something found", 0.05, True, none, lambda g: g.alarm),
        line("inside", "single effect, s ≥ 6, something found: truth among the adequate sets", 0.93, False,
             (g for g in clear if g.alarm), lambda g: g.inside),
        line("found", "single effect, s ≥ 6: established, or fairly A or B", 0.90, False, clear, lambda g: g.found),
        line("false_established", "an effect called established that is not there", 0.02, True, grades,
             lambda g: bool(g.wrong)),
        line("pairs", "two effects that no single one explains (s⊥ ≥ 8): both in an adequate set", 0.90, False, pairs,
             lambda g: g.inside),
        line("outside", "in no library, s⊥ ≥ 8: called unexplained", 0.95, False, outside, lambda g: g.unexplained),
    ]  # fmt: skip
