"""Measure, calibrate, compensate and check a virtual robot, from millimetres off to on target.

    pcbench demo
    pcbench demo --seed 7 --length-error 0.5mm --angle-error 0.2deg
    pcbench demo --robot models/delta_small.toml --tool 0,0,0mm --tool 0,0,-50mm -o out/small
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from pcalib.cli.frame import JsonOption, quantity


def command(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("out/demo"),
    robot: Path | None = None,
    tool: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True, negative=())] = (),
    length_error: Annotated[np.ndarray | None, quantity("length")] = None,
    angle_error: Annotated[np.ndarray | None, quantity("angle")] = None,
    poses: int = 40,
    spacing: Annotated[np.ndarray | None, quantity("length")] = None,
    seed: int = 5,
    json: JsonOption = None,
) -> int:
    """Measure, calibrate, compensate and check a virtual robot, from millimetres off to on target.

    A robot with random errors in all of its dimensions is measured in MuJoCo at D-optimal poses. It is then
    identified from these data under ever better models, and MuJoCo lands the TCP all over the workspace by the
    commands that each of them gives, with tools that were never measured.

    Args:
        output: Folder for data, truth, models, recording and report.
        robot: Robot file (TOML); models/delta.toml when absent.
        tool: TCP in the plate frame, e.g. 0,0,-300mm; may be given several times.
        length_error: 1σ of the errors of all lengths; 0.3mm when absent.
        angle_error: 1σ of the errors of all angles; 0.12deg when absent.
        poses: Poses to measure.
        spacing: Distance of the targets; a fifth of the workspace's radius when absent.
        seed: The same seed gives the same robot and the same noise.
    """
    import time

    from bench.jobs import demo
    from bench.kinds import MODELS
    from pcalib import ladder as ladders
    from pcalib import robot as robots
    from pcalib import units
    from pcalib.cli import frame
    from pcalib.errors import InputError

    begun = time.monotonic()
    described = robots.load(MODELS / "delta.toml" if robot is None else robot)
    given: dict[str, object] = {"poses": poses, "seed": seed}
    if poses < 1 or seed < 0:
        raise InputError(f"--poses {poses} --seed {seed}: at least one pose, and no negative seed, please")
    for name, value in (("sigma_length", length_error), ("sigma_angle", angle_error), ("spacing", spacing)):
        if value is not None:
            if not 0 <= value[0] < 1 or (name == "spacing" and value[0] == 0):
                raise InputError(f"{name.replace('sigma_', '')} {value[0]:g} (SI) makes no sense here")
            given[name] = float(value[0])
    if tool:
        tools = [units.parse_quantity(text, "length", option="--tool") for text in tool]
        if any(len(t) != 3 for t in tools):
            raise InputError("--tool needs three numbers", remedy="for example --tool 0,0,-300mm")
        given["tools"] = tuple(tuple(float(v) for v in t) for t in tools)
    settings = demo.Settings(**given)  # type: ignore[arg-type]
    with frame.progress("measuring, identifying and landing", demo.stages(settings)) as advance:
        done = demo.run(described, settings, advance)
    files = demo.write(done, output)
    frame.write_json(json, demo.content(done))

    frame.say(ladders.sentence(done.ladder))
    print()
    frame.show_table(*ladders.table(done.ladder))
    n = len(done.ladder.maps[0].targets)
    frame.say(
        f"{done.data.q.shape[0]} measured poses, {settings.check} of them held out; {n} targets per tool, landed by "
        f"MuJoCo; {time.monotonic() - begun:.1f} s. Files in {output}:"
    )
    frame.say(f"- {files['report'].name}: the report, for any browser")
    frame.say(f"- {files['recording'].name}: the robot and its error field; open it with: pcalib view {output}")
    frame.say(f"- {files['data'].name}, {files['truth'].name}, {files['complete'].name} …: data, truth and models")
    return frame.OK
