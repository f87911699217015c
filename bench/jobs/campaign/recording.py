"""Recordings of a campaign for the Rerun viewer: where in the workspace robots miss, and the worst of them.

One file per cell. Its timeline steps through the methods; colours have one scale for all of them. A percentile map
shows at each target the error that this share of the robots stays below there.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq

from bench.jobs.campaign import trial
from bench.jobs.campaign.spec import Spec
from bench.jobs.campaign.summary import RobotGroup, Summary, select, tool_text
from bench.jobs.campaign.sweep import short
from pcalib.errors import PcalibError
from pcalib.ladder import ErrorMap
from pcalib.model import Model
from pcalib.palette import NO_VALUE, SERIES, LogScale, rgb
from pcalib.robot import Robot
from pcalib.view import chart, panels, scene
from pcalib.view.recording import TIMELINE, recording, sdk
from pcalib.view.skeleton import Skeleton, rest, skeleton, upwards
from pcalib.wording import round_size, size

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

PERCENTILES = (50, 95)
WORST = 3
"""Robots shown by themselves: those that the last method leaves worst off with the longest tool."""
MOST_CELLS = 4
MARGIN = (20.0, 14.0, 11.0, 11.0)
DISTRIBUTION = chart.Axes((0, 1), (0, 100), margin=MARGIN)


@dataclass(frozen=True, eq=False)
class Maps:
    """The errors of one cell's robots at its targets."""

    cell: int
    robot: Robot
    methods: list[str]
    tools: np.ndarray
    """(T, 3) [m]"""
    goals: np.ndarray
    """(T, P, 3) [m] TCP targets."""
    percentile: np.ndarray
    """(len(PERCENTILES), M, T, P) [m]; NaN where no robot got there."""
    groups: list[list[RobotGroup]]
    """[method][tool]."""
    worst: list[tuple[int, ErrorMap]]
    """Number of each of the worst robots and its error field with the longest tool, a step per method."""
    n: int
    """Robots that the percentiles are of."""


def write(summary: Summary, results: Path, folder: Path) -> list[Path]:
    """Write one recording per cell into a folder, of the first MOST_CELLS; cells without errors kept are left out.

    Raises:
        InputError: rerun is not installed, or a file cannot be written.
    """
    campaign = summary.spec
    out = []
    for cell in range(min(campaign.n_cells, MOST_CELLS)):
        maps = gather(summary, results, cell)
        if maps is not None:
            path = folder / (f"errors-cell{cell}.rrd" if campaign.n_cells > 1 else "errors.rrd")
            _write(path, maps, summary)
            out.append(path)
    return out


def gather(summary: Summary, results: Path, cell: int) -> Maps | None:
    """Gather what the recording of a cell shows; None where the results keep no errors of its robots."""
    campaign = summary.spec
    stand = trial.stand(campaign, cell)
    methods = [m.name for m in stand.cell.methods]
    tools = stand.cell.verify.tools
    labels = [trial.tool_label(tool) for tool in tools]
    P = len(stand.targets)
    keep = (pc.field("cell") == cell) & (pc.field("robot") < campaign.output.map_robots) & (pc.field("status") == "ok")
    table = pq.read_table(results, columns=["method", "tool", "robot", "error_um"], filters=keep)
    if not len(table):
        return None
    percentile = np.full((len(PERCENTILES), len(methods), len(tools), P), np.nan)
    for m, method in enumerate(methods):
        for t, tool in enumerate(labels):
            here = table.filter((pc.field("method") == method) & (pc.field("tool") == tool))
            if len(here):
                errors = np.array(here["error_um"].to_pylist(), float) * 1e-6
                seen = np.isfinite(errors).any(axis=0)
                percentile[:, m, t, seen] = np.nanpercentile(errors[:, seen], PERCENTILES, axis=0)
    goals = stand.goals.tcp(stand.tools).reshape(len(tools), P, 3)
    groups = [[g for tool in labels for g in select(summary.groups, cell=cell, method=m, tool=tool)] for m in methods]
    longest = int(np.argmax(np.linalg.norm(tools, axis=1)))
    last = groups[-1][longest]
    ranked = last.robot[np.argsort(-last.rms, kind="stable")][:WORST]
    fields = [(int(robot), _field(campaign, cell, int(robot), longest)) for robot in ranked]
    worst = [(robot, field) for robot, field in fields if field is not None]
    n = len(set(table["robot"].to_pylist()))
    return Maps(cell, stand.cell.robot, methods, tools, goals, percentile, groups, worst, n)


def _field(campaign: Spec, cell: int, robot: int, tool: int) -> ErrorMap | None:
    """The error field of one robot, measured and calibrated once more: a trial gives the same every time."""
    stand = trial.stand(campaign, cell)
    P = len(stand.targets)
    here = slice(tool * P, (tool + 1) * P)
    try:
        landed = trial.landings(campaign, cell * campaign.robots + robot)
    except PcalibError:  # some other method of this robot failed
        return None
    goals = stand.goals.tcp(stand.tools)[here]
    errors = np.stack([landing.tcp[here] - goals for landing in landed.values()])
    return ErrorMap(stand.cell.verify.tools[tool], goals, errors, np.stack([l.status[here] for l in landed.values()]))


# -- drawing -----------------------------------------------------------------------------------------------------------


def _write(path: Path, maps: Maps, summary: Summary) -> None:
    rr = sdk()
    body = skeleton(Model.nominal(maps.robot), rest(maps.robot))
    style = _style(maps, body)
    w = maps.robot.workspace
    up = upwards(maps.robot.mechanism)
    title = body.base.mean(axis=0) * (1 - up) + up * ((body.points @ up).max() + 0.15 * body.size)
    with recording(path, _blueprint(maps, body, style), f"{summary.spec.name}-{maps.cell}") as rec:
        scene.draw_robot(rec, "scene/robot", body)
        for t, tool in enumerate(maps.tools):
            for s, share in enumerate(PERCENTILES):
                at = f"scene/{_map_path(share, t)}"
                scene.draw_tool(rec, at, body, tool)
                scene.draw_workspace(rec, at, tool, w.radius, (w.z_min, w.z_max))
                _draw_map(rec, at, maps, s, t, style, title)
        for robot, field in maps.worst:
            at = f"scene/robot{robot}"
            scene.draw_tool(rec, at, body, field.tool)
            scene.draw_workspace(rec, at, field.tool, w.radius, (w.z_min, w.z_max))
            scene.draw_field(rec, at, field, [f"robot {robot}, {m}" for m in maps.methods], style, title)
        panels.draw_colour_bar(rec, "colours", style)
        _draw_distribution(rec, "distribution", maps)
        for m, method in enumerate(maps.methods):
            rec.set_time(TIMELINE, sequence=m)
            rec.log("text", rr.TextDocument(_page(maps, summary, m, method), media_type=rr.MediaType.MARKDOWN))
        rec.reset_time()


def _style(maps: Maps, body: Skeleton) -> scene.Style:
    sizes = maps.percentile[np.isfinite(maps.percentile)]
    pooled = np.array([g.pooled for row in maps.groups for g in row])
    large = np.concatenate([field.distance.ravel() for _, field in maps.worst] or [sizes])
    large = float(np.nanquantile(large, 0.995))
    gain = 0.3 * maps.robot.workspace.radius / max(large, 1e-9)
    decade = 10.0 ** np.floor(np.log10(gain))
    scale = LogScale.of(np.concatenate([pooled, [sizes.max(initial=1e-6), large]]))
    return scene.Style(scale, float(decade * max(s for s in (1, 2, 5) if s * decade <= gain)), body.size)


def _draw_map(
    rec: rr.RecordingStream, path: str, maps: Maps, s: int, t: int, style: scene.Style, title: np.ndarray
) -> None:
    """A percentile at every target: colour and size of a ball say how large it is."""
    rr = sdk()
    for m, method in enumerate(maps.methods):
        values = maps.percentile[s, m, t]
        seen = np.isfinite(values)
        rec.set_time(TIMELINE, sequence=m)
        radius = (0.006 + 0.020 * style.colours.share(values[seen])) * style.size
        balls = rr.Points3D(maps.goals[t, seen], radii=radius, colors=style.colours.rgb(values[seen]))
        rec.log(f"{path}/error", balls)
        rec.log(f"{path}/missed", rr.Points3D(maps.goals[t, ~seen], radii=0.004 * style.size, colors=NO_VALUE))
        rms = np.sqrt(np.mean(values[seen] ** 2)) if seen.any() else np.nan
        text = f"{method} · {PERCENTILES[s]} % of the robots below · RMS over the workspace {size(rms)}"
        rec.log(f"{path}/title", rr.Points3D([title], labels=[text], show_labels=True, radii=1e-4, colors=scene.TEXT))
    rec.reset_time()


def _draw_distribution(rec: rr.RecordingStream, path: str, maps: Maps) -> None:
    """Share of the robots whose RMS error is below a value, a line per tool, the present method bright."""
    rr = sdk()
    values = np.concatenate([g.rms for row in maps.groups for g in row])
    scale = LogScale.of(values)
    axes = chart.Axes((np.log10(scale.low), np.log10(scale.high)), (0.0, 100.0), margin=MARGIN)
    ticks = [(float(np.log10(v)), round_size(v)) for v in scale.decades]
    axes.frame(rec, path, ticks, [(v, f"{v:.0f} %") for v in (0.0, 50.0, 100.0)], x_lines=True)
    for t, group in enumerate(maps.groups[0]):
        colour = rgb(SERIES[t % len(SERIES)])
        key = np.array([[10 + t * axes.width / max(len(maps.tools), 3), -6.0]])
        rec.log(f"{path}/key{t}", rr.Points2D(key, colors=colour, radii=rr.Radius.ui_points(4.0)), static=True)
        chart.text(rec, f"{path}/key_label{t}", key + [[19.0, 0.0]], [f"tool {tool_text(group)} mm"], colour)
    for m in range(len(maps.methods)):
        rec.set_time(TIMELINE, sequence=m)
        lines, colours = [], []
        for t, group in enumerate(maps.groups[m]):
            if len(group.rms):
                x = np.log10(np.sort(group.rms))
                y = 100 * (np.arange(len(x)) + 0.5) / len(x)
                lines.append(axes.place(np.r_[x[0], x, x[-1]], np.r_[0, y, 100]))
                colours.append(rgb(SERIES[t % len(SERIES)]))
        rec.log(f"{path}/lines", rr.LineStrips2D(lines, colors=colours, radii=rr.Radius.ui_points(1.6)))
    rec.reset_time()


def _page(maps: Maps, summary: Summary, m: int, method: str) -> str:
    """Figures of one method, as markdown."""
    swept = ", ".join(f"{path} = {short(v)}" for path, v in maps.groups[m][0].point.items())
    lines = [f"### {m} · {method}", "", f"{summary.spec.name}{': ' + swept if swept else ''}. "
             f"Maps show the errors of {maps.n} robots.", ""]  # fmt: skip
    header = ["RMS error of a robot", *(f"tool {tool_text(g)} mm" for g in maps.groups[m])]
    lines += [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
    for name, value in (("all, pooled", lambda g: g.pooled), ("median", lambda g: g.percentile(50)),
                        ("95 % below", lambda g: g.percentile(95)), ("largest error", lambda g: g.worst)):  # fmt: skip
        lines.append(f"| {name} | " + " | ".join(size(value(g)) for g in maps.groups[m]) + " |")
    lines.append("| failed | " + " | ".join(str(g.failed) for g in maps.groups[m]) + " |")
    return "\n".join(lines)


def _map_path(share: int, t: int) -> str:
    return f"percentile{share}/tool{t}"


def _blueprint(maps: Maps, body: Skeleton, style: scene.Style) -> rrb.Blueprint:
    import rerun.blueprint as rrb

    from pcalib.view.story import flat, page, solid

    up = upwards(maps.robot.mechanism)
    shown = [
        (_map_path(share, t), f"{share} %, tool {tool_text(maps.groups[0][t])} mm", maps.goals[t], tool)
        for t, tool in enumerate(maps.tools)
        for share in PERCENTILES
    ]
    for robot, field in maps.worst:
        shown.append((f"robot{robot}", f"robot {robot} · arrows ×{style.gain:g}", field.targets, field.tool))
    scenes = []
    for path, name, targets, tool in shown:
        field = ErrorMap(tool, targets, np.zeros((1, *targets.shape)), np.full((1, len(targets)), "ok"))
        scenes.append(solid([f"scene/{path}/**"], name, body, field, up))
    longest = int(np.argmax(np.linalg.norm(maps.tools, axis=1)))
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="text", name="method"),
        flat("distribution", "share of the robots with an RMS error below", DISTRIBUTION.bounds),
        row_shares=[0.55, 0.45],
    )
    return page(scenes, len(PERCENTILES) * longest + len(PERCENTILES) - 1, right, 0.64)
