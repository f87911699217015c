"""What moved against a baseline, for people and for CI: table, Markdown, JUnit XML, JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

from bench.jobs.campaign.regress import FigureChange
from pcalib.wording import size

HEADER = ("figure", "baseline", "now", "change", "verdict")
_ORDER = {"worse": 0, "gone": 1, "better": 2, "new": 3, "same": 4}


def headline(changes: Sequence[FigureChange]) -> str:
    """The outcome in one sentence."""
    worse = [c for c in changes if c.regression]
    better = sum(c.verdict == "better" for c in changes)
    new = sum(c.verdict == "new" for c in changes)
    parts = [f"{len(changes)} figures"]
    parts.append(f"{len(worse)} regressions" if len(worse) != 1 else "1 regression")
    if better:
        parts.append(f"{better} better")
    if new:
        parts.append(f"{new} new")
    return ", ".join(parts) if worse or better or new else f"{len(changes)} figures, all as in the baseline"


def table(changes: Sequence[FigureChange]) -> list[list[str]]:
    """Rows of what moved, regressions first, the largest change first."""
    moved = [c for c in changes if c.verdict != "same"]
    moved.sort(key=lambda c: (_ORDER[c.verdict], -_size(c)))
    return [[c.name, told(c.kind, c.before), told(c.kind, c.now), c.moved, c.verdict] for c in moved]


def markdown(title: str, changes: Sequence[FigureChange]) -> str:
    """A summary for a CI page."""
    lines = [f"## {title}: {headline(changes)}", ""]
    rows = table(changes)
    if rows:
        lines += ["| " + " | ".join(HEADER) + " |", "|---|---:|---:|---:|---|"]
        marks = {"worse": "❌ worse", "gone": "❌ gone", "better": "✅ better", "new": "new"}
        lines += ["| " + " | ".join([*row[:4], marks[row[4]]]) + " |" for row in rows]
        lines.append("")
    if any(c.verdict in ("better", "new") for c in changes) and not any(c.regression for c in changes):
        lines += ['Keep what was gained: `pcbench regress … --update --reason "…"`.', ""]
    return "\n".join(lines)


def junit(title: str, changes: Sequence[FigureChange]) -> str:
    """JUnit XML: one test case per figure."""
    failed = [c for c in changes if c.regression]
    suite = ElementTree.Element("testsuite", name=f"pcbench regress {title}", tests=str(len(changes)),
                                failures=str(len(failed)), errors="0", skipped="0")  # fmt: skip
    for change in changes:
        subject, _, figure = change.name.rpartition(": ")
        case = ElementTree.SubElement(suite, "testcase", classname=subject, name=figure)
        if change.regression:
            before, now = told(change.kind, change.before), told(change.kind, change.now)
            message = f"{change.name}: {before} → {now} ({change.moved})"
            ElementTree.SubElement(case, "failure", message=message, type=change.verdict).text = message
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def as_json(title: str, changes: Sequence[FigureChange]) -> dict[str, Any]:
    """Stable keys."""
    return {
        "schema": "pcbench.regress/1",
        "campaign": title,
        "regressions": sum(c.regression for c in changes),
        "figures": [
            {"name": c.name, "kind": c.kind, "baseline": c.before, "now": c.now, "verdict": c.verdict} for c in changes
        ],
    }


def told(kind: str, value: float | None) -> str:
    """The value of a figure of this kind as text with its unit; a dash where there is none."""
    if value is None or value != value:
        return "–"
    if kind == "error":
        return size(value)
    if kind == "reached":
        return f"{100 * value:.2f} %"
    return f"{value:.0f}" if kind == "failed" else f"{value:.3g} × reference"


def _size(change: FigureChange) -> float:
    if not change.before or change.now is None:
        return float("inf") if change.now else 0.0
    return abs(change.now / change.before - 1)
