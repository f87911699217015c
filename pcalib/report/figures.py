"""Figures as SVG inside a page. Text and lines take the colours of the page, which may be light or dark."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pcalib.ladder import Ladder
from pcalib.palette import ANCHORS, SERIES, LogScale
from pcalib.wording import round_size, short, size

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

INK, QUIET, RULE, PAPER = "#010203", "#040506", "#070809", "#0a0b0c"
"""Placeholder colours; `_inline` replaces them by the colours of the page."""
_VARIABLES = {INK: "var(--ink)", QUIET: "var(--quiet)", RULE: "var(--rule)", PAPER: "var(--paper)"}
_STYLE: Any = {
    "svg.fonttype": "none", "svg.hashsalt": "pcalib", "font.size": 10, "font.family": "sans-serif",
    "text.color": INK, "axes.labelcolor": QUIET, "axes.edgecolor": RULE, "xtick.color": QUIET, "ytick.color": QUIET,
    "axes.titlecolor": INK, "axes.titlesize": 10.5, "axes.spines.top": False, "axes.spines.right": False,
    "grid.color": RULE, "grid.linewidth": 0.8, "xtick.major.size": 0, "ytick.major.size": 0, "axes.axisbelow": True,
    "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none", "legend.frameon": False,
    "text.parse_math": False,
}  # fmt: skip


@contextmanager
def drawing(width: float, height: float) -> Iterator[tuple[Drawing, list[str]]]:
    """An empty matplotlib figure [inch] in the page's style; the list gets its SVG when the block ends."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    out: list[str] = []
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(figure)
        yield figure, out
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
        out.append(_inline(buffer.getvalue()))


def _inline(svg: str) -> str:
    """The drawing alone, without prologue, links and identifiers, which other figures of the page may have too."""
    svg = svg[svg.index("<svg") :].strip()
    svg = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r'<g id="[^"]*">', "<g>", svg)
    svg = re.sub(r'(<svg[^>]*?)\swidth="[^"]*"', r"\1", svg)
    svg = re.sub(r'(<svg[^>]*?)\sheight="[^"]*"', r"\1", svg)
    svg = re.sub(r"(\d\.\d\d)\d+", r"\1", svg)  # hundredths of a point are finer than any screen
    for stand_in, variable in _VARIABLES.items():
        svg = svg.replace(stand_in, variable)
    return svg


def ladder(what: Ladder) -> str:
    """RMS and maximum of every tool over the steps, logarithmic."""
    with drawing(8.6, 3.5) as (figure, out):
        axes = figure.subplots()
        n = np.arange(len(what.steps))
        for t, m in enumerate(what.maps):
            colour = SERIES[t % len(SERIES)]
            axes.plot(n, m.rms * 1e6, color=colour, lw=2.2, marker="o", ms=6, label=f"{m.label}", zorder=3)
            axes.plot(n, m.max * 1e6, color=colour, lw=0, marker="_", ms=11, mew=1.8, zorder=3)
            axes.vlines(n, m.rms * 1e6, m.max * 1e6, color=colour, lw=1.0, alpha=0.45)
        if what.floor:
            axes.axhline(what.floor * 1e6, color=QUIET, lw=1, ls=(0, (4, 3)))
            axes.annotate(
                f"instrument 1σ, {size(what.floor)}", (-0.35, what.floor * 1e6), (0, 4), textcoords="offset points",
                fontsize=8.5, color=QUIET,
            )  # fmt: skip
        axes.set_yscale("log")
        axes.set_xticks(n, [short(s.label, 90 // len(n)) for s in what.steps])
        axes.tick_params(axis="x", colors=INK)
        axes.set_xlim(-0.4, len(n) - 0.6)
        _micrometres(axes.yaxis, LogScale.of(np.concatenate([what.rms.ravel(), what.max.ravel()])))
        axes.grid(axis="y")
        axes.set_title("TCP error: RMS (line) up to the largest (dash)", loc="left")
        axes.spines["left"].set_visible(False)
        axes.legend(loc="upper right", ncols=len(what.maps), bbox_to_anchor=(1.0, 1.14), borderaxespad=0)
    return out[0]


def _micrometres(axis: Any, scale: LogScale) -> None:
    from matplotlib.ticker import NullLocator

    axis.set_ticks(scale.decades * 1e6, [round_size(v) for v in scale.decades])
    axis.set_minor_locator(NullLocator())
    axis.axes.set_ylim(scale.low * 0.8e6, scale.high * 1e6)


def maps(what: Ladder, tool: int, steps: Sequence[int], planes: int = 4) -> str:
    """The size of the error over horizontal slices of the workspace, a row per step, one colour scale for all; below
    them how far off the model of the last step says that the TCP may be, where it says so.

    Args:
        tool: index of the map; steps: which steps to show; planes: how many heights at most.
    """
    field = what.maps[tool]
    rows = [(what.steps[s].label, field.distance[s]) for s in steps]
    if field.expected is not None and np.isfinite(field.expected.u95[steps[-1]]).any():
        rows.append(("expected, 95 %", field.expected.u95[steps[-1]]))
    seen = np.concatenate([values for _, values in rows])
    scale = LogScale.of(np.concatenate([what.rms.ravel(), seen[np.isfinite(seen)].max(initial=0.0)[None]]))
    return slices(rows, field.targets, what.robot.workspace.radius, scale, planes)


def slices(
    rows: Sequence[tuple[str, np.ndarray]], targets: np.ndarray, radius: float, scale: LogScale, planes: int = 4
) -> str:
    """Lengths over horizontal slices of the workspace, one row of slices for each field.

    Args:
        rows: name and values (P,) [m] of each field.
        targets: (P, 3) [m]; radius: [m] of the working cylinder; planes: how many heights at most.
    """
    from matplotlib.colors import LinearSegmentedColormap, LogNorm
    from matplotlib.ticker import NullLocator

    heights = np.unique(np.round(targets[:, 2], 6))
    heights = heights[np.unique(np.linspace(0, len(heights) - 1, min(planes, len(heights))).astype(int))][::-1]
    colours = LinearSegmentedColormap.from_list("error", ANCHORS)
    norm = LogNorm(scale.low * 1e6, scale.high * 1e6)
    radius *= 1e3
    with drawing(8.6, 0.55 + 2.1 * len(rows)) as (figure, out):
        grid = np.atleast_2d(figure.subplots(len(rows), len(heights), squeeze=False))
        for r, (label, values) in enumerate(rows):
            for c, height in enumerate(heights):
                axes = grid[r, c]
                here = np.abs(targets[:, 2] - height) < 1e-5
                _slice(axes, targets[here, :2] * 1e3, values[here] * 1e6, colours, norm)
                axes.add_patch(_circle(radius))
                axes.set(xlim=(-1.06 * radius, 1.06 * radius), ylim=(-1.06 * radius, 1.06 * radius), aspect="equal")
                axes.set_axis_off()
                if r == 0:
                    axes.set_title(f"z = {height * 1e3:.0f} mm".replace("-", "−"), fontsize=9, color=QUIET)
                if c == 0:
                    said = short(label, 28)
                    axes.text(-0.06, 0.5, said, rotation=90, va="center", ha="right", transform=axes.transAxes)
        from matplotlib.cm import ScalarMappable

        bar = figure.colorbar(ScalarMappable(norm, colours), ax=grid, shrink=0.7, aspect=18, pad=0.015)
        bar.set_ticks(list(scale.decades * 1e6), labels=[round_size(v) for v in scale.decades])
        bar.ax.yaxis.set_minor_locator(NullLocator())
        bar.outline.set_visible(False)
    return out[0]


def _slice(axes: Any, at: np.ndarray, values: np.ndarray, colours: Any, norm: Any) -> None:
    """Filled contours between targets, in the logarithm; the targets themselves as dots."""
    good = np.isfinite(values) & (values > 0)
    at, values = at[good], values[good]
    if len(at) >= 4 and np.linalg.matrix_rank(at - at.mean(axis=0), tol=1e-6) == 2:
        from matplotlib.tri import Triangulation

        mesh = Triangulation(at[:, 0], at[:, 1])
        corners = at[mesh.triangles]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
        mesh.set_mask(longest > 2.1 * np.median(longest))  # nothing is drawn across what was not reached
        levels = np.geomspace(norm.vmin, norm.vmax, 31)
        axes.tricontourf(mesh, np.clip(values, norm.vmin, norm.vmax), levels=levels, cmap=colours, norm=norm)
    axes.scatter(*at.T, c=colours(norm(values)), s=9, lw=0.4, edgecolors=PAPER, zorder=3)


def _circle(radius: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((0, 0), radius, fill=False, edgecolor=RULE, lw=1)
