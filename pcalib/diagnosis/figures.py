"""Drawings of a diagnosis, in the style of the reports."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from pcalib.diagnosis import telling
from pcalib.diagnosis.diagnose import Diagnosis, Why
from pcalib.diagnosis.evidence import Evidence
from pcalib.diagnosis.patterns import CHANNELS, HOT, Cell, spoken
from pcalib.diagnosis.scatters import Scatter
from pcalib.diagnosis.separation import TOLD, Separation
from pcalib.palette import SERIES
from pcalib.report.figures import INK, PAPER, QUIET, RULE, drawing

_WARM = SERIES[1]
_BLUE = SERIES[0]


def heatmap(cells: tuple[Cell, ...]) -> str:
    """Channels against variables, coloured by −log10 of the corrected p."""
    sliding = any(c.sliding for c in cells)
    variables = list(dict.fromkeys(c.variable for c in cells))
    channels = [c for c in CHANNELS if any(cell.channel == c for cell in cells)]
    value = {(c.channel, c.variable): c for c in cells}
    with drawing(7.2, 0.9 + 0.42 * len(variables)) as (figure, out):
        axes = figure.subplots()
        for i, variable in enumerate(variables):
            for j, channel in enumerate(channels):
                cell = value.get((channel, variable))
                if cell is None:
                    continue
                strength = min(-np.log10(max(cell.p, 1e-4)) / 3.0, 1.0)
                axes.add_patch(_tile(j, i, strength))
                bold = cell.p < HOT
                axes.text(
                    j,
                    i,
                    f"{cell.s:.1f}",
                    ha="center",
                    va="center",
                    fontsize=9.5,
                    color=INK,
                    weight="bold" if bold else None,
                )
        axes.set_xlim(-0.5, len(channels) - 0.5)
        axes.set_ylim(len(variables) - 0.5, -0.5)
        axes.set_xticks(range(len(channels)), [fill(spoken(c, sliding), 20) for c in channels], fontsize=9)
        names = [v.replace("temp_", "temperature of ") for v in variables]
        axes.set_yticks(range(len(variables)), names, fontsize=9)
        axes.xaxis.tick_top()
        for side in axes.spines.values():
            side.set_visible(False)
    return out[0]


def separation(found: Separation) -> str:
    """Effects against effects, coloured by the noise units that a fit with the one leaves of the other."""
    n = len(found.names)
    with drawing(2.4 + 0.46 * n, 1.9 + 0.34 * n) as (figure, out):
        axes = figure.subplots()
        for i in range(n):
            for j in range(n):
                left = float(found.matrix[i, j])
                axes.add_patch(_tile(j, i, min(left / (2 * TOLD), 1.0)))
                text = "=" if found.alias[i, j] else f"{left:.1f}" if left < 10 else f"{left:.0f}"
                weight = "bold" if i == j else None
                axes.text(j, i, text, ha="center", va="center", fontsize=8, color=INK, weight=weight)
        axes.set_xlim(-0.5, n - 0.5)
        axes.set_ylim(n - 0.5, -0.5)
        axes.set_xticks(range(n), found.names, fontsize=8, rotation=90)
        axes.set_yticks(range(n), found.names, fontsize=8)
        axes.xaxis.tick_top()
        axes.set_xlabel("fitted in its place (diagonal: what the geometry leaves visible; =: exact alias)", fontsize=8)
        axes.set_ylabel("acting at its usual size", fontsize=8)
        for side in axes.spines.values():
            side.set_visible(False)
    return out[0]


def _tile(x: float, y: float, strength: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle(
        (x - 0.47, y - 0.44), 0.94, 0.88, facecolor=SERIES[2], alpha=0.06 + 0.7 * strength, edgecolor=RULE, lw=0.6
    )


def ranking(found: Diagnosis) -> str:
    """The twelve candidates of largest s as bars; those that stand in an adequate set are coloured."""
    shown = [f for f in telling.one_per_effect(found) if f.why is not Why.UNSEEN][:12]
    with drawing(7.2, 0.8 + 0.3 * len(shown)) as (figure, out):
        axes = figure.subplots()
        for i, f in enumerate(shown):
            axes.barh(i, f.s, height=0.62, color=_WARM if f.adequate else _BLUE, alpha=1.0 if f.adequate else 0.45)
            axes.text(f.s, i, f"  {f.s:.1f}", va="center", fontsize=9, color=QUIET)
        axes.set_yticks(range(len(shown)), [f.candidate.spec for f in shown], fontsize=9)
        axes.invert_yaxis()
        axes.set_xlabel("s: visible size in noise units")
        axes.grid(axis="x")
    return out[0]


def evidence(e: Evidence) -> str:
    """The added-variable plot and, for drives and rods, the deviation against the variable that tells most."""
    panels = [p for p in (e.plot, e.by_variable) if p is not None]
    with drawing(4.2 * max(len(panels), 1), 3.6) as (figure, out):
        axes = figure.subplots(1, max(len(panels), 1), squeeze=False)[0]
        i = 0
        if e.plot is not None:
            _added_variable(axes[i], e)
            i += 1
        if e.by_variable is not None:
            _by_variable(axes[i], e)
    return out[0]


def _added_variable(axes: Any, e: Evidence) -> None:
    plot = e.plot
    assert plot is not None
    x, y = plot.predicted, plot.residual
    axes.plot(x, y, ".", ms=3, color=_BLUE, alpha=0.45)
    ends = np.array([x.min(), x.max()])
    axes.plot(ends, ends, color=_WARM, lw=1.8)
    edges = np.quantile(x, np.linspace(0, 1, 13))
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, 11)
    for b in range(12):
        mine = which == b
        if mine.sum() > 3:
            mean, error = y[mine].mean(), y[mine].std() / np.sqrt(mine.sum())
            axes.errorbar(x[mine].mean(), mean, 2 * error, fmt="o", ms=4.5, color=INK, mec=PAPER, lw=1)
    axes.set_xlabel(f"what {e.candidate.name} predicts [σ]")
    axes.set_ylabel("what is left of the readings [σ]")
    axes.set_title("Added-variable plot", loc="left")
    axes.grid()


def _by_variable(axes: Any, e: Evidence) -> None:
    plot = e.by_variable
    assert plot is not None
    factor, variable = plot.axis
    drives = plot.channel == "actuator"
    what, unit = spoken("actuator", plot.sliding) if drives else "rods", "µrad" if drives and not plot.sliding else "µm"
    for i, name in enumerate(plot.names):
        mine = plot.series == i
        order = np.argsort(plot.x[mine])
        colour = SERIES[i % len(SERIES)]
        axes.plot(plot.x[mine] * factor, plot.y[mine] * 1e6, ".", ms=4, color=colour, alpha=0.6, label=name)
        axes.plot(plot.x[mine][order] * factor, plot.curve[mine][order] * 1e6, "-", lw=1.2, color=colour)
    axes.set_xlabel(variable)
    axes.set_ylabel(f"apparent error of {what} [{unit}]")
    axes.set_title("Where it tells most", loc="left")
    axes.legend(fontsize=8, ncols=3)
    axes.grid()


def scatter(plot: Scatter) -> str:
    """The points of a cell, with means over a twelfth of them each and twice their standard error."""
    unit = "µrad" if plot.angle else "µm"
    with drawing(7.2, 3.4) as (figure, out):
        axes = figure.subplots()
        for i, name in enumerate(plot.names):
            mine = plot.series == i
            axes.plot(plot.x[mine], 1e6 * plot.y[mine], ".", ms=4, color=SERIES[i % len(SERIES)], alpha=0.5, label=name)
            _means(axes, plot.x[mine], 1e6 * plot.y[mine], SERIES[i % len(SERIES)])
        axes.set_xlabel(plot.axis)
        axes.set_ylabel(f"apparent error of {spoken(plot.channel, not plot.angle)} [{unit}]")
        axes.legend(fontsize=8, ncols=3)
        axes.grid()
    return out[0]


def _means(axes: Any, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    """Means of points in groups of as many each, ordered by x, with twice their standard error."""
    order = np.argsort(x, kind="stable")
    for part in np.array_split(order, min(12, max(len(x) // 4, 1))):
        error = 2 * y[part].std() / np.sqrt(len(part))
        axes.errorbar(x[part].mean(), y[part].mean(), error, fmt="o", ms=5, color=colour, mec=PAPER, lw=1.4)


def save(path: Path, svg: str) -> None:
    """Write a drawing that stands alone, in dark ink on white.

    Raises:
        InputError: a suffix other than .svg, or the file cannot be written.
    """
    from pcalib import files
    from pcalib.errors import InputError

    if path.suffix.lower() not in ("", ".svg"):  # devices have no suffix
        raise InputError(f"drawings are SVG, not '{path.suffix}'", file=path, remedy="name a file that ends with .svg")
    for name, colour in (("ink", "#16181d"), ("quiet", "#5b616b"), ("rule", "#d9dde3"), ("paper", "#ffffff")):
        svg = svg.replace(f"var(--{name})", colour)
    svg = svg.replace(
        "<svg",
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" style="background:#ffffff"',
        1,
    )
    files.write_text(path, svg)
