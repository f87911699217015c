"""The figures of the benchmark: power against size, and which effect is taken for which."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.jobs import charts
from bench.jobs.diagnosis_benchmark.results import OTHER, Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = charts.STYLE | {
    "axes.titlesize": 10.5, "axes.titleweight": "bold", "axes.grid": False,
    "lines.linewidth": 1.8, "lines.markersize": 5,
}  # fmt: skip
DESIGNS = {
    "rich": ("rich plan, full poses", "#0072B2", "o"),
    "rich_position": ("rich plan, positions only", "#56B4E9", "s"),
    "plain": ("plain plan, full poses", "#D55E00", "^"),
    "plain_position": ("plain plan, positions only", "#E69F00", "v"),
}


def save(found: Results, folder: Path) -> list[Path]:
    """Draw the figures into a folder as PNG."""
    drawn = {
        "diagnosis_power": lambda figure: power(figure, found),
        "diagnosis_confusion": lambda figure: confusion(figure, found),
    }
    return charts.save(drawn.items(), folder, (".png",), STYLE)


def power(figure: Figure, found: Results) -> None:
    """Draw the share of data sets in which the truth is named, against its visible size."""
    figure.set_size_inches(10.5, 4.2)
    axes = figure.subplots(1, 2, sharey=True)
    for axis in axes:
        axis.axhline(90, color="#999999", linewidth=0.8, linestyle="--")
        axis.axvline(6, color="#999999", linewidth=0.8, linestyle="--")
        axis.set(xlabel="visible size of the hidden effect, s [noise units]", xlim=(-0.4, 20.4), ylim=(-2, 102))
        axis.set_xticks([0, 3, 4, 5, 6, 8, 12, 20])
        axis.grid(axis="y", color="#e4e4e4", linewidth=0.6)
    axes[0].set_ylabel("data sets [%]")
    for design, (label, colour, marker) in DESIGNS.items():
        curve = np.array(found.power([design]))
        if not len(curve):
            continue
        named = curve[curve[:, 0] > 0] if len(curve) else curve
        axes[0].plot(named[:, 0], 100 * named[:, 2], color=colour, marker=marker, label=label)
        axes[1].plot(curve[:, 0], 100 * curve[:, 1], color=colour, marker=marker, label=label)
    axes[0].set_title("The truth is named, alone or fairly beside its rivals")
    axes[1].set_title("Something is found missing")
    axes[1].annotate("5 % of false alarms", (0, 5), (1.2, 12), fontsize=8, color="#666666",
                     arrowprops={"arrowstyle": "-", "color": "#999999"})  # fmt: skip
    axes[0].legend(loc="lower right")


def confusion(figure: Figure, found: Results) -> None:
    """Draw the answers by truth."""
    from matplotlib.patches import Rectangle

    c = found.confusion()
    figure.set_size_inches(9.6, 8.6)
    axis = figure.subplots()
    axis.imshow(100 * c.share, cmap="Blues", vmin=0, vmax=100, aspect="auto")
    listed = len(c.columns) - len(OTHER)
    for (i, j), share in np.ndenumerate(c.share):
        if share >= 0.005:
            axis.text(j, i, f"{100 * share:.0f}", ha="center", va="center", fontsize=7.5,
                      color="white" if share > 0.55 else "#222222")  # fmt: skip
    for i in range(len(c.rows)):
        right = i if i < listed else c.columns.index("unexplained")
        axis.add_patch(Rectangle((right - 0.5, i - 0.5), 1, 1, fill=False, edgecolor="#D55E00", linewidth=1.2))
    axis.axvline(listed - 0.5, color="#666666", linewidth=0.8)
    axis.axhline(listed - 0.5, color="#666666", linewidth=0.8)
    axis.set_xticks(range(len(c.columns)), [name.replace("_", " ") for name in c.columns], rotation=50, ha="right")
    axis.set_yticks(
        range(len(c.rows)), [f"{name.replace('_', ' ')}  ({n})" for name, n in zip(c.rows, c.count, strict=True)]
    )
    axis.set_xlabel("answer; rivals that the data cannot tell apart share it")
    axis.set_ylabel("hidden in MuJoCo (data sets); below the line: in no library")
    axis.set_title("What is answered, in % of data sets with s from 6 to 12 (all designs); framed: right")
    axis.spines[:].set_visible(False)
    axis.tick_params(length=0)
