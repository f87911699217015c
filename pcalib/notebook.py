"""Results as notebooks show them: the sentence, the tables and the drawings of their reports."""

from __future__ import annotations

from collections.abc import Mapping
from functools import singledispatch
from typing import Any

import numpy as np

from pcalib import inspection
from pcalib.compensation import Compensated
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.diagnosis import page as diagnosis_page
from pcalib.diagnosis import telling
from pcalib.diagnosis.compare import Comparison
from pcalib.diagnosis.diagnose import Diagnosis
from pcalib.fitting.identification import Fit
from pcalib.report import calibration
from pcalib.report.page import Bullets, NamedValues, Page, Section, Table
from pcalib.report.page import html as rendered
from pcalib.wording import figure

ROWS = 10
"""Rows of a table that are shown."""


def html(result: Any) -> str:
    """A result as HTML, with all its text escaped."""
    return rendered(page(result), "notebook")


@singledispatch
def page(result: Any) -> Page:
    """What there is to show of a result.

    Raises:
        TypeError: there is nothing.
    """
    raise TypeError(f"no report shows a {type(result).__name__}")


@page.register
def _(result: Fit) -> Page:
    return Page("", result.headline(), calibration.first_sections(result, result.data))


@page.register
def _(result: Comparison) -> Page:
    return Page("", telling.comparison_sentence(result), diagnosis_page.comparison_sections(result))


@page.register
def _(result: Diagnosis) -> Page:
    return Page("", telling.sentence(result), diagnosis_page.diagnosis_sections(result))


@page.register
def _(result: Compensated) -> Page:
    ok = int(np.sum(result.status == "ok"))
    return Page("", f"Commands for {ok} of {len(result.q)} targets.", [Section("Commands", [_table(columns(result))])])


@page.register
def _(result: Measurements) -> Page:
    found = inspection.inspect(result)
    lines = [f"{f.level}: {f.message} {f.remedy}".rstrip() for f in found.findings]
    about = Section("What the file holds", [NamedValues(dict(inspection.words(found.facts))), Bullets(lines)])
    return Page("", result.source or "Measurements", [about, Section("Rows", [_table(columns(result))])])


@singledispatch
def columns(result: Any) -> Mapping[str, np.ndarray | list[str]]:
    """Columns of a result that is a table, with their units in their names.

    Raises:
        TypeError: it is none.
    """
    raise TypeError(f"a {type(result).__name__} is no table")


@columns.register
def _(result: Measurements) -> Mapping[str, np.ndarray | list[str]]:
    return measurement.written(result)[0]


@columns.register
def _(result: Compensated) -> Mapping[str, np.ndarray | list[str]]:
    commands = {f"q{i + 1}_si": values for i, values in enumerate(result.q.T)}  # rad or m, as the robot has it
    return {**commands, "status": [str(status) for status in result.status]}


def arrow(result: Any) -> Any:
    """A result that is a table, as a `pyarrow.Table`."""
    import pyarrow

    return pyarrow.table(dict(columns(result)))


def _table(columns: Mapping[str, np.ndarray | list[str]]) -> Table:
    n = len(next(iter(columns.values())))
    cells = [[_cell(v) for v in values[:ROWS]] for values in columns.values()]
    note = f"The first {ROWS} of {n} rows." if n > ROWS else ""
    return Table(tuple(columns), list(zip(*cells, strict=True)), ">" * len(columns), note=note)


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "" if value != value else figure(float(value), 6)
