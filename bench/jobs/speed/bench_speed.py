"""What the virtual robot costs, beside the bounds that it is held to: the command of scripts/benchmark_bench."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench import faults, kinds, simulate
from bench import plan as plans
from bench import truth as truths
from bench.batch import BatchMachine
from bench.batch import possible as batch_possible
from bench.faults import Fault
from bench.instrument import Instrument
from bench.jobs.speed import timing
from bench.jobs.speed.timing import Cost, median
from bench.machine import Machine
from bench.truth import Truth
from pcalib import robot as robots
from pcalib.cli import frame
from pcalib.data import measurement
from pcalib.errors import InputError
from pcalib.robot import Robot

RIGID_US, REST_MS, DATA_S = 150.0, 3.0, 1.0
"""Bounds: a rigid pose [µs], a pose in equilibrium [ms], a rich data set of 120 poses [s]."""
SEVERAL = ("drive_compliance", "rod_compliance", "arm_bending", "plate_flexing", "tool_bending", "frame_bending")
"""Faults of compliance, one for every part of the robot that bends."""
ROWS = 120
WORKERS = (1, 2, 4)
TOOL = np.array([0.05, 0.0, -0.1])


def command(
    *, robot: Path | None = None, repeats: int = 7, quick: bool = False, json: frame.JsonOption = None
) -> int:
    """Time the virtual robot: rigid poses, poses in equilibrium and whole data sets; compare the bytes of data sets.

    Every figure is the median of several runs: processor time of one process, so that a busy machine makes little
    difference, and time on the wall where workers share the rows. Exit code 1 where a bound is missed.

    Args:
        robot: Robot file; the default Delta where absent. Other kinds are timed beside it.
        repeats: Runs of each figure.
        quick: Two runs and a few poses, to see that everything runs.
    """
    if repeats < 1:
        raise InputError(f"--repeats {repeats} must be at least 1")
    main_robot = robots.load(robot or kinds.MODELS / "delta.toml")
    runs, rows = (2, 24) if quick else (repeats, ROWS)
    others = [] if quick else [robots.load(file) for file in sorted(kinds.MODELS.glob("*.toml"))]
    others = [other for other in others if other.kind != main_robot.kind]
    parts: list[timing.Part] = [
        lambda: rigid(main_robot, rows, runs),
        lambda: equilibrium(main_robot, rows, runs),
        *((lambda other=other: family(other, rows, runs)) for other in others),
        lambda: data_sets(main_robot, rows, runs),
    ]
    found = timing.gather(parts, f"{main_robot.name}: median of {runs} runs, {rows} poses")
    same = bytes_agree(main_robot, simulate.CHUNK + 1 if quick else 300)
    workers = ", ".join(map(str, WORKERS))
    frame.say(f"same seed, {workers} workers: {'the same bytes' if same else 'DIFFERENT BYTES'}")
    frame.write_json(json, {"schema": "pcbench.speed/1", "figures": timing.as_json(found), "same_bytes": same})
    return frame.OK if same and all(cost.holds for cost in found) else frame.NOT_HELD


def rigid(robot: Robot, rows: int, runs: int) -> list[Cost]:
    """Microseconds per pose of a rigid robot, each from home."""
    q = plans.make(robot, "random", rows).commands.q
    out = []
    for variant in kinds.get(robot.kind).variants:
        machine = Machine(robot, variant=variant)
        per_pose = 1e6 * median(lambda machine=machine: machine.land(q, TOOL), runs) / rows
        out.append(Cost(f"rigid pose, {variant}", per_pose, "µs", RIGID_US))
    if batch_possible(robot):
        many, wide = BatchMachine(robot), np.resize(q, (10 * rows, q.shape[1]))
        per_pose = 1e6 * median(lambda: many.land(wide, TOOL), runs) / len(wide)
        out.append(Cost("rigid pose, in batches", per_pose, "µs", RIGID_US))
    return out


def equilibrium(robot: Robot, rows: int, runs: int) -> list[Cost]:
    """Milliseconds per pose of robots that give way, on a rich plan."""
    cases = {
        "equilibrium, one spring per drive": suited(robot, ("drive_compliance",)),
        f"equilibrium, {len(suited(robot, SEVERAL))} compliances": suited(robot, SEVERAL),
        f"equilibrium, all {len(suited(robot))} faults": suited(robot),
    }
    return [Cost(name, at_rest(robot, made, rows, runs), "ms", REST_MS) for name, made in cases.items()]


def family(robot: Robot, rows: int, runs: int) -> list[Cost]:
    """A rigid pose and one with all faults, of another kind."""
    q = plans.make(robot, "random", rows).commands.q
    machine = Machine(robot)
    everything = suited(robot)
    return [
        Cost(f"{robot.name}: rigid pose", 1e6 * median(lambda: machine.land(q, TOOL), runs) / rows, "µs", RIGID_US),
        Cost(f"{robot.name}: all {len(everything)} faults", at_rest(robot, everything, rows, runs), "ms", REST_MS),
    ]


def at_rest(robot: Robot, present: tuple[Fault, ...], rows: int, runs: int) -> float:
    """Milliseconds per pose."""
    commands = plans.make(robot, "rich", rows, tools=[TOOL]).commands
    machine = Machine(robot, None, present)
    return 1e3 * median(lambda: machine.run(commands), runs) / rows


def data_sets(robot: Robot, rows: int, runs: int) -> list[Cost]:
    """Seconds from truth to measurements, the plan and the compilation of the model included."""
    out = []
    for name, present in (("one fault", suited(robot, ("drive_compliance",))), ("all faults", suited(robot))):
        truth = hidden(robot, present)
        seconds = median(lambda truth=truth: measure(truth, rows, 1), runs)
        out.append(Cost(f"rich data set of {rows}, {name}", seconds, "s", DATA_S))
        if len(present) > 1:
            measure(truth, rows, 2)  # processes start once
            shared = median(lambda truth=truth: measure(truth, rows, 2), runs, time.perf_counter)
            out.append(Cost(f"rich data set of {rows}, {name}, 2 running workers", shared, "s", DATA_S))
    return out


def bytes_agree(robot: Robot, rows: int) -> bool:
    """Whether the files of one seed are the same for any number of workers, who need more than one piece to share."""
    assert rows > simulate.CHUNK
    truth, made = hidden(robot, suited(robot)), set()
    with TemporaryDirectory() as folder:
        for workers in WORKERS:
            file = Path(folder) / "data.csv"
            measurement.save(file, measure(truth, rows, workers).measurements)
            made.add(file.read_bytes())
    return len(made) == 1


def measure(truth: Truth, rows: int, workers: int) -> simulate.DataSet:
    """A rich data set."""
    return simulate.run(truth, plans.make(truth.robot, "rich", rows, tools=[TOOL], seed=1), 1, workers)


def hidden(robot: Robot, present: tuple[Fault, ...]) -> Truth:
    """An imperfect robot with these faults, seen by a tracker."""
    errors = truths.draw_errors(robot, 3e-4, 2e-3, seed=1)
    return Truth(robot, errors, Instrument(sigma_pos=2e-5, sigma_rot=1e-4, frame="tracker"), present)


def suited(robot: Robot, names: Sequence[str] = ()) -> tuple[Fault, ...]:
    """Those of these faults (all, where none are named) that this kind of robot can have, of usual size."""
    out = []
    for name in names or faults.names():
        try:
            fault = faults.typical(robot, name)
            Machine(robot, None, [fault])
        except InputError:
            continue
        out.append(fault)
    return tuple(out)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return frame.script("benchmark_bench", command, argv)


if __name__ == "__main__":
    sys.exit(main())
