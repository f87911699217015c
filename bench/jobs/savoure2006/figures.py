"""The figures of the reproduction: one message each, said in its title."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.jobs.savoure2006 import study, trial
from bench.jobs.savoure2006.study import Scores, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOOK: Mapping[str, Any] = {
    "none": {"color": "#D55E00", "linestyle": "-", "marker": "s"},
    "classical": {"color": "#0072B2", "linestyle": "--", "marker": "D"},
    "model24": {"color": "#56B4E9", "linestyle": "--", "marker": "d"},
    "paper_linear_first_order": {"color": "#009E73", "linestyle": "-.", "marker": "^"},
    "linear_weighted_first_order": {"color": "#009E73", "linestyle": "-.", "marker": "^"},
    "gauss_newton_exact": {"color": "#CC79A7", "linestyle": ":", "marker": "v"},
    "map_exact": {"color": "#000000", "linestyle": "-", "marker": "o"},
    "map_position_one_tool": {"color": "#999999", "linestyle": "--", "marker": "x"},
    "map_position_three_tools": {"color": "#E69F00", "linestyle": "-", "marker": "P"},
}
"""One look per method in all figures; colours that the colour-blind can tell apart, and lines that print in grey."""
SHORT = {
    "none": "no calibration",
    "classical": "classical (q0, l)",
    "paper_linear_first_order": "improved: the paper's linear fit, first order",
    "gauss_newton_exact": "Gauss–Newton on the base of 6, exact inverse",
    "map_exact": "all 9 with priors (MAP), exact inverse",
}
STYLE: Any = {
    "font.size": 9, "axes.titlesize": 10.5, "axes.titleweight": "bold", "axes.titlelocation": "left", "axes.grid": True,
    "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False,
    "lines.linewidth": 1.6, "lines.markersize": 4.5, "legend.frameon": False, "svg.hashsalt": "pcalib",
}  # fmt: skip


def save(found: Study, folder: Path) -> list[Path]:
    """Draw everything into a folder as PNG and SVG; returns the PNG files."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    draw: dict[str, Callable[[], Figure]] = {
        "fig5_h0": lambda: curves(found.ladder[0.0], 0.0, found.seeds),
        "fig6_h200": lambda: curves(found.ladder[0.2], 0.2, found.seeds),
        "fig7_noise_and_poses": lambda: noise_and_poses(found),
        "scaling": lambda: scaling(found),
        "other_tools": lambda: other_tools(found),
        "delta": lambda: delta(found),
    }
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with plt.rc_context(STYLE):
        for name, make in draw.items():
            figure = make()
            for suffix in (".svg", ".png"):
                figure.savefig(
                    folder / f"{name}{suffix}", dpi=160, metadata={"Date": None} if suffix == ".svg" else None
                )
            paths.append(folder / f"{name}.png")
            plt.close(figure)
    return paths


def curves(scores: Scores, h: float, seeds: int) -> Figure:
    """Figures 5 and 6: x-error over the stroke, above as the paper draws it, below what it cannot show."""
    from matplotlib import pyplot as plt

    figure, (above, below) = plt.subplots(2, 1, figsize=(6.4, 6.0), sharex=True, layout="constrained")
    q = trial.Q_CHECKED / trial.DEGREE

    def plot(ax: Axes, keys: Sequence[str], factor: float) -> None:
        for key in keys:
            look: Any = LOOK[key] | {"marker": None}
            s = scores[key, h]
            ax.plot(q, factor * s.curve, label=f"{SHORT[key]}: RMS {_length(s.rms)}, max {_length(s.max)}", **look)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.42 * (high - low))
        ax.legend(loc="upper left", fontsize=8)
        ax.axhline(0, color="#666666", linewidth=0.6, zorder=0)

    plot(above, ["none", "classical", "paper_linear_first_order"], 1e3)
    plot(below, ["paper_linear_first_order", "gauss_newton_exact", "map_exact"], 1e6)
    above.set_title(f"Tool h = {1e3 * h:.0f} mm: identifying the parallelogram removes the error …")
    below.set_title("… and priors with the exact inverse remove what is left of it")
    above.set_ylabel("x-error of the TCP [mm]")
    below.set_ylabel("x-error of the TCP [µm]")
    below.set_xlabel(f"actuator angle q [°]      (curves: one noise seed; RMS and max: mean of {seeds})")
    below.set_xticks(np.arange(-45, 46, 15))
    return figure


def noise_and_poses(found: Study) -> Figure:
    """Figure 7: what less noise or more poses gain."""
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.3), sharey=True, layout="constrained")
    _axis(left, found.noise, factor=1e6 * trial.SIGMA_POS)
    _axis(right, found.poses)
    left.set_xlabel("measuring noise, 1σ [µm]  (and as many 0.001°)")
    right.set_xlabel("measured poses")
    left.set_ylabel("RMS x-error of the TCP [µm], h = 200 mm")
    left.set_title("19 poses")
    right.set_title("noise 3 µm, 0.003°")
    _ticks(left, [1e6 * trial.SIGMA_POS * f for f in found.noise])
    _ticks(right, list(found.poses))
    _legend_above(figure, left, "Better data help the fit that has no bias, and hardly any other")
    return figure


def scaling(found: Study) -> Figure:
    """Why: the bias of the linear method grows as the square of the errors and ignores the number of poses."""
    from matplotlib import pyplot as plt

    figure, ax = plt.subplots(figsize=(6.8, 5.0), layout="constrained")
    _axis(ax, found.scaling, keys=["paper_linear_first_order", "gauss_newton_exact", "map_exact"])
    _axis(ax, found.scaling_poses, keys=["paper_linear_first_order", "gauss_newton_exact", "map_exact"], faint=True)
    largest = max(found.scaling)
    level = 1.8e6 * found.scaling[largest]["paper_linear_first_order", study.LONG].rms
    at = largest * np.array([0.2, 1.0])
    ax.plot(at, level * (at / largest) ** 2, color="#666666", linewidth=1)
    ax.annotate("∝ error²", (0.45 * largest, 0.2 * level), xytext=(-8, 6), textcoords="offset points", ha="right")
    ax.set_xlabel("size of the geometric errors, Table 2 = 1")
    ax.set_ylabel("RMS x-error of the TCP [µm], h = 200 mm")
    _ticks(ax, list(found.scaling))
    ax.plot([], [], color="#444444", label="19 poses (thick)", linewidth=1.6)
    ax.plot([], [], color="#444444", label="181 poses (thin, open markers)", linewidth=0.8)
    _legend_above(figure, ax, "The linear method's error is bias: ∝ error², whatever the number of poses", columns=1)
    return figure


def other_tools(found: Study) -> Figure:
    """Measured with one tool, used with others."""
    from matplotlib import pyplot as plt

    figure, ax = plt.subplots(figsize=(6.8, 5.2), layout="constrained")
    lengths = 1e3 * np.array(study.USED_AT)
    for key in SHORT:
        rms = [1e6 * found.transfer[key, h].rms for h in study.USED_AT]
        ax.plot(lengths, rms, label=SHORT[key], **LOOK[key])
    ax.set_yscale("log")
    ax.axvline(1e3 * study.MEASURED_AT, color="#666666", linewidth=0.8, zorder=0)
    ax.annotate("measured here", (1e3 * study.MEASURED_AT, 1), xycoords=("data", "axes fraction"), xytext=(4, -10),
                textcoords="offset points", color="#444444", fontsize=8)  # fmt: skip
    ax.set_xlabel("tool length h in use [mm]")
    ax.set_ylabel("RMS x-error of the TCP [µm]")
    _decades(ax)
    _legend_above(figure, ax, "Measured with h = 100 mm: only true geometry carries over to other tools", columns=1)
    return figure


def delta(found: Study) -> Figure:
    """The Delta ladder at three tools."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(found.delta), figsize=(10.0, 4.9), sharey=True, layout="constrained")
    lengths = [1e3 * h for h in trial.DELTA_TOOLS]
    for ax, (name, scores) in zip(axes, found.delta.items(), strict=True):
        for key, label in ((m.key, m.label) for m in trial.DELTA_METHODS):
            rms = [1e6 * scores[key, h].rms for h in trial.DELTA_TOOLS]
            ax.plot(lengths, rms, label=label, **LOOK[key])
        length, angle = trial.DELTA_ERRORS[name]
        ax.set_yscale("log")
        ax.set_title(f"errors {1e3 * length:g} mm, {angle / trial.DEGREE:g}° (1σ)")
        ax.set_xlabel("tool length in use [mm]")
        ax.set_xticks(lengths)
    axes[0].set_ylabel("RMS distance of TCP and target [µm]")
    _decades(axes[0])
    _legend_above(figure, axes[0], "Delta, measured at the plate: a model that knows no tilt fails with a tool")
    return figure


def _axis(
    ax: Axes,
    values: Mapping[float, Scores],
    keys: Sequence[str] | None = None,
    factor: float = 1.0,
    faint: bool = False,
) -> None:
    """RMS by the values of a study, both logarithmic."""
    for key in keys or [m.key for m in study.COMPARED]:
        rms = [1e6 * scores[key, study.LONG].rms for scores in values.values()]
        more = {"linewidth": 0.8, "markerfacecolor": "white"} if faint else {"label": SHORT[key]}
        look: Any = LOOK[key] | more
        ax.plot(factor * np.array(list(values)), rms, **look)
    ax.set_xscale("log")
    ax.set_yscale("log")
    _decades(ax)


def _ticks(ax: Axes, values: Sequence[float]) -> None:
    """The values of the study and no others along a logarithmic axis."""
    ax.set_xticks(values, [f"{v:g}" for v in values])
    ax.minorticks_off()


def _decades(ax: Axes) -> None:
    """Plain numbers on a logarithmic axis."""
    from matplotlib.ticker import FuncFormatter

    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))


def _legend_above(figure: Figure, ax: Axes, title: str, columns: int = 2) -> None:
    """The figure's message, and one legend for all panels under it."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper left", ncols=columns, fontsize=8, title=title, alignment="left",
        title_fontproperties={"size": 10.5, "weight": "bold"},
    )  # fmt: skip


def _length(value: float) -> str:
    return f"{1e3 * value:.2f} mm" if value >= 1e-4 else f"{1e6 * value:.1f} µm"
