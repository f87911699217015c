"""Plots drawn as points and lines in a 2D view: logarithmic axes and labelled ticks, which plot views do not have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pcalib.view.recording import sdk

if TYPE_CHECKING:
    import rerun as rr

GRID, TEXT = (52, 58, 68), (160, 168, 180)
LABEL_DROP = 4.0
"""Distance [scene units] at which the viewer draws a label below its point."""


@dataclass(frozen=True)
class Axes:
    """A plot area of width × height scene units, y up, data limits in `x` and `y`."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: float = 170.0
    height: float = 58.0
    margin: tuple[float, float, float, float] = (20.0, 6.0, 11.0, 11.0)
    """Left, right, bottom, top."""

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """What a view has to show, x and y."""
        left, right, bottom, top = self.margin
        return (-left, self.width + right), (-top, self.height + bottom)

    def place(self, x: Any, y: Any) -> np.ndarray:
        """Data → scene, (..., 2)."""
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        right = (x - self.x[0]) / (self.x[1] - self.x[0]) * self.width
        down = (self.y[1] - y) / (self.y[1] - self.y[0]) * self.height
        return np.stack([right, down], axis=-1)

    def frame(
        self,
        rec: rr.RecordingStream,
        path: str,
        x_ticks: Sequence[tuple[float, str]],
        y_ticks: Sequence[tuple[float, str]],
        x_lines: bool = False,
        static: bool = True,
    ) -> None:
        """Grid lines and tick labels, for all steps where `static`, else for the present one."""
        rr = sdk()
        lines = [self.place(np.array(self.x), np.array([v, v])) for v, _ in y_ticks]
        if x_lines:
            lines += [self.place(np.array([v, v]), np.array(self.y)) for v, _ in x_ticks]
        grid = rr.LineStrips2D(lines, colors=GRID, radii=rr.Radius.ui_points(0.6), draw_order=-2)
        rec.log(f"{path}/grid", grid, static=static)
        beside = self.place(self.x[0], [v for v, _ in y_ticks]) - [10.0, 0.0]
        text(rec, f"{path}/y_ticks", beside, [t for _, t in y_ticks], static=static)
        below = self.place([v for v, _ in x_ticks], self.y[0]) + [0.0, 6.0]
        text(rec, f"{path}/x_ticks", below, [t for _, t in x_ticks], static=static)


def text(
    rec: rr.RecordingStream,
    path: str,
    at: np.ndarray,
    words: Sequence[str],
    colour: Any = TEXT,
    drop: float = LABEL_DROP,
    static: bool = True,
) -> None:
    """Draw labels centred at points (n, 2); `drop` [scene units] is how far the viewer draws them below."""
    rec.log(path, labels(np.asarray(at, float) - [0.0, drop], words, colour), static=static)


def labels(at: np.ndarray, words: Sequence[str], colour: Any = TEXT) -> Any:
    """Draw labels below points (n, 2), without drawing the points."""
    rr = sdk()
    words = list(words)
    return rr.Points2D(at, labels=words, show_labels=bool(words), colors=colour, radii=rr.Radius.ui_points(0.01))


def line(rec: rr.RecordingStream, path: str, at: np.ndarray, colour: Any, width: float = 1.5) -> None:
    """A line through places (n, 2), for all steps."""
    rr = sdk()
    rec.log(path, rr.LineStrips2D([at], colors=colour, radii=rr.Radius.ui_points(width)), static=True)
