"""A recording of a ladder: step through the models and watch the error fall."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcalib.ladder import ErrorMap, Ladder
from pcalib.model import Model
from pcalib.view import panels, scene
from pcalib.view.recording import TIMELINE, recording, sdk
from pcalib.view.skeleton import Skeleton, rest, skeleton, upwards

if TYPE_CHECKING:
    import rerun.blueprint as rrb

BACKGROUND = (14, 16, 20)


def write(
    path: str | Path,
    ladder: Ladder,
    *,
    model: Model | None = None,
    texts: Sequence[str] = (),
    identity: str | None = None,
    last: bool = False,
) -> None:
    """Write a .rrd of a ladder.

    Args:
        model: whose robot is drawn and whose parameters are listed in every step; each step's own when absent.
        texts: further markdown for each step's page.
        identity: name of the recording in the viewer; the file's name where absent.
        last: show the last step first instead of the first one.

    Raises:
        InputError: the file cannot be written, or rerun is not there.
    """
    sdk()
    body = skeleton(model or ladder.steps[0].model, rest(ladder.robot))
    style = scene.Style.of(ladder, body.size)
    with recording(path, _blueprint(ladder, body, style, last), identity or Path(path).stem) as rec:
        scene.draw_robot(rec, "scene/robot", body)
        up = upwards(ladder.robot.mechanism)
        title = body.base.mean(axis=0) * (1 - up) + up * ((body.points @ up).max() + 0.15 * body.size)
        w = ladder.robot.workspace
        for i, field in enumerate(ladder.maps):
            at = f"scene/{panels.tool_path(i, field)}"
            scene.draw_tool(rec, at, body, field.tool)
            scene.draw_workspace(rec, at, field.tool, w.radius, (w.z_min, w.z_max))
            scene.draw_field(rec, at, field, [s.label for s in ladder.steps], style, title)
            if field.expected is not None:
                scene.draw_expected(rec, at, field, [s.label for s in ladder.steps], style, title)
            panels.draw_landing(rec, f"landing/{panels.tool_path(i, field)}", field, style)
        panels.draw_colour_bar(rec, "colours", style)
        panels.draw_ladder(rec, "ladder", ladder)
        panels.draw_scatter(rec, "scatter", ladder.steps)
        panels.draw_candidates(rec, "candidates", ladder.steps)
        panels.log_step_texts(rec, ladder, texts)
        panels.log_parameters(rec, ladder.steps, model)
        panels.log_curves(rec, ladder)


def _blueprint(ladder: Ladder, body: Skeleton, style: scene.Style, last: bool) -> rrb.Blueprint:
    import rerun.blueprint as rrb

    up = upwards(ladder.robot.mechanism)
    tools = [panels.tool_path(i, field) for i, field in enumerate(ladder.maps)]
    may = ("may_miss", "may_miss_title")
    drawn: dict[str, tuple[str, ...]] = {"misses": ("error", *may)}
    drawn[f"misses, all steps ×{style.gain:g}"] = ("error_of_step", *may)
    if any(field.expected is not None for field in ladder.maps):
        drawn["may miss (95 %)"] = ("error", "error_of_step", "target", "title")
    scenes = [
        rrb.Tabs(
            *(solid(_of(tool, *out), m.label, body, m, up) for tool, m in zip(tools, ladder.maps, strict=True)),
            name=name, active_tab=ladder.worst_tool,
        )
        for name, out in drawn.items()
    ]  # fmt: skip
    landings = [flat(f"landing/{panels.tool_path(i, m)}", m.label, _square(style)) for i, m in enumerate(ladder.maps)]
    details: list = [rrb.TextDocumentView(origin="text/parameters", name="parameters")]
    if len(ladder.steps) > 1:
        legend = rrb.PlotLegend(visible=True)
        details.append(rrb.TimeSeriesView(origin="curves", name="numbers [µm]", plot_legend=legend))
    if landings:
        details.insert(0, rrb.Tabs(*landings, name="which way it misses", active_tab=ladder.worst_tool))
    if any(s.scatter is not None for s in ladder.steps):
        details.insert(0, flat("scatter", "residual against the variable it depends on most", panels.SCATTER_BOUNDS))
    if any(s.candidates for s in ladder.steps):
        details.insert(0, flat("candidates", "what is missing", panels.CANDIDATE_BOUNDS))
    text = rrb.TextDocumentView(origin="text/step", name="step")
    tabs = rrb.Tabs(*details, active_tab=0)
    if len(ladder.steps) > 1:
        title = f"TCP error, {ladder.source}: RMS (line) and largest (dots)"
        right = rrb.Vertical(text, flat("ladder", title, panels.LADDER_BOUNDS), tabs, row_shares=[0.32, 0.33, 0.35])
    else:
        right = rrb.Vertical(text, tabs, row_shares=[0.3, 0.7])
    return page(scenes, 0, right, 0.62, last)


def page(
    scenes: Sequence[rrb.Spatial3DView | rrb.Tabs], active: int, right: rrb.Vertical, share: float, last: bool = False
) -> rrb.Blueprint:
    """A page that steps through a timeline: scenes above their colour bar, and other views on the right.

    Args:
        active: number of the scene that is shown first.
        share: share of the width that the scenes take.
        last: begin at the end of the timeline.
    """
    import rerun.blueprint as rrb

    left = rrb.Vertical(
        rrb.Tabs(*scenes, active_tab=active),
        flat("colours", "size of the error, the same scale in all steps", ((-14.0, 254.0), (-3.0, 30.0))),
        row_shares=[0.88, 0.12],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[share, 1 - share]),
        rrb.TopPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=0.7, play_state="following" if last else "paused"),
        auto_layout=False,
        auto_views=False,
    )


def _of(tool: str, *without: str) -> list[str]:
    """What a scene shows of a tool."""
    return [f"scene/{tool}/**", *(f"- scene/{tool}/{name}" for name in without)]


def _square(style: scene.Style) -> tuple[tuple[float, float], tuple[float, float]]:
    half = len(style.colours.decades) + 0.5
    return (-half, half), (-half, half)


def flat(origin: str, name: str, bounds: tuple[tuple[float, float], tuple[float, float]]) -> rrb.Spatial2DView:
    """A view of something drawn in a plane, `bounds` wide and high."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        origin=origin, name=name, background=rrb.Background(color=BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=bounds[0], y_range=bounds[1]),
    )  # fmt: skip


def solid(contents: list[str], name: str, body: Skeleton, field: ErrorMap, up: np.ndarray) -> rrb.Spatial3DView:
    """A view of the robot and what else `contents` names, from where all targets are seen."""
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin="scene", contents=["scene/robot/**", *contents], name=name,
        background=rrb.Background(color=BACKGROUND), line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=_eye(body, field, up),
    )  # fmt: skip


def _eye(body: Skeleton, field: ErrorMap, up: np.ndarray) -> rrb.EyeControls3D:
    """A pinned eye that has robot, tool and targets in view."""
    import rerun.blueprint as rrb

    points = np.concatenate([body.points, body.pose.tcp(field.tool), field.targets])
    middle = 0.5 * (points.max(axis=0) + points.min(axis=0))
    reach = float(np.linalg.norm(points - middle, axis=1).max())
    towards = np.array([0.90, -0.42, 0.28]) if up[2] else np.array([0.0, 0.0, 1.0])
    return rrb.EyeControls3D(
        position=middle + 2.2 * reach * towards / np.linalg.norm(towards), look_target=middle, eye_up=up
    )
