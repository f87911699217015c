"""Figures of a fit: residuals row by row and over the workspace, and the robot with the names of its parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from pcalib.model import Model
from pcalib.palette import ANCHORS, SERIES, LogScale
from pcalib.report.figures import INK, QUIET, RULE, drawing
from pcalib.view import skeleton as skeletons
from pcalib.wording import round_size


def by_row(before: np.ndarray, after: np.ndarray, sigma: np.ndarray, held: np.ndarray) -> str:
    """Size of each row's residual, as drawn and as fitted, logarithmic; positions, and rotations where there are some.

    Args:
        before, after: (N, 6) [m, rad] residuals, NaN where not measured; sigma: (N, 6) of the readings.
        held: (N,) bool, rows held out.
    """
    kinds = [(slice(0, 3), 1e6, "position, µm"), (slice(3, 6), 1e6, "rotation, µrad")]
    kinds = [kind for kind in kinds if np.isfinite(after[:, kind[0]]).any()]
    with drawing(8.6, 2.5 * len(kinds)) as (figure, out):
        panels = np.atleast_1d(figure.subplots(len(kinds), 1, sharex=True))
        rows = np.arange(len(after)) + 1
        for axes, (columns, factor, name) in zip(panels, kinds, strict=True):
            for error, colour, label in ((before, SERIES[1], "as drawn"), (after, SERIES[0], "fitted")):
                length = _length(error[:, columns]) * factor
                low = np.full(len(rows), np.nanmin(length) / 2)
                stems = np.stack([low, length, np.full(len(rows), np.nan)], axis=1)
                axes.plot(np.repeat(rows, 3), stems.ravel(), color=colour, lw=0.8, alpha=0.3)  # one path, not hundreds
                axes.plot(rows[~held], length[~held], ls="", marker="o", ms=4, color=colour, label=label)
                if held.any():
                    axes.plot(rows[held], length[held], ls="", marker="o", ms=4, mfc="none", color=colour)
            noise = float(np.nanmedian(np.where(np.isfinite(after[:, columns]), sigma[:, columns], np.nan))) * factor
            axes.axhline(np.sqrt(3) * noise, color=QUIET, lw=1, ls=(0, (4, 3)))
            axes.set(yscale="log", ylabel=name)
            axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axes.yaxis.set_minor_formatter(lambda value, _: "")
            axes.grid(axis="y")
        panels[0].legend(loc="upper right", ncols=2, bbox_to_anchor=(1.0, 1.16), borderaxespad=0)
        panels[0].set_title("Residual of each row; hollow: held out; dashed: the noise", loc="left")
        panels[-1].set_xlabel("row")
    return out[0]


def over_workspace(position: np.ndarray, before: np.ndarray, after: np.ndarray) -> str:
    """Size of the position residuals where they were measured, seen from above: as drawn and as fitted, one scale.

    Args:
        position: (N, 3) [m] of the plate in the base frame.
        before, after: (N, 6) [m, rad] residuals.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    lengths = [_length(error[:, :3]) for error in (before, after)]
    seen = np.concatenate(lengths)
    scale = LogScale.of(seen[np.isfinite(seen) & (seen > 0)])
    norm, colours = LogNorm(scale.low * 1e6, scale.high * 1e6), LinearSegmentedColormap.from_list("error", ANCHORS)
    with drawing(8.6, 3.7) as (figure, out):
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, length, name in zip(panels, lengths, ("as drawn", "fitted"), strict=True):
            order = np.argsort(np.nan_to_num(length))  # the largest on top
            axes.scatter(
                position[order, 0] * 1e3,
                position[order, 1] * 1e3,
                c=length[order] * 1e6,
                cmap=colours,
                norm=norm,
                s=34,
                lw=0.4,
                edgecolors=RULE,
            )
            axes.set(aspect="equal", xlabel="x, mm")
            axes.set_title(name, loc="left")
            axes.grid()
        panels[0].set_ylabel("y, mm")
        bar = figure.colorbar(ScalarMappable(norm, colours), ax=panels, shrink=0.8, aspect=18, pad=0.015)
        bar.set_ticks(list(scale.decades * 1e6), labels=[round_size(v) for v in scale.decades])
        bar.ax.minorticks_off()
        bar.outline.set_visible(False)
    return out[0]


def robot(model: Model) -> str:
    """The robot with the names of its parameters on it."""
    frame = skeletons.skeleton(model, skeletons.rest(model.robot))
    mechanism = model.robot.mechanism
    lengths = {mechanism.parameters[i].partition(".")[0] for i in mechanism.rod_lengths}
    stems = [name.partition(".")[0] for name in mechanism.parameters]

    def flat(points: np.ndarray) -> np.ndarray:
        """Seen from the front, the side and somewhat above."""
        if 2 not in mechanism.plate_dofs:
            return points[..., :2]
        turn, tip = np.radians(-25.0), np.radians(22.0)
        x = points[..., 0] * np.cos(turn) - points[..., 1] * np.sin(turn)
        y = points[..., 0] * np.sin(turn) + points[..., 1] * np.cos(turn)
        return np.stack([x, points[..., 2] * np.cos(tip) + y * np.sin(tip)], axis=-1) * 1e3

    with drawing(8.6, 6.4) as (figure, out):
        axes: Any = figure.subplots()
        for lines, width, colour in (
            (frame.rods, 1.4, SERIES[0]), (frame.legs, 2.2, SERIES[0]), (frame.arms, 3.2, INK),
            (frame.elbows, 2.0, INK), (frame.motors, 5.0, QUIET), (frame.rails, 1.6, QUIET),
        ):  # fmt: skip
            for line in lines:
                axes.plot(*flat(line).T, color=colour, lw=width, solid_capstyle="round")
        for body in (frame.base, *frame.plates):
            closed = flat(np.concatenate([body, body[:1]]))
            axes.plot(*closed.T, color=RULE, lw=1.2)
        ends = np.concatenate([frame.rods, frame.legs])
        for r, name in enumerate(mechanism.rods):
            if r >= len(ends):
                break
            base, plate = flat(ends[r])
            own = {stems[i] for i in np.atleast_1d(mechanism.actuation.columns[r]) if mechanism.units[i] != "1"}
            length = sorted(own & lengths)
            ball = sorted(s for s in own - set(length) if s.endswith(name))
            shared = sorted(own - set(length) - set(ball))
            _label(axes, plate, stems[int(mechanism.plate_columns[r, 0])], -6)
            _label(axes, 0.45 * base + 0.55 * plate, ", ".join(length), 0)
            _label(axes, base, ", ".join(ball or shared), 6)
            if (
                ball
                and shared
                and r < len(mechanism.rods)
                and mechanism.actuator[r] < len(frame.arms) + len(frame.rails)
            ):
                holder = np.concatenate([frame.arms[:, 0], frame.rails[:, 1]])[int(mechanism.actuator[r])]
                _label(axes, flat(holder), f"q{int(mechanism.actuator[r]) + 1}: {', '.join(shared)}", 14)
        axes.set_aspect("equal")
        axes.set_axis_off()
    return out[0]


def _label(axes: Any, at: np.ndarray, text: str, up: float) -> None:
    axes.annotate(text, at, (5, up), textcoords="offset points", fontsize=8, color=INK)


def _length(error: np.ndarray) -> np.ndarray:
    """(N,) |e| of what was measured; NaN where nothing was."""
    some = np.isfinite(error).any(axis=1)
    return np.where(some, np.sqrt(np.nansum(error**2, axis=1)), np.nan)
