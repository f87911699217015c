"""Reports of comparisons and diagnoses: one self-contained HTML file each."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcalib import report
from pcalib.data.measurement import Measurements
from pcalib.diagnosis import advice, figures, telling
from pcalib.diagnosis.compare import Comparison
from pcalib.diagnosis.diagnose import Diagnosis
from pcalib.diagnosis.evidence import Evidence
from pcalib.diagnosis.patterns import spoken
from pcalib.diagnosis.scatters import Scatter
from pcalib.model import Model
from pcalib.report import Bullets, Figure, NamedValues, Page, Section, Table
from pcalib.report.page import versions
from pcalib.wording import angle, capital, number, size

_TONES = {"nothing_missing": "good", "established": "neutral", "ambiguous": "neutral", "unexplained": "bad"}


def write_comparison(
    path: str | Path, model: Model, data: Measurements, found: Comparison, drawn: Scatter | None = None
) -> None:
    """A page on where a model and measurements differ, which begins with the points of a cell where they are given."""
    page = Page(
        f"Model and measurements of {model.robot.name}",
        telling.comparison_sentence(found),
        [*([] if drawn is None else [_points(drawn)]), *comparison_sections(found)],
        "bad" if telling.hot_cells(found.cells) else "good",
        {"data": data.source, "level": model.level, "effects": _effects(model), **versions()},
    )
    report.write(path, page)


def comparison_sections(found: Comparison) -> list[Section]:
    """Where and how far a model and measurements differ, for this page or another."""
    rows = [("fit", found.fit, found.times_noise[0]), ("check", found.check, found.times_noise[1])]
    figures_table = Table(
        ("rows", "poses", "RMS", "max", "rotation RMS", "times noise"),
        [
            (n, str(a.n_rows), size(a.rms_pos), size(a.max_pos), angle(a.rms_rot), number(t, 2))
            for n, a, t in rows
            if a is not None and t is not None
        ],
        "<>>>>>",
    )
    worst = Table(
        ("line", "set", "x mm", "y mm", "z mm", "error", "rotation", "times noise", ""),
        [
            (
                str(w.line), "check" if w.check else "fit", *(number(1e3 * v, 0) for v in found.position[w.index]),
                size(_length(w.error[:3])), angle(_length(w.error[3:])), number(w.times_noise, 1),
                "far from everything" if w.outlier else "",
            )
            for w in found.worst
        ],
        "><>>>>>>",
    )  # fmt: skip
    return [
        Section("How far apart", [figures_table, Bullets(telling.comparison_details(found))]),
        Section("Where it shows", [_map(found.cells)]),
        Section("Worst poses", [worst]),
    ]


def _points(drawn: Scatter) -> Section:
    by = drawn.variable.replace("temp_", "temperature of ")
    what = capital(f"{spoken(drawn.channel, not drawn.angle)} by {by}")
    said = "What it would have to be off by to explain each reading; circles: means with twice their standard error."
    return Section(what, [Figure(figures.scatter(drawn), said, f"Points of {what} with means")])


def write_evidence(path: str | Path, model: Model, data: Measurements, found: Evidence) -> None:
    """A page on one effect: the evidence for and against it."""
    drawn = Figure(
        figures.evidence(found), "What the effect would explain, and what it leaves.", "Charts of one effect's evidence"
    )
    sections = [Section("The evidence", [Bullets(telling.evidence_lines(found)), drawn])]
    if found.before is not None and found.after is not None:
        rows = telling.before_after(found.before, found.after)
        sections.append(Section("Before and after", [Table(telling.BEFORE_AFTER, rows)]))
    facts = {"data": data.source, "level": model.level, "effects": _effects(model), **versions()}
    title = f"An effect of {model.robot.name}"
    report.write(path, Page(title, telling.evidence_sentence(found), sections, "neutral", facts))


def write_diagnosis(
    path: str | Path, model: Model, found: Diagnosis, file: str, first: Sequence[Section] = ()
) -> None:
    """A page on what is missing from a model, which stands in that file; it begins with the sections `first`."""
    report.write(
        path,
        Page(
            f"Diagnosis of {model.robot.name}",
            telling.sentence(found),
            [*first, *diagnosis_sections(found, file)],
            _TONES[found.verdict],
            {"data": found.problem.given.source, "level": model.level, "effects": _effects(model), **versions()},
        ),
    )


def diagnosis_sections(found: Diagnosis, file: str = "model.toml") -> list[Section]:
    """The reasons of a verdict, for this page or another, and commands that go on with the model of that file."""
    out = [Section("What stands behind it", [Bullets(telling.details(found))])]
    if found.verdict in ("ambiguous", "established"):
        table = Table(("explanation", "in words"), [(" + ".join(e.names), e.words()) for e in found.sets[:10]])
        out.append(Section("Explanations that the data cannot rule out", [table]))
    rows = telling.candidate_rows(found, None, 10_000)
    ranked = Table(telling.CANDIDATES, rows, "<>>>", folded="All candidates")
    out.append(
        Section(
            "Candidates",
            [
                Figure(
                    figures.ranking(found),
                    "Visible size of candidates, each on its own. Orange: it stands in an explanation that fits.",
                    "Bars of candidates by their visible size in noise units",
                ),
                ranked,
            ],
        )
    )
    out.append(Section("Where it shows", [_map(found.cells)]))
    if found.verdict == "nothing_missing":
        limits = Table(("effect", "would have been seen from"), telling.limit_rows(found))
        out.append(Section("What would have been seen", [limits]))
    if found.unavailable:
        out.append(Section("Not considered", [NamedValues({u.name: u.why for u in found.unavailable})]))
    steps = advice.advised(found, file)
    if steps:
        said = [f"{capital(s.why)}: {shlex.join(('pcalib', *s.words))}" if s.words else s.why for s in steps]
        out.append(Section("Next", [Bullets(said)]))
    return out


def _length(error: np.ndarray) -> float:
    """|e| of what was measured; NaN where nothing was."""
    return float(np.sqrt(np.nansum(error**2))) if np.isfinite(error).any() else float("nan")


def _map(cells) -> Figure:
    return Figure(
        figures.heatmap(cells),
        "How much each channel would gain by a smooth function of each variable, in noise units; "
        "the redder, the less it looks like noise; bold: significant with all that was looked at.",
        "Map of channels against variables, coloured by significance",
    )


def _effects(model: Model) -> str:
    return ", ".join(f.spec or f.effect.name for f in model.effects) or "none"
