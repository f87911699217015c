"""The report of one fit: what was measured, what is left before and after, the parameters, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcalib import prediction, summary
from pcalib.data.measurement import Measurements
from pcalib.fitting.linearisation import conditions_of, residuals, seen_from
from pcalib.fitting.result import Fit
from pcalib.ladder import Ladder
from pcalib.model import Model
from pcalib.report import page, sections
from pcalib.report import residuals as figures
from pcalib.report.page import Bullets, Figure, Page, Section, Table
from pcalib.report.page import write as write_page


def first_sections(fit: Fit, data: Measurements) -> list[Section]:
    """The figures of a fit and its residuals, for a first look."""
    drawn = seen_from(Model.nominal(fit.candidate.robot), data)
    moved = Table(("moved most", "from nominal", "± 1σ", "in σ"), summary.largest_changes(fit), "<>>>")
    return [
        sections.data(fit, f"{len(data)} rows of {Path(data.source).name}, in the {data.frame} frame."),
        _by_row(fit, data, residuals(drawn, data)[0]),
        Section("What moved most", [moved]),
    ]


def _by_row(fit: Fit, data: Measurements, before: np.ndarray) -> Section:
    drawn = Figure(
        figures.by_row(before, fit.error, data.sigma, data.check),
        "Length of each row's residual. In a tracker's frame the drawn robot is laid onto the readings.",
        "Residuals of every row before and after the fit, on a logarithmic scale.",
    )
    return Section("What is left, row by row", [drawn])


def fit_sections(fit: Fit, data: Measurements) -> list[Section]:
    """All of a fit, for this page or another."""
    model = fit.candidate
    drawn = seen_from(Model.nominal(model.robot), data)
    before, p = residuals(drawn, data)
    there = prediction.predict(model, data.q, conditions_of(data)).pose.x if not p.reached.all() else p.pose.x
    out = [
        sections.data(fit, f"{len(data)} rows of {Path(data.source).name}, in the {data.frame} frame."),
        _by_row(fit, data, before),
    ]
    if np.isfinite(fit.error[:, :3]).any():
        out.append(
            Section(
                "Where it is left",
                [
                    Figure(
                        figures.over_workspace(there, before, fit.error),
                        "Plate positions seen from above; the colour is the length of the position's residual.",
                        "Coloured maps of residuals over the workspace, before and after the fit.",
                    )
                ],
            )
        )
    out += [
        Section(
            "Where the parameters are",
            [
                Figure(
                    figures.robot(model),
                    "The robot as fitted, with the names of its parameters; beside each drive those of its mount.",
                    "A drawing of the robot with the names of its geometric parameters.",
                )
            ],
        ),
        sections.parameters(fit),
        sections.unidentifiable(fit),
    ]
    return out


def write_fit(path: str | Path, fit: Fit, data: Measurements, said: Sequence[str], expected: Ladder | None) -> None:
    """The report of a fit, one self-contained HTML file.

    Args:
        said: sentences that stand first, such as how far from the drawing the data are.
        expected: the fitted model with what it expects over the workspace.
    """
    model = fit.candidate
    parts = fit_sections(fit, data)
    if expected is not None:
        parts += sections.expected_maps(expected)
    looked = [*said, *(str(w) for w in fit.warnings)]
    if looked:
        parts.insert(0, Section("To be looked at", [Bullets(looked, "warning")]))
    good = fit.status == "converged" and fit.accuracy.at_the_noise and not said
    facts = {
        "data": data.source, "robot": model.robot.name, "level": model.level,
        "effects": ", ".join(f.spec or f.effect.name for f in model.effects) or "none", **page.versions(),
    }  # fmt: skip
    title = f"Calibration of {model.robot.name}"
    write_page(path, Page(title, fit.headline(), parts, "good" if good else "bad", facts))
