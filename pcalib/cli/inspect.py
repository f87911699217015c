"""What is in a measurement file, and what is wrong with it.

    pcalib inspect data.csv
    pcalib inspect data.csv --robot models/delta.toml --json findings.json
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcalib.cli import frame
from pcalib.cli._next import say_next
from pcalib.cli.frame import JsonOption


def command(data: Path, /, *, robot: Path | None = None, json: JsonOption = None) -> int | None:
    """What is in a measurement file, and what is wrong with it.

    Says what is measured and under which conditions, how noisy replicates are, and what is lacking for later steps.
    With a robot file, values are also judged against its joint range, its workspace and its nominal geometry.

    Args:
        data: Measurement file, CSV or Parquet.
        robot: Robot file (TOML), or the name of a robot of models/: delta.
    """
    from pcalib import inspection
    from pcalib import robot as robots
    from pcalib.data import measurement

    described = robots.load(robot) if robot is not None else None
    result = inspection.inspect(measurement.load(data, described), described)
    frame.write_json(json, result.to_json())
    frame.show_table(("", ""), _facts(result.facts), title=str(data))
    frame.show_table(
        ("joint", "from", "to", "unit", "share of its range"),
        [
            (j["name"], f"{j['min']:.2f}", f"{j['max']:.2f}", j["unit"], _share(j["share_of_range"]))
            for j in result.facts["joints"]
        ],
    )
    for finding in result.findings:
        frame.say(f"- {finding.level}: {finding.message} {finding.remedy}".rstrip())
    if result.errors:
        first = result.errors[0]
        return frame.fail(f"{data}: {first.message}\n  {first.remedy}")
    if robot is None:
        say_next("inspect", data, "--robot", "robot.toml", why="to judge the values too")
    else:
        say_next("fit", data, "--robot", robot, "-o", "model.toml")
    return frame.OK


def _share(value: float) -> str:
    return f"{100 * value:.0f} %" if value == value else "–"


def _sensed(found: list[dict[str, Any]]) -> list[str]:
    """What sensors read, in words: '150 distances to stations (A × 50, B × 100)'."""
    out = []
    for title in dict.fromkeys(one["title"] for one in found):
        mine = [one for one in found if one["title"] == title]
        to = ", ".join(f"{one['to']} × {one['rows']}" for one in mine if one["to"])
        out.append(f"{sum(one['rows'] for one in mine)} {title}" + (f" ({to})" if to else ""))
    return out


def _facts(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The facts of a file in words."""
    from pcalib import wording

    measured, noise, sigma = facts["measured"], facts["replicates"], facts["sigma"]
    kinds = [f"{n} {kind.replace('_', ' ')}" for kind, n in measured.items() if n]
    kinds += _sensed(facts["sensors"])
    rows = [
        ("rows", f"{facts['rows']} ({facts['fit']} fit, {facts['check']} check)"),
        ("measured", f"{', '.join(kinds)}; {facts['readings']} readings"),
        ("frame", facts["frame"]),
        ("robot", facts["robot"] or "not named"),
        *(
            (f"{axis}", f"{span['min']:.1f} … {span['max']:.1f} mm")
            for axis, span in facts["position_mm"].items()
            if span
        ),
        ("tools", "; ".join("(" + ", ".join(f"{v:g}" for v in tool) + ") mm" for tool in facts["tools_mm"][:4])),
        ("payloads", ", ".join(f"{p['payload_kg']:g} kg × {p['rows']}" for p in facts["payloads"][:8])),
    ]
    for name, span in facts["temperatures_degC"].items():
        if name == "temp" or "temp" not in facts["temperatures_degC"]:
            rows.append((name, f"{span['min']:.1f} … {span['max']:.1f} °C"))
    if facts["time_s"]:
        rows.append(("time", f"{facts['time_s']['min']:.0f} … {facts['time_s']['max']:.0f} s"))
    for name, sides in facts["directions"].items():
        rows.append((name, ", ".join(f"{'+' if side == '1' else ''}{side} × {n}" for side, n in sides.items() if n)))
    each = [
        f"{text} ({'stated' if stated else 'not stated, assumed'})"
        for text, stated in (
            (wording.size(1e-6 * sigma["pos_um"]), sigma["pos_stated"]),
            (wording.angle(1e-6 * sigma["rot_urad"]), sigma["rot_stated"]),
        )
        if stated is not None
    ]  # fmt: skip
    rows.append(("σ of the instrument", ", ".join(each) or "–"))
    if noise["groups"]:
        parts = [f"{noise['rows']} rows in {noise['groups']} groups"]
        if noise["dof_pos"]:
            parts.append(f"scatter {wording.size(1e-6 * noise['sigma_pos_um'])} ({noise['ratio_pos']:.2f} σ)")
        if noise["dof_rot"]:
            parts.append(f"{wording.angle(1e-6 * noise['sigma_rot_urad'])} ({noise['ratio_rot']:.2f} σ)")
        rows.append(("replicates", ", ".join(parts)))
    if facts["own_columns"]:
        rows.append(("own columns", ", ".join(facts["own_columns"])))
    nominal = facts["nominal"]
    if nominal is not None and nominal["rms_pos_um"] == nominal["rms_pos_um"]:
        rows.append(("from the nominal robot", f"{nominal['rms_pos_um'] / 1e3:.3g} mm rms"))
    told = facts.get("forecast")
    if told is not None:
        first, *_, last = told["landings"]
        longer = ""
        if last != first:
            longer = f", {wording.size(1e-6 * last['u95_um'])} with a {last['tool_mm']:.0f} mm tool"
        rows.append(("a fit lets land within", f"{wording.size(1e-6 * first['u95_um'])} at the plate{longer} (95 %)"))
    return rows
