"""A control chart over sessions: changes of zeros, scales and rods since the session of the model, and the landing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcalib import report
from pcalib.changes.history import Visit
from pcalib.changes.results import Verdict
from pcalib.changes.telling import sentence
from pcalib.diagnosis.hypothesis import Kind
from pcalib.diagnosis.telling import p_text
from pcalib.model import Model
from pcalib.palette import SERIES
from pcalib.report import Figure, Page, Section, Table
from pcalib.report.figures import INK, QUIET, drawing
from pcalib.report.page import versions
from pcalib.wording import size

WIDEST = 1
"""Directions of the parts that are charted: zeros, scales and rods have one number each."""


def write(path: Path, model: Model, visits: Sequence[Visit]) -> None:
    """Write the chart as a report page.

    Args:
        visits: the sessions in their order.
    """
    labels, found = [visit.label for visit in visits], [visit.found for visit in visits]
    alarms = [i for i, one in enumerate(found) if one.verdict is not Verdict.NOTHING]
    verdict = (
        f"Nothing changed over {len(found)} sessions."
        if not alarms
        else f"Something changed in {len(alarms)} of {len(found)} sessions, first in {labels[alarms[0]]}."
    )
    rows = [
        (v.label, v.found.verdict.replace("_", " "), p_text(v.found.p), size(v.landing), sentence(v.found))
        for v in visits
    ]
    header = ("session", "verdict", "p", "lands within", "in words")
    sections = [
        Section("Sessions", [Table(header, rows, "<<>><", marked=alarms)]),
        Section("Landing", [
            Figure(
                trend(visits),
                "RMS distance of the measured positions from where the model says that the robot lands, the measuring "
                "frame allowed for. Filled: something changed.",
                "Trend of the landing error over the sessions.",
            )
        ]),
        Section("Parts", [
            Figure(
                drawn(visits),
                "Change of each part on its own since the session of the model, with bars of 2σ. Dashed: a change of "
                "that size is found nine times out of ten.",
                "Control charts of motor zeros and rod lengths over the sessions.",
            )
        ]),
    ]  # fmt: skip
    page = Page(f"Changes of {model.robot.name}", verdict, sections, "bad" if alarms else "good", versions())
    report.write(path, page)


def _places(visits: Sequence[Visit]) -> tuple[np.ndarray, list[str]]:
    """Where each session stands along the chart, days from the first one if all have a date, and its label."""
    days = [visit.when for visit in visits]
    known = [day.toordinal() for day in days if day is not None]
    if len(known) < len(visits):
        return np.arange(len(visits), dtype=float), [visit.label[-10:] for visit in visits]
    return np.array(known, float) - known[0], [visit.label for visit in visits]


def trend(visits: Sequence[Visit]) -> str:
    """The landing error of every session, SVG."""
    at, labels = _places(visits)
    alarm = np.array([visit.found.verdict is not Verdict.NOTHING for visit in visits])
    value = 1e6 * np.array([visit.landing for visit in visits])
    with drawing(8.4, 2.4) as (figure, out):
        panel = figure.subplots()
        panel.plot(at, value, color=SERIES[0], lw=1, marker="o", ms=4, mfc="none")
        panel.plot(at[alarm], value[alarm], "o", ms=5, color=SERIES[1])
        panel.set_ylabel("RMS [µm]", fontsize=8)
        panel.set_ylim(bottom=0)
        _dated(panel, at, labels, 8)
    return out[0]


def _dated(panel, at: np.ndarray, labels: Sequence[str], most: int) -> None:
    """Write at most `most` labels along an axis of sessions, evenly spaced."""
    step = max(1, -(-len(labels) // most))
    panel.set_xticks(at[::step], labels[::step], fontsize=6, rotation=30, ha="right")
    panel.tick_params(axis="y", labelsize=7)


def drawn(visits: Sequence[Visit]) -> str:
    """One panel for each part with a single number, SVG."""
    found, (at, labels) = [visit.found for visit in visits], _places(visits)
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
            for side in (-limit, limit):
                panel.plot(at, side, color=QUIET, lw=0.8, ls="--")
            panel.errorbar(at, value, 2 * sigma, fmt="o", ms=3, lw=1, color=SERIES[0])
            panel.axhline(0, color=INK, lw=0.5)
            unit = {"m": "µm", "rad": "µrad", "1": "ppm"}[part.units[0]]
            panel.set_title(f"{part.name} [{unit}]", fontsize=8)
            _dated(panel, at, labels, 4)
        for panel in panels[len(parts) :]:
            panel.set_visible(False)
    return out[0]
