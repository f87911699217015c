"""The plots of a campaign: how errors are distributed, and how they grow with the tool and with what is swept."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.jobs import charts
from bench.jobs.campaign.summary import RobotGroup, Summary, select, tool_text
from bench.jobs.campaign.sweep import short
from pcalib import units

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BAND = (5.0, 95.0)
"""Percentiles over robots that bands reach from and to."""
MOST_CELLS = 6
MOST_POINTS = 400
"""Most points of one curve; more cannot be told apart in print."""


def write(summary: Summary, folder: Path) -> list[Path]:
    """Draw everything into a folder, SVG and PNG; returns the SVG files.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    return charts.save(_plots(summary), folder)


def _plots(summary: Summary) -> Iterator[tuple[str, Callable[[Figure], None]]]:
    if not any(len(g.rms) for g in summary.groups):
        return
    cells = sorted({g.cell for g in summary.groups})
    if len(cells) > MOST_CELLS:  # some of them, from the first to the last
        cells = [cells[i] for i in np.linspace(0, len(cells) - 1, MOST_CELLS).round().astype(int)]
    yield "distributions", lambda figure: distributions(figure, summary, cells)
    if len({g.tool_length for g in summary.groups}) > 1:
        yield "tool_length", lambda figure: tool_length(figure, summary, cells)
    drawn: list[str] = []
    for path in summary.spec.paths:
        values = {short(cell[path]) for cell in summary.points.values()}
        if len(values) > 1 and not any(_together(summary, path, other) for other in drawn):
            drawn.append(path)
            name = re.sub(r"[^A-Za-z0-9]+", "_", path)
            yield f"against_{name}", lambda figure, path=path: against(figure, summary, path)


def distributions(figure: Figure, summary: Summary, cells: Sequence[int]) -> None:
    """Share of robots whose RMS error is below a value: one row per cell, one column per tool."""
    tools = _tools(summary)
    axes = _panels(figure, len(cells), len(tools), 1.7)
    for row, cell in enumerate(cells):
        for column, tool in enumerate(tools):
            ax, here = axes[row, column], select(summary.groups, cell=cell, tool=tool)
            for method, look in _methods(summary):
                for g in select(here, method=method):
                    if len(g.rms):
                        share = np.linspace(0, 100, min(len(g.rms), MOST_POINTS) + 1)
                        ax.plot(np.percentile(g.rms, share) * 1e6, share, **look | {"marker": None}, label=method)
            charts.logarithmic(ax.xaxis)
            ax.set_ylim(0, 100)
            if row == 0 and here:
                ax.set_title(f"tool {tool_text(here[0])} mm")
            if column == 0:
                ax.set_ylabel("\n".join([*_told(summary.points[cell], summary.spec.paths), "robots below, %"]))
            if row == len(cells) - 1:
                ax.set_xlabel("RMS error of a robot, µm")
    _finish(figure, axes, f"{summary.spec.name}: how many robots are how accurate")


def tool_length(figure: Figure, summary: Summary, cells: Sequence[int]) -> None:
    """RMS error against tool length, median and 5–95 % of the robots, one panel per cell."""
    across = min(len(cells), 3)
    axes = _panels(figure, -(-len(cells) // across), across, 2.2)
    for ax in axes.flat[len(cells) :]:
        ax.set_visible(False)
    for ax, cell in zip(axes.flat, cells, strict=False):
        here = select(summary.groups, cell=cell)
        for method, look in _methods(summary):
            _band(ax, [(g.tool_length * 1e3, g) for g in select(here, method=method)], look, method)
        charts.logarithmic(ax.yaxis)
        ax.set_xlabel("tool length, mm")
        ax.set_title("\n".join(_told(summary.points[cell], summary.spec.paths)), fontsize=8)
    axes[0, 0].set_ylabel("RMS error of a robot, µm")
    _finish(figure, axes, f"{summary.spec.name}: accuracy and tool length")


def against(figure: Figure, summary: Summary, path: str) -> None:
    """RMS error against one swept value, one column per tool, one row per combination of the other values."""
    points = list(summary.points.values())
    others = [p for p in summary.spec.paths if p != path and not _together(summary, p, path)]
    rows = list(dict.fromkeys(tuple(short(point[p]) for p in others) for point in points))[:6]
    tools = _tools(summary)
    axes = _panels(figure, len(rows), len(tools), 2.1)
    values = [point[path] for point in points]
    numeric = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
    names = list(dict.fromkeys(short(v) for v in values))
    for row, combination in enumerate(rows):
        for column, tool in enumerate(tools):
            ax = axes[row, column]
            here = select(summary.groups, tool=tool)
            here = [g for g in here if tuple(short(g.point[p]) for p in others) == combination]
            for method, look in _methods(summary):
                at = select(here, method=method)
                x = [g.point[path] if numeric else names.index(short(g.point[path])) for g in at]
                _band(ax, list(zip(x, at, strict=True)), look, method)
            charts.logarithmic(ax.yaxis)
            if numeric and min(values) > 0 and max(values) > 5 * min(values):
                ax.set_xscale("log")
                ax.set_xticks(sorted(set(values)), [short(v) for v in sorted(set(values))])
                ax.set_xticks([], minor=True)
            elif not numeric:
                ax.set_xticks(range(len(names)), names)
            if row == 0 and here:
                ax.set_title(f"tool {tool_text(here[0])} mm")
            if column == 0:
                told = _told(here[0].point, others) if here else []
                ax.set_ylabel("\n".join([*told, "RMS error, µm"]))
            if row == len(rows) - 1:
                ax.set_xlabel(path)
    _finish(figure, axes, f"{summary.spec.name}: accuracy and {path}")


def _panels(figure: Figure, rows: int, columns: int, height: float) -> Any:
    figure.set_size_inches(2.9 * columns + 1.0, height * rows + 1.1)
    return figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)


def _finish(figure: Figure, axes: Any, title: str) -> None:
    figure.suptitle(title, x=0.01, ha="left", weight="bold")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6))


def _band(ax: Axes, points: Sequence[tuple[float, RobotGroup]], look: dict[str, Any], method: str) -> None:
    usable = sorted(((x, g) for x, g in points if len(g.rms)), key=lambda point: point[0])
    if not usable:
        return
    x = [at for at, _ in usable]
    middle, low, high = (np.array([g.percentile(s) for _, g in usable]) * 1e6 for s in (50.0, *BAND))
    ax.fill_between(x, low, high, color=look["color"], alpha=0.13, lw=0)
    ax.plot(x, middle, **look, label=method)


def _methods(summary: Summary) -> Iterator[tuple[str, dict[str, Any]]]:
    return charts.looks(g.method for g in summary.groups)


def _tools(summary: Summary) -> list[str]:
    lengths = {g.tool: g.tool_length for g in summary.groups}
    return sorted(lengths, key=lambda tool: (lengths[tool], tool))[:4]


def _told(point: Mapping[str, Any], paths: Sequence[str]) -> list[str]:
    """Swept values as text with their units: 'sigma length 0.1 mm'."""
    out = []
    for path in paths:
        quantity, unit = units.split(path.rpartition(".")[2])
        told = units.spoken(unit.suffix) if unit else ""
        out.append(f"{quantity.replace('_', ' ')} {short(point[path])} {told}".strip().replace(" °", "°"))
    return out


def _together(summary: Summary, a: str, b: str) -> bool:
    """Whether two paths vary together: one value of the one for each of the other."""
    pairs = {(short(point[a]), short(point[b])) for point in summary.points.values()}
    return len(pairs) == len({pair[0] for pair in pairs}) == len({pair[1] for pair in pairs})
