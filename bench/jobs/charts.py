"""What the charts of all studies share: style, one look per method, plain numbers on logarithmic axes, saving."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcalib import files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE: Any = {
    "font.size": 9, "axes.titlesize": 10, "axes.titlelocation": "left", "axes.grid": True, "grid.color": "#dddddd",
    "grid.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False, "lines.linewidth": 1.6,
    "lines.markersize": 4.5, "legend.frameon": False, "svg.hashsalt": "pcbench", "text.parse_math": False,
}  # fmt: skip
_UNCALIBRATED, _CLASSICAL, _PARALLEL = ("#D55E00", "-", "s"), ("#0072B2", "--", "D"), ("#56B4E9", "--", "d")
_LINEAR, _COMPLETE = ("#009E73", "-.", "^"), ("#000000", "-", "o")
LOOKS = {
    "nominal": _UNCALIBRATED, "none": _UNCALIBRATED, "classical": _CLASSICAL, "model24": _PARALLEL,
    "paper": _LINEAR, "paper_linear_first_order": _LINEAR, "linear_weighted_first_order": ("#117733", ":", "<"),
    "gauss_newton_exact": ("#CC79A7", ":", "v"), "complete": _COMPLETE, "map_exact": _COMPLETE,
    "map_position_one_tool": ("#999999", "--", "x"), "map_position_three_tools": ("#E69F00", "-", "P"),
}  # fmt: skip
"""Colour, line and marker of each method, alike in all charts; colour-blind readers can tell them apart."""
OTHERS = ("#CC79A7", "#E69F00", "#999999", "#882255", "#44AA99", "#117733")


def looks(methods: Iterable[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each method with its look; methods that `LOOKS` does not know take the other colours in turn."""
    others = 0
    for method in dict.fromkeys(methods):
        if method in LOOKS:
            look = LOOKS[method]
        else:
            look = (OTHERS[others % len(OTHERS)], ":" if others % 2 else "-", "o")
            others += 1
        yield method, dict(zip(("color", "linestyle", "marker"), look, strict=True))


def save(
    drawn: Iterable[tuple[str, Callable[[Figure], None]]],
    folder: Path,
    suffixes: Sequence[str] = (".svg", ".png"),
    style: Any = STYLE,
) -> list[Path]:
    """Draw charts and write each into a folder, whole or not at all; returns the files with the first suffix.

    Args:
        drawn: name of each chart and what draws it into an empty figure.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    import matplotlib
    from matplotlib.figure import Figure

    files.check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    out = []
    with matplotlib.rc_context(style):
        for name, draw in drawn:
            figure = Figure(layout="constrained")
            draw(figure)
            figure.draw_without_rendering()
            figure.set_layout_engine("none")  # laid out once for all files
            for suffix in suffixes:
                about: Any = {"Date": None} if suffix == ".svg" else {"Software": None}
                with files.atomic(folder / f"{name}{suffix}") as temporary:
                    figure.savefig(temporary, format=suffix[1:], dpi=150, metadata=about)
            out.append(folder / f"{name}{suffixes[0]}")
    return out


def logarithmic(axis: Any, ticks: Sequence[float] = ()) -> None:
    """Make an axis logarithmic, with plain numbers at the decades, or at `ticks` alone."""
    from matplotlib.ticker import NullLocator

    (axis.axes.set_xscale if axis.axis_name == "x" else axis.axes.set_yscale)("log")
    axis.set_major_formatter(lambda value, _: f"{value:g}" if value < 1 else f"{value:,.0f}".replace(",", " "))
    axis.set_minor_locator(NullLocator())
    if ticks:
        axis.set_ticks(ticks, [f"{v:g}" for v in ticks])


def legend_above(figure: Figure, ax: Axes, title: str, columns: int = 2) -> None:
    """The message of a chart, and one legend for all panels under it."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper left", ncols=columns, fontsize=8, title=title, alignment="left",
        title_fontproperties={"size": 10.5, "weight": "bold"},
    )  # fmt: skip
