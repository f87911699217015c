"""Sections of a calibration report: the ladder, error maps, parameters, and what the data cannot identify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pcalib import ladder as ladders
from pcalib import summary, wording
from pcalib.fitting.identifiability import priors
from pcalib.fitting.identification import Fit
from pcalib.ladder import Ladder
from pcalib.palette import LogScale
from pcalib.report import figures
from pcalib.report.page import Bullets, Figure, Section, SectionBlock, Table, Text
from pcalib.wording import number, size


def ladder(what: Ladder) -> Section:
    """How the error falls from model to model."""
    header, rows = ladders.table(what)
    notes = [f"{step.label}: {step.text}" for step in what.steps if step.text]
    lost = [
        f"{m.label}: {int((~m.reached).sum())} of {len(m.targets)} targets are left out: some step did not reach them."
        for m in what.maps
        if not m.reached.all()
    ]
    blocks: list[SectionBlock] = [
        Figure(
            figures.ladder(what),
            f"Position error of the TCP, {what.source}, at {int(what.maps[0].reached.sum())} targets all over the "
            "workspace.",
            "Curves of RMS error over the models, one per tool length, on a logarithmic scale.",
        ),
        Table(header, rows, "<<" + ">" * (len(header) - 2), marked=(len(rows) - 1,)),
        Bullets(notes),
    ]
    if lost:
        blocks.append(Bullets(lost, "warning"))
    return Section("How the error falls", blocks)


def expected_maps(what: Ladder) -> list[Section]:
    """How far off landings may be over the workspace with each tool, as the last model says; nothing where it does not.
    """
    rows = [(m.label, m.expected.u95[-1], m.targets - m.tool) for m in what.maps if m.expected is not None]
    if not rows:
        return []
    drawn = figures.slices(
        [(label, values) for label, values, _ in rows], rows[0][2], what.robot.workspace.radius,
        LogScale.of(np.concatenate([values for _, values, _ in rows])),
    )  # fmt: skip
    text = (
        "Radius about each target that holds 95 % of landings. Horizontal slices of the workspace seen from above; "
        "z of the plate in the base frame; one colour scale for all slices."
    )
    figure = Figure(drawn, text, "Coloured maps of the expected miss over slices of the workspace, one row per tool.")
    return [Section("How far off a landing may be", [figure])]


def error_maps(what: Ladder) -> Section:
    """The error over the workspace before and after calibration, with the tool that had the largest error."""
    field = what.maps[what.worst_tool]
    said = ""
    if field.expected is not None:
        said = " The lowest row is what the calibrated model expects: the radius that holds 95 % of landings."
    return Section(
        f"Where the error is, {field.label}",
        [
            Figure(
                figures.maps(what, what.worst_tool, sorted({0, len(what.steps) - 1})),
                "Horizontal slices of the workspace seen from above; z of the TCP in the base frame. Dots are the "
                f"targets, the circle is the working cylinder; one colour scale for all slices.{said}",
                "Coloured maps of the error size over slices of the workspace, before and after calibration.",
            )
        ],
    )


def parameters(fit: Fit, truth: np.ndarray | None = None) -> Section:
    """Every geometric parameter with its σ, and whether the data or the prior determine it.

    Args:
        truth: (nk,) true values, where a virtual robot tells them.
    """
    model = fit.candidate
    mechanism = model.robot.mechanism
    sigma = np.full(len(model.k), np.nan) if model.sigma is None else model.sigma
    prior = priors(mechanism.units) * fit.prior_scale
    header = ["parameter", "nominal", "fitted", "change", "± 1σ", ""]
    header[4:4] = ["true change"] if truth is not None else []
    rows, marked = [], []
    for i, name in enumerate(mechanism.parameters):
        unit, factor, digits = wording.PARAMETER[mechanism.units[i]]
        change = model.errors[i]
        row = [name, *(f"{number(v * factor, digits)} {unit}" for v in (mechanism.nominal[i], model.k[i]))]
        row.append(number(change * factor, digits, "+"))
        if truth is not None:
            row.append(number((truth[i] - mechanism.nominal[i]) * factor, digits, "+"))
        row += [number(sigma[i] * factor, digits), _flag(change, sigma[i], prior[i])]
        rows.append(row)
        if row[-1].startswith("off"):
            marked.append(i)
    blocks: list[SectionBlock] = [
        Text(summary.identified(fit)),
        Table(
            header, rows, "<" + ">" * (len(header) - 2) + "<", marked=marked, folded=f"All {len(rows)} parameters",
            note="“by tolerance”: the data hardly tell this parameter alone, and the manufacturing tolerance decides; "
            "together with others it does count.",
        ),
    ]  # fmt: skip
    lengths = _combined(fit)
    if lengths:
        blocks.insert(1, lengths)
    if model.effects:
        blocks.append(Bullets([f.effect.describe(f.theta) for f in model.effects]))
    return Section("What was identified", blocks)


def _flag(change: float, sigma: float, prior: float) -> str:
    if not np.isfinite(sigma) or sigma == 0:
        return "held"
    if sigma > 0.7 * prior:
        return "by tolerance"
    return "off by more than 3σ" if abs(change) > 3 * sigma else ""


def _combined(fit: Fit) -> Table | None:
    """The best determined parameters and sums, those that moved most in units of their σ."""
    from pcalib.summary import largest_changes

    rows = largest_changes(fit)
    return Table(["moved most", "from nominal", "± 1σ", "in σ"], rows, "<>>>") if rows else None


def unidentifiable(fit: Fit) -> Section:
    """Parameters that these data cannot identify, each with the parameters it cannot be separated from."""
    rows = [
        (name, _mix(main) + (f" and {rest} lesser terms" * (rest > 0)) if main else "nothing: it leaves no trace")
        for name, (main, rest) in fit.identifiability.companions().items()
    ]
    if not rows:
        blocks: list[SectionBlock] = [Text("Nothing: every parameter of this level leaves a trace of its own.")]
    else:
        blocks = [
            Text(
                f"Measurements of this kind cannot separate {len(rows)} parameters from others: they move the plate "
                "alike, and the manufacturing tolerances share the error out between them. For the TCP it does not "
                "matter which of them is to blame. Factors are per m and rad."
            ),
            Table(("parameter", "moves the plate as does"), rows, "<<", folded=f"All {len(rows)}"),
        ]
    return Section("What the data cannot tell", blocks)


def _mix(terms: Mapping[str, float]) -> str:
    """A linear combination in the usual notation: 0.5·a11.y − p1.z."""
    parts = []
    for name, value in terms.items():
        factor = f"{abs(value):.2g}"
        parts.append(("− " if value < 0 else "+ ") + (name if factor == "1" else f"{factor}·{name}"))
    text = " ".join(parts).removeprefix("+ ")
    return f"−{text[2:]}" if text.startswith("− ") else text


def warnings(fits: Sequence[tuple[str, Fit]]) -> Section | None:
    """Warnings of the fits, each under the name of its step; None if there are none."""
    items = [f"{label}: {text}" for label, fit in fits for text in fit.warnings]
    return Section("To be looked at", [Bullets(items, "warning")]) if items else None


def data(fit: Fit, source: str) -> Section:
    """What was measured, and how well the model explains it."""
    rows = [
        [name, str(a.n_rows), size(a.rms_pos), size(a.max_pos), number(a.rms_rot * 1e6, 1), number(a.chi2_dof, 2)]
        for name, a in (("fitted", fit.accuracy), ("held out", fit.check))
        if a is not None
    ]
    note = "χ²/dof near 1: what is left is the instrument's noise."
    return Section(
        "How well the model explains the measurements",
        [Text(source), Table(["poses", "rows", "RMS", "largest", "RMS µrad", "χ²/dof"], rows, "<>>>>>", note=note)],
    )
