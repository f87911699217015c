"""The panels beside the scene: what a step is, how far off it was, which way, and what it says of the parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pcalib import wording
from pcalib.ladder import ErrorMap, Ladder, Step
from pcalib.model import Model
from pcalib.palette import SERIES, LogScale, rgb
from pcalib.view import chart
from pcalib.view.recording import TIMELINE, sdk
from pcalib.view.scene import Style
from pcalib.wording import round_size, size

if TYPE_CHECKING:
    import rerun as rr

LEAST = 5.0
"""[σ] The axis of the candidates' bars reaches at least this far, so that bars as long as noise look short."""
DIM, NOW = (120, 128, 140), (150, 158, 172)
CANDIDATE_MARGIN = (60.0, 8.0, 11.0, 3.0)
LADDER_BOUNDS = SCATTER_BOUNDS = chart.Axes((0, 1), (0, 1)).bounds
CANDIDATE_BOUNDS = chart.Axes((0, 1), (0, 1), margin=CANDIDATE_MARGIN).bounds
"""Bounds that the views of these plots have to show."""


def tool_path(index: int, field: ErrorMap) -> str:
    """Entity path under which a tool's data stand in a recording, such as 'tool_300_mm'."""
    return re.sub(r"[^A-Za-z0-9.]+", "_", field.label).strip("_") + (f"_{index}" if "(" in field.label else "")


def log_step_texts(rec: rr.RecordingStream, ladder: Ladder, texts: Sequence[str]) -> None:
    """Log one page of markdown per step: its name, its figures, its assumptions, and the caller's `texts`."""
    rr = sdk()
    for s, step in enumerate(ladder.steps):
        lines = [f"### {s} · {_plain(step.label)}", "", _plain(step.text), ""]
        if ladder.maps:
            lines += [
                "| " + " | ".join(["TCP error", *(_plain(m.label) for m in ladder.maps)]) + " |",
                "|---" * (1 + len(ladder.maps)) + "|",
                "| " + " | ".join(["**RMS**", *(f"**{_missed(m.rms[s])}**" for m in ladder.maps)]) + " |",
                "| " + " | ".join(["max", *(_missed(m.max[s]) for m in ladder.maps)]) + " |",
            ]
            stated = [np.nan if m.expected is None else float(m.expected.pooled[s]) for m in ladder.maps]
            if np.isfinite(stated).any():
                lines.append("| " + " | ".join(["expected, 95 % within", *(size(v) for v in stated)]) + " |")
            lines.append("")
        if step.fit is not None:
            lines += [_fit_line(step), ""]
        lines += texts[s : s + 1]
        rec.set_time(TIMELINE, sequence=s)
        rec.log("text/step", rr.TextDocument("\n".join(lines), media_type=rr.MediaType.MARKDOWN))
    rec.reset_time()


def _missed(error: float) -> str:
    """An error; none where a model is asked about its own commands."""
    return size(error) if error != 0 else "none"


def _fit_line(step: Step) -> str:
    assert step.fit is not None
    text = f"Residual {size(step.fit.accuracy.rms_pos)} RMS on {step.fit.accuracy.n_rows} fitted poses"
    if step.fit.check is not None:
        text += f", {size(step.fit.check.rms_pos)} on {step.fit.check.n_rows} held out"
    return text + f"; {step.fit.n_identified} combinations of parameters are identified."


def log_curves(rec: rr.RecordingStream, ladder: Ladder) -> None:
    """RMS and maximum per tool, and of the fit, as scalars in µm."""
    rr = sdk()
    series: dict[str, np.ndarray] = {}
    for i, m in enumerate(ladder.maps):
        series[f"curves/{tool_path(i, m)}/rms_um"] = m.rms * 1e6
        series[f"curves/{tool_path(i, m)}/max_um"] = m.max * 1e6
    fitted = [np.nan if s.fit is None else s.fit.accuracy.rms_pos * 1e6 for s in ladder.steps]
    held_out = [np.nan if s.fit is None or s.fit.check is None else s.fit.check.rms_pos * 1e6 for s in ladder.steps]
    series |= {"curves/fit/rms_um": np.array(fitted), "curves/held_out/rms_um": np.array(held_out)}
    for path, values in series.items():
        seen = np.flatnonzero(np.isfinite(values))
        if len(seen):
            rec.send_columns(path, [rr.TimeColumn(TIMELINE, sequence=seen)], rr.Scalars.columns(scalars=values[seen]))


def draw_ladder(rec: rr.RecordingStream, path: str, ladder: Ladder) -> None:
    """RMS (line) and maximum (ring) of every tool over the steps, logarithmic, with the present step marked."""
    rr = sdk()
    n = len(ladder.steps)
    values = np.concatenate([ladder.rms.ravel(), ladder.max.ravel(), [ladder.floor] if ladder.floor else []])
    scale = LogScale.of(values)
    low, high = np.log10(scale.low), np.log10(scale.high)
    axes = chart.Axes((-0.4, n - 0.6), (low, high))
    names = [(s, wording.short(step.label, 14)) for s, step in enumerate(ladder.steps)]
    axes.frame(rec, path, names, _decade_ticks(scale))
    if ladder.floor:
        y = np.log10(ladder.floor)
        chart.line(rec, f"{path}/noise", axes.place(np.array(axes.x), np.array([y, y])), DIM, 0.8)
        chart.text(rec, f"{path}/noise_label", axes.place([axes.x[0] + 0.36], [y]) + [0, -3.5], ["instrument 1σ"], DIM)
    for i, m in enumerate(ladder.maps):
        colour = rgb(SERIES[i % len(SERIES)])
        with np.errstate(divide="ignore"):
            rms, worst = (axes.place(np.arange(n), np.clip(np.log10(v), low, high)) for v in (m.rms, m.max))
        name = tool_path(i, m)
        chart.line(rec, f"{path}/{name}/line", rms[np.isfinite(rms[:, 1])], colour)
        rec.log(f"{path}/{name}/rms", rr.Points2D(rms, colors=colour, radii=rr.Radius.ui_points(4.0)), static=True)
        rec.log(f"{path}/{name}/max", rr.Points2D(worst, colors=colour, radii=rr.Radius.ui_points(2.2)), static=True)
        # Curves often meet at the end; names stand in a row above the plot instead.
        key = np.array([[10 + i * axes.width / max(len(ladder.maps), 3), -6.0]])
        rec.log(f"{path}/{name}/key", rr.Points2D(key, colors=colour, radii=rr.Radius.ui_points(4.0)), static=True)
        chart.text(rec, f"{path}/{name}/key_label", key + [[19.0, 0.0]], [m.label], colour)
    for s in range(n):
        rec.set_time(TIMELINE, sequence=s)
        here = [axes.place([s, s], [low, high])]
        rec.log(f"{path}/now", rr.LineStrips2D(here, colors=NOW, radii=rr.Radius.ui_points(1.0), draw_order=-1))
    rec.reset_time()


def draw_landing(rec: rr.RecordingStream, path: str, field: ErrorMap, style: Style) -> None:
    """Which way and how far the TCP missed in the plane, as on a target whose rings are decades."""
    rr = sdk()
    scale = style.colours
    rings = scale.decades
    radius = np.arange(1, len(rings) + 1, dtype=float)
    turn = np.linspace(0, 2 * np.pi, 121)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    rec.log(
        f"{path}/rings",
        rr.LineStrips2D([r * circle for r in radius], colors=chart.GRID, radii=rr.Radius.ui_points(0.7), draw_order=-2),
        static=True,
    )
    top = np.stack([0 * radius, -radius], axis=-1)
    chart.text(rec, f"{path}/sizes", top, [round_size(v) for v in rings], drop=0.5)
    for s in range(len(field.errors)):
        good = field.status[s] == "ok"
        e = field.errors[s, good]
        flat = np.linalg.norm(e[:, :2], axis=1)
        with np.errstate(divide="ignore"):
            r = np.maximum(1 + np.log10(np.maximum(flat, 1e-15) / scale.low), 0.0)
        direction = e[:, :2] / np.maximum(flat, 1e-15)[:, None]
        at = r[:, None] * direction * [1.0, -1.0]
        rec.set_time(TIMELINE, sequence=s)
        colours = scale.rgb(field.distance[s, good])
        rec.log(f"{path}/missed", rr.Points2D(at, colors=colours, radii=rr.Radius.ui_points(2.6)))
    rec.reset_time()


def draw_colour_bar(rec: rr.RecordingStream, path: str, style: Style) -> None:
    """The colour of each error size, and how long arrows are drawn."""
    rr = sdk()
    scale, n = style.colours, 240
    share = np.linspace(0, 1, n)
    values = scale.low * (scale.high / scale.low) ** share
    strip = np.repeat(scale.rgb(values)[None], 10, axis=0)
    rec.log(f"{path}/strip", rr.Image(strip), static=True)
    at = np.stack([n * scale.share(scale.decades), np.full(len(scale.decades), 14.0 + chart.LABEL_DROP)], axis=-1)
    chart.text(rec, f"{path}/sizes", at, [round_size(v) for v in scale.decades])


def log_parameters(rec: rr.RecordingStream, steps: Sequence[Step], model: Model | None) -> None:
    """Table of what each step's model (or the one given) has changed from nominal, on the timeline."""
    rr = sdk()
    for s, step in enumerate(steps):
        rec.set_time(TIMELINE, sequence=s)
        page = parameter_markdown(model or step.model)
        rec.log("text/parameters", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN))
    rec.reset_time()


def parameter_markdown(model: Model) -> str:
    """Nominal, value, change and σ of every parameter that the model moved from nominal."""
    mechanism = model.robot.mechanism
    moved = np.flatnonzero(np.abs(model.errors) > 0)
    rows = []
    if len(moved) == 0:
        rows.append("All parameters have their nominal values.")
    else:
        rows += ["| parameter | nominal | change | ± 1σ |", "|---|--:|--:|--:|"]
        for i in moved:
            unit, factor, digits = wording.PARAMETER[mechanism.units[i]]
            sigma = np.nan if model.sigma is None else model.sigma[i]
            cells = [
                _plain(mechanism.parameters[i]), f"{wording.number(mechanism.nominal[i] * factor, digits)} {unit}",
                wording.number(model.errors[i] * factor, digits, "+"), wording.number(sigma * factor, digits),
            ]  # fmt: skip
            rows.append(f"| {' | '.join(cells)} |")
    for fitted in model.effects:
        rows += ["", _plain(fitted.effect.describe(fitted.theta))]
    return "\n".join(rows)


def draw_scatter(rec: rr.RecordingStream, path: str, steps: Sequence[Step]) -> None:
    """Residuals of each step against the variable that they depend on most, on the same axes in every step."""
    rr = sdk()
    shown = [s for s in steps if s.scatter is not None]
    if not shown:
        return
    x = np.concatenate([s.scatter.x for s in shown if s.scatter is not None])
    y = np.concatenate([s.scatter.residual for s in shown if s.scatter is not None])
    top = max(3.0, float(np.ceil(np.nanmax(np.abs(y)))))
    span = (float(np.nanmin(x)), float(np.nanmax(x)))
    axes = chart.Axes(span if span[1] > span[0] else (span[0] - 1, span[0] + 1), (-top, top))
    axes.frame(
        rec, path, [(float(v), f"{v:.4g}") for v in np.linspace(*axes.x, 5)],
        [(v, f"{v:+.0f}σ" if v else "0") for v in (-top, 0.0, top)],
    )  # fmt: skip
    for s, step in enumerate(steps):
        rec.set_time(TIMELINE, sequence=s)
        points = np.zeros((0, 2)) if step.scatter is None else axes.place(step.scatter.x, step.scatter.residual)
        rec.log(f"{path}/residual", rr.Points2D(points, colors=rgb(SERIES[0]), radii=rr.Radius.ui_points(2.4)))
        curve = None if step.scatter is None else step.scatter.curve
        lines = [] if curve is None else [axes.place(curve[:, 0], curve[:, 1])]
        rec.log(f"{path}/curve", rr.LineStrips2D(lines, colors=rgb(SERIES[1]), radii=rr.Radius.ui_points(1.5)))
        words = [] if step.scatter is None else [f"{step.scatter.label} against {step.scatter.variable}"]
        rec.log(f"{path}/label", chart.labels(np.array([[85.0, -10.0]] * len(words)).reshape(-1, 2), words))
    rec.reset_time()


def draw_candidates(rec: rr.RecordingStream, path: str, steps: Sequence[Step], most: int = 8) -> None:
    """Draw the candidates for what the step leaves unexplained as bars, the strongest on top."""
    rr = sdk()
    strengths = [c.strength for s in steps for c in s.candidates]
    if not strengths:
        return
    top = 3 * np.ceil(max(*strengths, LEAST) / 3)
    axes = chart.Axes((0.0, 1.05 * top), (0.0, float(most)), margin=CANDIDATE_MARGIN)
    ticks = [(float(v), f"{v:.0f}σ") for v in np.linspace(0, top, 4)]
    for s, step in enumerate(steps):
        ranked = sorted(step.candidates, key=lambda c: -c.strength)[:most]
        y = most - 0.5 - np.arange(len(ranked))
        length = np.array([c.strength for c in ranked])
        bars = np.stack([axes.place(0.0 * length, y), axes.place(length, y)], axis=1)
        colours = [rgb(SERIES[1]) if c.favoured else (104, 116, 134) for c in ranked]
        rec.set_time(TIMELINE, sequence=s)
        axes.frame(rec, path, ticks if ranked else [], [], x_lines=True, static=False)
        rec.log(f"{path}/bars", rr.LineStrips2D(bars, colors=colours, radii=0.32 * axes.height / most))
        at = axes.place(0.0 * length, y) - [30.0, chart.LABEL_DROP]
        rec.log(f"{path}/names", chart.labels(at, [c.name for c in ranked]))
    rec.reset_time()


def _decade_ticks(scale: LogScale) -> list[tuple[float, str]]:
    return [(float(np.log10(v)), round_size(v)) for v in scale.decades]


_SPECIAL: Mapping[int, str] = {ord(c): f"\\{c}" for c in "\\`*_{}[]<>#|!$~"}


def _plain(text: str) -> str:
    """The text with markdown's special characters escaped."""
    return " ".join(text.split()).translate(_SPECIAL)
