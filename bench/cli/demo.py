"""Measure, calibrate, compensate and check a virtual robot, from millimetres off to on target.

    pcbench demo
    pcbench demo --seed 7 --length-error 0.5mm --angle-error 0.2deg
    pcbench demo --robot models/delta_small.toml --tool 0,0,0mm --tool 0,0,-50mm -o out/small
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pcalib.cli._tools import ToolsOption, tool_options
from pcalib.cli.frame import JsonOption, OutputFolder, SeedOption, count, quantity


def command(
    *,
    output: OutputFolder = Path("out/demo"),
    robot: Path | None = None,
    tool: ToolsOption = (),
    length_error: Annotated[np.ndarray | None, quantity("length")] = None,
    angle_error: Annotated[np.ndarray | None, quantity("angle")] = None,
    poses: Annotated[int, count(10_000)] = 40,
    spacing: Annotated[np.ndarray | None, quantity("length")] = None,
    seed: SeedOption = 5,
    json: JsonOption = None,
) -> int:
    """Measure, calibrate, compensate and check a virtual robot, from millimetres off to on target.

    A robot with random errors in all of its dimensions is measured in MuJoCo at D-optimal poses. It is then
    identified from these data under ever better models, and MuJoCo lands the TCP all over the workspace by the
    commands that each of them gives, with tools that were never measured.

    Args:
        output: Folder for data, truth, models, recording and report.
        robot: Robot file (TOML); models/delta.toml when absent.
        tool: TCP in the plate frame, e.g. 0,0,-300mm; may be given several times. None, 100 and 300 mm when absent.
        length_error: 1σ of the errors of all lengths; 0.3mm when absent.
        angle_error: 1σ of the errors of all angles; 0.12deg when absent.
        poses: Poses to measure.
        spacing: Distance of the targets; a fifth of the workspace's radius when absent.
        seed: The same seed gives the same robot and the same noise.
    """
    import time

    from bench.jobs import demo, demo_report
    from bench.kinds import MODELS
    from pcalib import robot as robots
    from pcalib.cli import frame
    from pcalib.errors import InputError

    begun = time.monotonic()
    described = robots.load(MODELS / "delta.toml" if robot is None else robot)
    given: dict[str, Any] = {}
    for name, option, value in (
        ("sigma_length", "--length-error", length_error),
        ("sigma_angle", "--angle-error", angle_error),
        ("spacing", "--spacing", spacing),
    ):
        if value is not None:
            given[name] = float(value[0])
            if not 0 <= given[name] < 1:
                raise InputError(f"{option}: {given[name]:g} (SI) makes no sense here")
    tools = tuple(tuple(t.tolist()) for t in tool_options(tool)) or demo.straight(described)
    if robot is not None:
        given["robot_file"] = robot
    settings = demo.Settings(poses=poses, seed=seed, tools=tools, **given)
    with frame.progress("measuring, identifying and landing", demo.stages(settings)) as advance:
        done = demo.run(described, settings, advance)
    made = demo_report.write(done, output)
    frame.write_json(json, demo.content(done))
    demo_report.show(done, made, time.monotonic() - begun)
    return frame.OK
