"""The figures of the reproduction; the title of each states its message."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.jobs import charts
from bench.jobs.savoure2006 import study, trial
from bench.jobs.savoure2006.study import Found, Scores

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHORT = {
    "none": "no calibration",
    "classical": "classical (q0, l)",
    "paper_linear_first_order": "improved: the paper's linear fit, first order",
    "gauss_newton_exact": "Gauss–Newton on the base of 6, exact inverse",
    "map_exact": "all 9 with priors (MAP), exact inverse",
}
STYLE = charts.STYLE | {"axes.titlesize": 10.5, "axes.titleweight": "bold"}


def save(found: Found, folder: Path) -> list[Path]:
    """Draw everything into a folder as PNG and SVG; returns the PNG files."""
    draw: dict[str, Callable[[Figure], None]] = {
        "fig5_h0": lambda figure: curves(figure, found.ladder[0.0], 0.0, found.seeds),
        "fig6_h200": lambda figure: curves(figure, found.ladder[0.2], 0.2, found.seeds),
        "fig7_noise_and_poses": lambda figure: noise_and_poses(figure, found),
        "scaling": lambda figure: scaling(figure, found),
        "other_tools": lambda figure: other_tools(figure, found),
        "delta": lambda figure: delta(figure, found),
    }
    return charts.save(draw.items(), folder, (".png", ".svg"), STYLE)


def look(method: str) -> dict[str, Any]:
    """How a method is drawn."""
    return dict(charts.looks([method]))[method]


def curves(figure: Figure, scores: Scores, h: float, seeds: int) -> None:
    """Figures 5 and 6: x-error over the stroke, above as the paper draws it, below what it cannot show."""
    figure.set_size_inches(6.4, 6.0)
    above, below = figure.subplots(2, 1, sharex=True)
    q = trial.Q_CHECKED / trial.DEGREE

    def plot(ax: Axes, keys: Sequence[str], factor: float) -> None:
        for key in keys:
            style: Any = look(key) | {"marker": None}
            s = scores[key, h]
            ax.plot(q, factor * s.curve, label=f"{SHORT[key]}: RMS {_length(s.rms)}, max {_length(s.max)}", **style)
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


def noise_and_poses(figure: Figure, found: Found) -> None:
    """Figure 7: the error against the measuring noise and against the number of poses."""
    figure.set_size_inches(9.0, 4.3)
    left, right = figure.subplots(1, 2, sharey=True)
    _axis(left, found.noise, factor=1e6 * trial.SIGMA_POS)
    _axis(right, found.poses)
    left.set_xlabel("measuring noise, 1σ [µm]  (and as many 0.001°)")
    right.set_xlabel("measured poses")
    left.set_ylabel("RMS x-error of the TCP [µm], h = 200 mm")
    left.set_title("19 poses")
    right.set_title("noise 3 µm, 0.003°")
    charts.logarithmic(left.xaxis, [1e6 * trial.SIGMA_POS * f for f in found.noise])
    charts.logarithmic(right.xaxis, list(found.poses))
    charts.legend_above(figure, left, "Better data help the fit that has no bias, and hardly any other")


def scaling(figure: Figure, found: Found) -> None:
    """The bias of the linear method: it grows as the square of the errors, whatever the number of poses."""
    figure.set_size_inches(6.8, 5.0)
    ax = figure.subplots()
    _axis(ax, found.scaling, keys=["paper_linear_first_order", "gauss_newton_exact", "map_exact"])
    _axis(ax, found.scaling_poses, keys=["paper_linear_first_order", "gauss_newton_exact", "map_exact"], faint=True)
    largest = max(found.scaling)
    level = 1.8e6 * found.scaling[largest]["paper_linear_first_order", study.LONG].rms
    at = largest * np.array([0.2, 1.0])
    ax.plot(at, level * (at / largest) ** 2, color="#666666", linewidth=1)
    ax.annotate("∝ error²", (0.45 * largest, 0.2 * level), xytext=(-8, 6), textcoords="offset points", ha="right")
    ax.set_xlabel("size of the geometric errors, Table 2 = 1")
    ax.set_ylabel("RMS x-error of the TCP [µm], h = 200 mm")
    charts.logarithmic(ax.xaxis, list(found.scaling))
    ax.plot([], [], color="#444444", label="19 poses (thick)", linewidth=1.6)
    ax.plot([], [], color="#444444", label="181 poses (thin, open markers)", linewidth=0.8)
    message = "The linear method's error is bias: ∝ error², whatever the number of poses"
    charts.legend_above(figure, ax, message, columns=1)


def other_tools(figure: Figure, found: Found) -> None:
    """Measured with one tool, used with others."""
    figure.set_size_inches(6.8, 5.2)
    ax = figure.subplots()
    lengths = 1e3 * np.array(study.USED_AT)
    for key in SHORT:
        rms = [1e6 * found.transfer[key, h].rms for h in study.USED_AT]
        ax.plot(lengths, rms, label=SHORT[key], **look(key))
    charts.logarithmic(ax.yaxis)
    ax.axvline(1e3 * study.MEASURED_AT, color="#666666", linewidth=0.8, zorder=0)
    ax.annotate("measured here", (1e3 * study.MEASURED_AT, 1), xycoords=("data", "axes fraction"), xytext=(4, -10),
                textcoords="offset points", color="#444444", fontsize=8)  # fmt: skip
    ax.set_xlabel("tool length h in use [mm]")
    ax.set_ylabel("RMS x-error of the TCP [µm]")
    message = "Measured with h = 100 mm: only true geometry carries over to other tools"
    charts.legend_above(figure, ax, message, columns=1)


def delta(figure: Figure, found: Found) -> None:
    """The Delta ladder at three tools."""
    figure.set_size_inches(10.0, 4.9)
    axes = figure.subplots(1, len(found.delta), sharey=True)
    lengths = [1e3 * h for h in trial.DELTA_TOOLS]
    for ax, (name, scores) in zip(axes, found.delta.items(), strict=True):
        for key, label in ((m.name, m.label) for m in trial.DELTA_METHODS):
            rms = [1e6 * scores[key, h].rms for h in trial.DELTA_TOOLS]
            ax.plot(lengths, rms, label=label, **look(key))
        length, angle = trial.DELTA_ERRORS[name]
        charts.logarithmic(ax.yaxis)
        ax.set_title(f"errors {1e3 * length:g} mm, {angle / trial.DEGREE:g}° (1σ)")
        ax.set_xlabel("tool length in use [mm]")
        ax.set_xticks(lengths)
    axes[0].set_ylabel("RMS distance of TCP and target [µm]")
    charts.legend_above(figure, axes[0], "Delta, measured at the plate: a model that knows no tilt fails with a tool")


def _axis(
    ax: Axes,
    values: Mapping[float, Scores],
    keys: Sequence[str] | None = None,
    factor: float = 1.0,
    faint: bool = False,
) -> None:
    """RMS by the values of a study, both logarithmic."""
    for key in keys or [m.name for m in study.COMPARED]:
        rms = [1e6 * scores[key, study.LONG].rms for scores in values.values()]
        more = {"linewidth": 0.8, "markerfacecolor": "white"} if faint else {"label": SHORT[key]}
        style: Any = look(key) | more
        ax.plot(factor * np.array(list(values)), rms, **style)
    charts.logarithmic(ax.xaxis)
    charts.logarithmic(ax.yaxis)


def _length(value: float) -> str:
    return f"{1e3 * value:.2f} mm" if value >= 1e-4 else f"{1e6 * value:.1f} µm"
