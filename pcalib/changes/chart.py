"""A control chart over sessions: the change of every kind of part since the model's session, with its limits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcalib import report
from pcalib.changes.search import Changes, Verdict
from pcalib.changes.telling import p_text, sentence
from pcalib.diagnosis.hypothesis import Kind
from pcalib.model import Model
from pcalib.palette import SERIES
from pcalib.report import Figure, Page, Section, Table
from pcalib.report.figures import INK, QUIET, drawing
from pcalib.report.page import versions

WIDEST = 1
"""Directions of the parts that are charted: zeros, scales and rods have one number each."""


def write(path: Path, model: Model, sources: Sequence[Path], found: Sequence[Changes]) -> None:
    """Write the chart as a report page.

    Args:
        sources: the files of the sessions, in their order.
        found: what changed in each since the session of the model.
    """
    labels = [source.stem for source in sources]
    alarms = [i for i, one in enumerate(found) if one.verdict is not Verdict.NOTHING]
    verdict = (
        f"Nothing changed over {len(found)} sessions."
        if not alarms
        else f"Something changed in {len(alarms)} of {len(found)} sessions, first in {labels[alarms[0]]}."
    )
    rows = [
        (label, one.verdict.replace("_", " "), p_text(one.p), sentence(one))
        for label, one in zip(labels, found, strict=True)
    ]
    sections = [
        Section("Sessions", [Table(("session", "verdict", "p", "in words"), rows, "<<><", marked=alarms)]),
        Section("Parts", [
            Figure(
                drawn(labels, found),
                "Change of each part on its own since the session of the model, with bars of 2σ. A change inside the "
                "band is found less than nine times out of ten.",
                "Control charts of motor zeros and rod lengths over the sessions.",
            )
        ]),
    ]  # fmt: skip
    page = Page(f"Changes of {model.robot.name}", verdict, sections, "bad" if alarms else "good", versions())
    report.write(path, page)


def drawn(labels: Sequence[str], found: Sequence[Changes]) -> str:
    """One panel for each part with a single number, SVG."""
    parts = [
        f.candidate.hypothesis
        for f in sorted(found[0].findings, key=lambda f: f.name)
        if f.candidate.hypothesis.kind is Kind.PART and f.slip is None and len(f.theta) == WIDEST
    ]
    across = 3
    down = max(1, -(-len(parts) // across))
    with drawing(8.4, 1.5 * down + 0.5) as (figure, out):
        panels = np.atleast_1d(figure.subplots(down, across, sharex=True)).ravel()
        for panel, part in zip(panels, parts, strict=False):
            mine = [next((f for f in one.findings if f.name == part.name), None) for one in found]
            factor = 1e6
            value = np.array([np.nan if f is None else factor * f.theta[0] for f in mine])
            sigma = np.array([np.nan if f is None else factor * f.sigma[0] for f in mine])
            limit = np.array([np.nan if f is None else factor * f.smallest[0] for f in mine])
            at = np.arange(len(labels))
            panel.fill_between(at, -limit, limit, color=QUIET, alpha=0.15, step="mid", linewidth=0)
            panel.errorbar(at, value, 2 * sigma, fmt="o", ms=3, lw=1, color=SERIES[0])
            panel.axhline(0, color=INK, lw=0.5)
            unit = {"m": "µm", "rad": "µrad", "1": "ppm"}[part.units[0]]
            panel.set_title(f"{part.name} [{unit}]", fontsize=8)
            panel.tick_params(labelsize=7)
            step = max(1, len(labels) // 6)
            panel.set_xticks(at[::step], [label[-10:] for label in labels[::step]], fontsize=6, rotation=45)
        for panel in panels[len(parts) :]:
            panel.set_visible(False)
        figure.tight_layout()
    return out[0]
