"""The poses to measure: D-optimal commands for a robot and an instrument.

    pcalib plan --robot models/delta.toml -n 40 -o plan.csv
    pcalib plan --robot models/delta.toml -n 40 --tool 0,0,0mm --tool 0,0,-300mm --position-only -o plan.csv
    pcalib plan --robot models/delta.toml -n 120 --instrument ballbar:2um --reach 100,300mm --tool 0,0,0mm -o plan.csv
    pcalib plan --within 30um --robot models/delta.toml --tool 0,0,-300mm --sigma-pos 20um -o plan.csv
    pcalib plan --to-tell --robot models/delta.toml -n 72 --temperature 16degC --temperature 28degC -o plan.csv
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from pcalib.cli._next import MEASURED, say_next
from pcalib.cli._tools import ToolsOption, tool_options
from pcalib.cli.frame import (
    NOT_HELD,
    BesideOption,
    JsonOption,
    RequiredOutput,
    SeedOption,
    count,
    progress,
    quantity,
    say,
    write_json,
)


def command(
    *,
    robot: Path,
    output: RequiredOutput,
    n: Annotated[int, Parameter(name=["--poses", "-n"]), count(10_000)] = 40,
    tool: ToolsOption = (),
    sigma_pos: Annotated[np.ndarray | None, quantity("length")] = None,
    sigma_rot: Annotated[np.ndarray | None, quantity("angle")] = None,
    position_only: bool = False,
    instrument: tuple[str, ...] = (),
    station: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True, negative=())] = (),
    reach: Annotated[np.ndarray | None, quantity("length", 2)] = None,
    level: str = "complete",
    repeat: Annotated[int | None, Parameter(validator=Number(gte=0))] = None,
    check: Annotated[int | None, Parameter(validator=Number(gte=0))] = None,
    to_tell: Annotated[tuple[str, ...] | None, Parameter(consume_multiple=True)] = None,
    payload: tuple[str, ...] = (),
    temperature: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True)] = (),
    plot: BesideOption = None,
    within: Annotated[np.ndarray | None, quantity("length")] = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> int | None:
    """The poses to measure: D-optimal commands for a robot and an instrument.

    Chooses, among reachable poses within joint range and workspace, those whose readings tell most about the
    geometry. Writes a table of commands with the nominal positions, to be measured or given to 'pcbench simulate'.

    Args:
        robot: Robot file (TOML), or the name of a robot of models/: delta.
        output: Plan to write, CSV.
        n: How many poses.
        tool: A tool at hand, e.g. 0,0,-300mm; may be given several times. None: the plate's centre is measured.
        sigma_pos: Instrument noise, 1σ per component; 0.02mm when absent.
        sigma_rot: Instrument noise of rotations; 0.005deg when absent.
        position_only: The instrument gives no orientation.
        instrument: Plan for this instrument instead of one that reads poses, with its 1σ if it is known: ballbar:2um,
            inclinometer:20urad, dial-gauge; may be given several times.
        station: With ballbar: a place where a ball stands, e.g. 300,0,-1050mm; may be given several times. Chosen when
            absent.
        reach: With ballbar: its shortest and longest length, e.g. 100,300mm.
        level: Geometry level that is to be identified.
        repeat: How many of the poses are measured twice; 10 when absent.
        check: How many further poses are held out (set = check): random ones, which no fit uses; 10 when absent.
        to_tell: Choose rows that tell effects apart instead: the named ones, or all that the robot can have. Rows then
            have payloads, directions, replicates and, where named, temperatures; the units of noise that separate every
            pair of effects are printed.
        payload: With --to-tell: a mass at hand, e.g. 2kg; may be given several times. 0, 1 and 2 kg when absent.
        temperature: With --to-tell: a temperature at hand, e.g. 28degC; may be given several times.
        plot: With --to-tell: also draw the matrix of separations, SVG.
        within: As many poses as bring 95 % of landings within this radius, with the longest tool, e.g. 30um. Ends
            with 1 where no number does, and says which instrument would.
        seed: Seed of the draw of candidate poses.
    """
    from pcalib import planning, units, workspace
    from pcalib import robot as robots
    from pcalib.data import table
    from pcalib.errors import InputError, unknown
    from pcalib.mechanics import kinematics

    described = robots.load(robot)
    mechanism = described.mechanism
    if level not in mechanism.levels:
        raise InputError(unknown("level", level, mechanism.levels))
    tools = np.array(tool_options(tool, described)) if tool else None
    for option, value in (("--sigma-pos", sigma_pos), ("--sigma-rot", sigma_rot)):
        if value is not None and not value[0] > 0:
            raise InputError(f"{option} must be more than 0", remedy="say how well the instrument measures, 1σ")
    noise = np.r_[
        np.full(3, 2e-5 if sigma_pos is None else float(sigma_pos[0])),
        np.full(3, np.inf if position_only else np.radians(0.005) if sigma_rot is None else float(sigma_rot[0])),
    ]
    if to_tell is not None:
        from pcalib.cli import _to_tell
        from pcalib.diagnosis.separation import AtHand

        for option, value in (("--repeat", repeat), ("--check", check)):
            if value is not None:
                raise InputError(
                    f"{option} does not go with --to-tell, which chooses replicates itself and holds no row out",
                    remedy=f"leave {option} out, or plan such rows by themselves: pcalib plan without --to-tell",
                )
        masses = [float(units.parse_quantity(text, "mass", option="--payload")[0]) for text in payload]
        warm = [float(units.parse_quantity(text, "temperature", option="--temperature")[0]) for text in temperature]
        at_hand = AtHand(masses or AtHand.payloads, tools, warm)
        _to_tell.run(described, n, noise, to_tell, at_hand, level, seed, output, plot, json)
        say_next("inspect", output, "--robot", robot, why=MEASURED)
        return None
    repeat, check = (10 if value is None else value for value in (repeat, check))
    for option, given in (("--payload", payload), ("--temperature", temperature), ("--plot", plot)):
        if given:
            raise InputError(f"{option} belongs to --to-tell", remedy="add --to-tell, or leave it out")
    if instrument:
        from pcalib.cli import _instruments

        _instruments.run(described, n, instrument, station, reach, tools, level, repeat, seed, output, json)
        say_next("inspect", output, "--robot", robot, why=MEASURED)
        return None
    reached: dict[str, object] = {}
    if within is not None:
        from pcalib.cli import _within

        at = np.zeros((1, 3)) if tools is None else tools
        poses, reached = _within.run(described, float(within[0]), at, noise, level, seed)
        if poses is None:
            write_json(json, {"schema": "pcalib.plan/1", **reached})
            return NOT_HELD
        n = poses
    with progress("choosing poses", 100) as advance:
        done = 0

        def tick(share: float) -> None:
            nonlocal done
            advance(int(100 * share) - done)
            done = int(100 * share)

        q, t = planning.plan(
            described, n, tools=tools, measured=[True] * 3 + [not position_only] * 3, level=level, seed=seed, tick=tick,
            sigma_pos=float(noise[0]), sigma_rot=np.radians(0.005) if position_only else float(noise[3]),
        )  # fmt: skip
    # Rows measured twice verify the noise, and rows held out say how the model does where it was not fitted.
    again = np.unique(np.linspace(0, n - 1, min(repeat, n)).astype(int)) if repeat else np.zeros(0, int)
    held = workspace.reachable(described, check, np.random.default_rng([seed, 1])).q if check else q[:0]
    q, t = np.concatenate([q, q[again], held]), np.concatenate([t, t[again], np.resize(t, (len(held), 3))])
    ids = np.concatenate([np.arange(n), again, n + np.arange(len(held))]) + 1
    sets = ["fit"] * (n + len(again)) + ["check"] * len(held)
    point = kinematics.forward(mechanism, mechanism.nominal, q).pose.tcp(t)
    suffix, factor = described.command_unit, units.UNITS[described.command_unit].factor
    columns = {f"{name}_{suffix}": q[:, i] / factor for i, name in enumerate(mechanism.actuators)}
    columns |= {f"tool_{axis}_mm": t[:, i] * 1e3 for i, axis in enumerate("xyz") if tools is not None}
    columns |= {f"nominal_{axis}_mm": point[:, i] * 1e3 for i, axis in enumerate("xyz")}
    table.write(output, columns | {"pose_id": ids, "set": sets}, {"robot": described.name})
    readings = n * (len(mechanism.plate_dofs) if not position_only else sum(c < 3 for c in mechanism.plate_dofs))
    beside = [f"{len(again)} of them twice, which verifies the noise"] if len(again) else []
    beside += [f"and {len(held)} more to be held out"] if len(held) else []
    say(", ".join([f"{n} poses", *beside]) + f", written to {output}: {len(q)} rows.")
    unknowns = len(mechanism.levels[level].columns)
    if readings <= unknowns:
        say(f"- Their {readings} readings are few for the {unknowns} parameters of level {level}.")
    say_next("inspect", output, "--robot", robot, why=MEASURED)
    write_json(json, {"schema": "pcalib.plan/1", "poses": n, "level": level, "q_si": q, "tool_m": t, **reached})
    return None
