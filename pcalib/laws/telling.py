"""Proposed laws in words, as JSON and as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcalib import files
from pcalib.laws.grammar import Law
from pcalib.laws.proposal import Family, Proposal, Proposals
from pcalib.laws.writing import names, spec, written
from pcalib.report import Bullets, Section, Table

SHOWN = 5
"""Classes of laws that are shown: the true one is nearly always among them."""
LAWS = ("law", "size", "noise units", "explains all")
"""Header of the table of laws."""


def figures(found: Proposal) -> str:
    """The amplitudes of each law with their units."""
    return "; ".join(law.describe(theta) for law, theta in zip(found.laws, found.theta, strict=True))


def in_words(found: Proposal) -> str:
    """An explanation with its figures: where, by what, how much."""
    parts = [f"{law.words()}: {law.describe(theta)}" for law, theta in zip(found.laws, found.theta, strict=True)]
    return "; and ".join([*parts, *(f"the listed effect {c.name}" for c in found.beside)])


def sentence(found: Proposals) -> str:
    """The result of the search in one sentence."""
    if not found.families:
        return f"No law found: the best of {found.tried:,} laws explains no more than noise would."
    best = found.families[0]
    if not best.first.adequate:
        return (
            f"No law of the grammar explains all of what is left. The nearest is: {in_words(best.first)}; "
            f"beside it something remains (p {best.first.rest:.1g})."
        )
    others = channels(best)
    also = f" These data cannot tell it from a law of {' or '.join(others)}." if others else ""
    listed = f" The listed effect {' or '.join(best.first.listed)} fits as well." if best.first.listed else ""
    return f"The simplest law that explains what is left: {in_words(best.first)}.{also}{listed}"


def channels(family: Family) -> list[str]:
    """Other channels, in words, that fit as well as the first law of a class."""
    mine = {law.channel.words for law in family.first.laws}
    others = [law.channel.words for p in family.rivals for law in p.laws if law.channel.words not in mine]
    return list(dict.fromkeys(others))


def rows(found: Proposals) -> list[tuple[str, str, str, str]]:
    """One row of the table for each class of laws."""
    return [
        (f.first.words(), figures(f.first), f"{f.first.s:.1f}", "yes" if f.first.adequate else "no")
        for f in found.families[:SHOWN]
    ]


def section(found: Proposals) -> Section:
    """The laws in a report: the simplest one in words, and the table of those that are shown."""
    return Section("Laws that no library lists", [Bullets([sentence(found)]), Table(LAWS, rows(found))])


def write(found: Proposals, folder: Path, source: str) -> dict[str, Path]:
    """Write the laws of the classes that are shown as effect files; returns their paths by spec."""
    out = {}
    folder.mkdir(parents=True, exist_ok=True)
    for law, theta in _shown(found):
        path = folder / f"{names(law)[0]}.py"
        if spec(law, folder) not in out:
            files.write_text(path, written(law, theta, source))
            out[spec(law, folder)] = path
    return out


def _shown(found: Proposals) -> list[tuple[Law, Any]]:
    return [pair for f in found.families[:SHOWN] for pair in zip(f.first.laws, f.first.theta, strict=True)]


def as_json(found: Proposals, folder: Path | None) -> dict[str, Any]:
    """`pcalib.proposal/1`: one entry for each class of laws, the best first."""
    return {
        "schema": "pcalib.proposal/1",
        "sentence": sentence(found),
        "tried": found.tried,
        "p": found.p,
        "laws": [_entry(f, folder) for f in found.families[:SHOWN]],
    }


def _entry(family: Family, folder: Path | None) -> dict[str, Any]:
    best = family.first
    law = best.laws[0]
    return {
        "spec": spec(law, folder) if folder is not None else "",
        "words": in_words(best),
        "channel": law.channel.name,
        "sharing": law.sharing,
        "variables": [s.variable.name for s in law.term.variables],
        "function": law.term.function,
        "constant": law.term.constant if law.term.shape.searched else None,
        "parameters": {
            p.name: {"value": float(value), "sigma": float(sigma), "unit": "rad" if "rad" in p.unit else "m"}
            for p, value, sigma in zip(law.parameters, best.theta[0], best.sigma[0], strict=True)
        },
        "s": best.s,
        "p": best.p,
        "bic": best.bic,
        "adequate": best.adequate,
        "aliases": list(dict.fromkeys(other.channel.name for r in family.rivals for other in r.laws[:1])),
        "rivals": [r.words() for r in family.rivals],
        "listed": list(best.listed),
        "beside": [c.spec for c in best.beside],
        "second": [_second(other, folder) for other in best.laws[1:]],
        "rest": best.rest,
    }


def _second(law: Law, folder: Path | None) -> dict[str, Any]:
    return {"spec": spec(law, folder) if folder is not None else "", "words": law.words(), "channel": law.channel.name,
            "variables": [s.variable.name for s in law.term.variables]}  # fmt: skip


def next_commands(found: Proposals, folder: Path, data: str, model: str) -> Sequence[tuple[str, ...]]:
    """Words of the commands that follow."""
    if not found.adequate:
        return []
    best = found.adequate[0].first
    specs = [spec(law, folder) for law in best.laws] + [c.spec for c in best.beside]
    return [("add", s, data, "--model", model) for s in specs]
