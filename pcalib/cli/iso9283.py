"""A record of pose accuracy, repeatability and the rest of ISO 9283, from measured cycles.

    pcalib iso9283 --poses --robot models/delta.toml -o targets.csv
    pcalib iso9283 measured.csv --commands commands.csv --robot models/delta.toml --report record.html
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from pcalib.cli._next import say_next
from pcalib.cli.frame import BesideOption, JsonOption, OutputOption, quantity, say, show_table, write_json

if TYPE_CHECKING:
    from pcalib.data.measurement import Measurements
    from pcalib.iso9283 import Record


def command(
    measured: Path | None = None,
    /,
    *,
    robot: Path,
    commands: Path | None = None,
    other: tuple[Path, ...] = (),
    path: str = "path",
    poses: Annotated[bool, Parameter(negative=())] = False,
    cycles: Annotated[int, Parameter(name=["--cycles", "-n"])] = 1,
    tool: Annotated[np.ndarray | None, quantity("length", 3)] = None,
    output: OutputOption = None,
    report: BesideOption = None,
    json: JsonOption = None,
) -> int | None:
    """A record of pose accuracy, repeatability and the rest of ISO 9283, from measured cycles.

    Rows of the measurement file belong to the pose whose command they repeat; rows stand in the order of time, so that
    the k-th row of a pose is its k-th cycle. AP and RP need cycles of each pose, vAP a column that names the approach
    path, dAP and dRP two blocks of ten cycles, E the files of further robots. Positions must be in the base frame.

    Args:
        measured: Measurement file, CSV or Parquet.
        robot: Robot file (TOML), or the name of a robot of models/: delta.
        commands: Command file with the wanted positions, as 'pcalib compensate' writes it.
        other: Measured cycles of a further robot of the same make; may be given several times.
        path: Column that names the approach path.
        poses: Write the targets of the test instead: five poses in the largest cube of the workspace.
        cycles: With --poses: how often the five poses are listed.
        tool: With --poses: TCP in the plate frame, e.g. 0,0,-300mm.
        output: With --poses: target file to write, CSV.
        report: Also write the record, one self-contained HTML page.
    """
    from pcalib import iso9283
    from pcalib import robot as robots
    from pcalib.data import measurement
    from pcalib.data.targets import load_commands, load_targets
    from pcalib.errors import InputError
    from pcalib.report import performance
    from pcalib.report import write as write_page

    described = robots.load(robot)
    if poses:
        if output is None:
            raise InputError("--poses writes a target file", remedy="name it: -o targets.csv")
        _write_poses(described, max(cycles, 1), np.zeros(3) if tool is None else tool, output)
        return None
    if measured is None or commands is None:
        raise InputError(
            "a measurement file and --commands are needed",
            remedy="pcalib iso9283 measured.csv --commands commands.csv --robot R.toml, or --poses to plan the test",
        )
    data = measurement.load(measured, described)
    if data.frame != "base":
        raise InputError(
            f"frame '{data.frame}': accuracy needs positions in the base frame", file=measured,
            remedy="calibrate first; 'pcalib fit' finds where the tracker stands, or transform the positions",
        )
    q, status = load_commands(commands, described)
    wanted = load_targets(commands, described)
    ok = np.flatnonzero(status == "ok")
    q, first = np.unique(q[ok], axis=0, return_index=True)
    order = np.argsort(first)
    q, target = q[order], wanted.position[ok][first[order]]
    rows = data.position
    kept = np.asarray(np.isfinite(rows).all(axis=1))
    found = iso9283.record(
        _pose_of(data, q, str(measured))[kept],
        rows[kept],
        target,
        _labels(data, path, kept),
        [_other(file, described, q) for file in other],
        float(np.median(data.sigma[:, :3])) if data.stated[0] else 0.0,
    )
    if report is not None:
        page = performance.page(found, described.name, _conditions(data), [measured, commands, *other])
        write_page(report, page)
    write_json(json, as_json(found))
    say(performance.sentence(found))
    print()
    show_table(*performance.shown(performance.POSES, performance.pose_rows(found)))
    show_table(*performance.shown(performance.DISTANCES, performance.distance_rows(found)), title="Distances")
    for remark in found.remarks:
        say(f"- {remark}")
    if report is not None:
        say(f"Record written to {report}.")
    return None


def as_json(found: Record) -> dict[str, Any]:
    """`pcalib.iso9283/1`, lengths in µm."""

    def um(values: Any) -> Any:
        return None if values is None else np.asarray(values) * 1e6

    return {
        "schema": "pcalib.iso9283/1",
        "wanted_mm": found.wanted * 1e3,
        "cycles": found.poses.cycles,
        "ap_um": um(found.poses.ap),
        "ap_axes_um": um(found.poses.axes),
        "rp_um": um(found.poses.rp),
        "rms_um": um(found.poses.rms),
        "max_um": um(found.poses.max),
        "distances": [
            {
                "poses": [i + 1, j + 1],
                "ad_um": um(d.ad),
                "ad_axes_um": um(d.axes),
                "rd_um": um(d.rd),
                "cycles": d.cycles,
            }
            for (i, j), d in found.distances.items()
        ],
        "vap_um": um(found.variation),
        "dap_um": um(found.drift[0] if found.drift else None),
        "drp_um": um(found.drift[1] if found.drift else None),
        "exchangeability_um": um(found.exchange),
        "remarks": found.remarks,
    }


SAME = {"angle": np.radians(0.005), "length": 5e-6}
"""[rad, m] Commands that are nearer than this are one: files round to a hundredth of a degree or 10 µm."""


def _pose_of(data: Measurements, q: np.ndarray, source: str) -> np.ndarray:
    """(N,) which command of q (P, nq) each row repeats.

    Raises:
        InputError: a row repeats none of them.
    """
    from pcalib.errors import InputError

    distance = np.abs(data.q[:, None] - q[None]).max(axis=-1)
    nearest = distance.argmin(axis=1)
    far = distance.min(axis=1) > SAME[data.actuator_dimension]
    if far.any():
        row = int(np.argmax(far))
        raise InputError(
            "this row repeats none of the commands", file=source, line=int(data.lines[row]),
            remedy="name the command file that was run; its actuator values are compared with those of the row",
        )
    return nearest


def _labels(data: Measurements, path: str, kept: np.ndarray) -> np.ndarray | None:
    found = data.notes.get(path, data.columns.get(path))
    return None if found is None else np.asarray(found)[kept]


def _other(file: Path, robot: Any, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from pcalib.data import measurement

    data = measurement.load(file, robot)
    kept = ~np.isnan(data.position).any(axis=1)
    return _pose_of(data, q, str(file))[kept], data.position[kept]


def _conditions(data: Measurements) -> dict[str, str]:
    """What the file states about instrument and conditions."""
    from pcalib.wording import small

    sigma = f"1σ {small(float(np.median(data.sigma[:, :3])), 'm')} per component"
    out = {"instrument": sigma if data.stated[0] else "σ not stated"}
    out["payload"] = _range(data.payload, "kg")
    out["tool"] = ", ".join(f"{axis} {_range(1e3 * data.tool[:, i], 'mm')}" for i, axis in enumerate("xyz"))
    for name, values in data.columns.items():
        if name.startswith("temp"):
            out[name.replace("_", " of ").replace("temp", "temperature")] = _range(values, "°C")
    return out


def _range(values: np.ndarray, unit: str) -> str:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return f"{low:.4g} {unit}" if low == high else f"{low:.4g} to {high:.4g} {unit}"


def _write_poses(robot: Any, cycles: int, tool: np.ndarray, output: Path) -> None:
    """The targets of the test: the largest cube of the workspace whose five poses the robot reaches."""
    from pcalib import compensation, iso9283
    from pcalib.data import table
    from pcalib.errors import ReachError
    from pcalib.model import Model
    from pcalib.prediction import Conditions

    space = robot.workspace
    edge, centre = iso9283.largest_cube(space.radius, space.z_min, space.z_max)
    for _ in range(40):
        five = iso9283.cube_poses(edge, centre)
        conditions = Conditions(np.zeros((5, 3)), np.zeros(5), {})
        if (compensation.compensate(Model.nominal(robot), five, conditions=conditions).status == "ok").all():
            break
        edge *= 0.95
    else:
        raise ReachError(f"robot '{robot.name}' reaches no cube in its workspace\n  check [workspace] and [joints]")
    places = np.tile(five + tool, (cycles, 1))
    columns: dict[str, np.ndarray] = {f"{axis}_mm": places[:, i] * 1e3 for i, axis in enumerate("xyz")}
    if tool.any():
        columns |= {f"tool_{axis}_mm": np.full(len(places), tool[i] * 1e3) for i, axis in enumerate("xyz")}
    table.write(output, columns, {"robot": robot.name})
    say(f"Five poses of a cube of {edge * 1e3:.0f} mm, {cycles} times, written to {output}.")
    say_next("compensate", output, "--model", "model.toml", "-o", "commands.csv")
