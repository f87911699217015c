"""Time and memory of calibration, against their bounds and against MuJoCo's own toolbox: runs as scripts/benchmark."""

from __future__ import annotations

import json as json_text
import os
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from bench import kinds
from bench import truth as truths
from bench.jobs.campaign import spec as specs
from bench.jobs.campaign import trial
from bench.jobs.speed import peer_sysid, timing
from bench.jobs.speed.timing import Cost, median
from pcalib import compensation
from pcalib import robot as robots
from pcalib.cli import frame
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.diagnose import diagnose
from pcalib.errors import InputError
from pcalib.fitting import identification
from pcalib.mechanics import extension, kinematics, native
from pcalib.model import Model
from pcalib.robot import Robot
from pcalib.workspace import reachable

ROOT = Path(__file__).resolve().parents[3]
FIT_MS, FORWARD_US, EXACT_US, FIRST_US, IMPORT_S, HELP_S = 10.0, 8.0, 12.0, 3.0, 0.25, 0.5
CLOSURE_TIMES, SETTLING_TIMES = 30.0, 1000.0
READING_TIMES, DIAGNOSIS_TIMES = 200.0, 100.0
"""Bounds on the time to read 100,000 rows and on that of a diagnosis, in identifications of 120 poses. They are three
times what was measured, 70 and 31."""
IN_C_FORWARD, IN_C_EXACT, IN_C_FIRST = 8.0, 7.0, 3.5
"""A third of what was measured: the extension in C is 25, 23 and 11 times as fast as NumPy."""
POSES = 60
TARGETS = 100_000
ROBOTS = 7
"""Random robots over which the fit is timed: it takes two to five steps."""
QUICK_POSES = 12
TOOL = np.array([0.0, 0.0, -0.3])


def command(
    *,
    robot: Path | None = None,
    repeats: int = 15,
    quick: bool = False,
    peers: Annotated[bool, Parameter(negative="--no-peers")] = True,
    json: frame.JsonOption = None,
) -> int:
    """Time identification, kinematics, compensation and start-up; and the same fit by mujoco.sysid.

    Every figure is the median of several runs, in processor time of one thread, so that a busy machine makes little
    difference. Ratios are of figures of this run. Exit code 1 where a bound is missed.

    Args:
        robot: Robot file of a Delta; the default Delta where absent.
        repeats: Runs of each figure.
        quick: Three runs, 10,000 targets, and the toolbox on 12 poses, to see that everything runs.
        peers: Whether to run mujoco.sysid too; settling rollouts take a minute. --no-peers leaves them out.
    """
    if repeats < 1:
        raise InputError(f"--repeats {repeats} must be at least 1")
    main_robot = robots.load(robot or kinds.MODELS / "delta.toml")
    if main_robot.kind != "delta":
        raise InputError(f"robot '{main_robot.name}' is no delta")
    runs, targets = (min(repeats, 3), 10_000) if quick else (repeats, TARGETS)
    parts: list[timing.Part] = [
        lambda: fits(main_robot, runs),
        lambda: kinematic(main_robot, targets, min(runs, 5)),
        lambda: in_c(main_robot, targets, min(runs, 5)),
        lambda: start_up(main_robot, min(runs, 7)),
        lambda: by_the_fit(main_robot, targets, min(runs, 3)),
    ]
    why = peer_sysid.missing() if peers else "left out"
    if not why:
        parts.append(lambda: toolbox(main_robot, QUICK_POSES if quick else POSES, runs))
    found = timing.gather(parts, f"{main_robot.name}: processor time of one thread, median of {runs} runs")
    if why:
        frame.say(f"mujoco.sysid: {why}.")
    frame.write_json(json, {"schema": "pcbench.core_speed/1", "figures": timing.as_json(found), "quick": quick})
    return frame.OK if all(cost.holds for cost in found) else frame.NOT_HELD


def data_sets(robot: Robot, poses: int, count: int) -> list[Measurements]:
    """Noisy full poses of random robots, by MuJoCo."""
    about = {
        "name": "speed", "robot": tomllib.loads(robot.text), "robots": count, "seed": 1,
        "geometry": {"sigma_length_mm": 0.1, "sigma_angle_deg": 0.05}, "plan": {"kind": "joint", "poses": poses},
    }  # fmt: skip
    spec = specs.parse(json_text.dumps(about))
    return [trial.measured(spec, number).data for number in range(count)]


def fits(robot: Robot, runs: int) -> list[Cost]:
    """Milliseconds per identification of all 60 parameters from 60 full poses, covariance and verdict included."""
    sets = data_sets(robot, POSES, ROBOTS)
    taken = [median(lambda data=data: identification.fit(data, robot), runs) for data in sets]
    taken = 1e3 * np.array(taken)
    return [
        Cost(f"identification, {POSES} full poses", float(np.median(taken)), "ms", FIT_MS),
        Cost(f"the slowest of {ROBOTS} robots", float(taken.max()), "ms"),
    ]


def kinematic(robot: Robot, targets: int, runs: int) -> list[Cost]:
    """Microseconds per pose of forward kinematics and compensation of an imperfect robot with a 300 mm tool."""
    mechanism = robot.mechanism
    errors = truths.draw_errors(robot, 1e-4, np.radians(0.05), seed=2)
    model = Model.nominal(robot).with_geometry(mechanism.nominal + errors)
    q = reachable(robot, targets, np.random.default_rng(3)).q
    wanted = kinematics.forward(mechanism, model.k, q).pose.tcp(TOOL)

    def per_pose(work: Callable[[], object]) -> float:
        return 1e6 * median(work, runs) / targets

    def compensate(method: str) -> Callable[[], object]:
        return lambda: compensation.compensate(model, wanted, TOOL, method=method, limits=False)

    forward = per_pose(lambda: kinematics.forward(mechanism, model.k, q))
    return [
        Cost(f"forward kinematics, {targets} poses", forward, "µs", FORWARD_US),
        Cost("exact compensation", per_pose(compensate("exact")), "µs", EXACT_US),
        Cost("first-order compensation", per_pose(compensate("first-order")), "µs", FIRST_US),
    ]


def in_c(robot: Robot, targets: int, runs: int) -> list[Cost]:
    """How many times as long NumPy takes as the extension; they take turns, so that what slows one slows both."""
    if extension.library() is None:
        frame.say(f"No comparison with C: {extension.about()}.")
        return []
    mechanism = robot.mechanism
    k = mechanism.nominal + truths.draw_errors(robot, 1e-4, np.radians(0.05), seed=2)
    model = Model.nominal(robot).with_geometry(k)
    q = reachable(robot, targets, np.random.default_rng(3)).q
    wanted = kinematics.forward(mechanism, k, q).pose.tcp(TOOL)
    (data,) = data_sets(robot, POSES, 1)

    def first_order() -> object:
        return compensation.compensate(model, wanted, TOOL, method="first-order", limits=False)

    out = []
    for name, work, bound in (
        (f"forward kinematics, {targets} poses", lambda: kinematics.forward(mechanism, k, q), IN_C_FORWARD),
        ("exact inverse", lambda: kinematics.inverse(mechanism, k, wanted, None, TOOL), IN_C_EXACT),
        ("first-order compensation", first_order, IN_C_FIRST),
        (f"identification, {POSES} full poses", lambda: identification.fit(data, robot), None),
    ):
        taken = []
        for _ in range(runs):
            fast = median(work, 1)
            with left_to_numpy():
                taken.append((fast, median(work, 1)))
        fast, slow = np.median(taken, axis=0)
        out.append(Cost(f"NumPy by C: {name}", slow / fast, "times", bound, at_least=True))
    alone = 1e6 * median(lambda: native.forward(mechanism, k, q, None), runs) / targets
    return [*out, Cost("forward kinematics, the C alone", alone, "µs")]


@contextmanager
def left_to_numpy() -> Iterator[None]:
    """Without the extension."""
    before = os.environ.get(extension.VARIABLE)
    os.environ[extension.VARIABLE] = "0"
    try:
        yield
    finally:
        if before is None:
            del os.environ[extension.VARIABLE]
        else:
            os.environ[extension.VARIABLE] = before


def start_up(robot: Robot, runs: int) -> list[Cost]:
    """Seconds until the package is imported and help is printed; whole commands as multiples of importing NumPy.

    Modules are compiled beforehand, as they are where Python may write beside them.
    """
    (data,) = data_sets(robot, 150, 1)
    with tempfile.TemporaryDirectory() as folder:
        path, drawn, model, cache = (
            str(Path(folder) / name) for name in ("data.csv", "robot.toml", "model.toml", "cache")
        )
        compiled = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        compiled["PYTHONPYCACHEPREFIX"] = cache

        def seconds(*arguments: str) -> float:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, *arguments], cwd=ROOT, check=True, stdout=subprocess.DEVNULL, env=compiled)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

        def middle(*arguments: str) -> float:
            seconds(*arguments)  # compiled and in the cache
            return float(np.median([seconds(*arguments) for _ in range(runs)]))

        out = [
            Cost("import pcalib, python included", middle("-c", "import pcalib"), "s", IMPORT_S),
            Cost("pcalib --help", middle("-m", "pcalib", "--help"), "s", HELP_S),
        ]
        measurement.save(Path(path), data)
        Path(drawn).write_text(robot.text, encoding="utf-8")
        reference = middle("-c", "import numpy")
        for name, *arguments in (
            ("--version",), ("inspect", path, "--robot", drawn), ("fit", path, "--robot", drawn, "-o", model),
            ("compare", path, "--model", model), ("diagnose", path, "--model", model),
            ("explain", "drive_compliance", path, "--model", model),
        ):  # fmt: skip
            value = middle("-m", "pcalib", name, *arguments) / reference
            out.append(Cost(f"pcalib {name}{', 150 rows' if arguments else ''}, by 'import numpy'", value, "times"))
    return out


def by_the_fit(robot: Robot, rows: int, runs: int) -> list[Cost]:
    """How many times as long as an identification it takes to read a large file, and to diagnose 120 poses."""
    (data,) = data_sets(robot, 120, 1)
    model = identification.fit(data, robot).model
    reference = median(lambda: identification.fit(data, robot), 2 * runs)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.csv"
        measurement.save(path, data.take(np.resize(np.arange(len(data)), rows)))
        reading = median(lambda: measurement.load(path, robot), runs)
    diagnosing = median(lambda: diagnose(model, data), runs)
    return [
        Cost(f"reading {rows} rows, by the time of an identification", reading / reference, "times", READING_TIMES),
        Cost("diagnosis of 120 poses, by the same", diagnosing / reference, "times", DIAGNOSIS_TIMES),
    ]


def toolbox(robot: Robot, poses: int, runs: int) -> list[Cost]:
    """How many times as long mujoco.sysid takes for the same unknowns, priors, data and answer.

    Its fits and ours take turns, so that what slows the machine for a while slows both.
    """
    (data,) = data_sets(robot, poses, 1)
    own = identification.fit(data, robot, prior_scale=1.0).candidate.k
    out = []
    for name, fit, optimizer, bound, turns in (
        ("given the closure residual", peer_sysid.by_closure, "mujoco", CLOSURE_TIMES, runs),
        ("the same with scipy's optimiser", peer_sysid.by_closure, "scipy", None, runs),
        ("with settling rollouts", peer_sysid.by_settling, "mujoco", SETTLING_TIMES, 1),
    ):
        if turns > 1:
            fit(robot, data, optimizer)  # imported and compiled
        taken, once, found = [], [], []
        for _ in range(turns):
            begun = time.process_time()
            found.append(fit(robot, data, optimizer))
            taken.append(time.process_time() - begun)
            once.append(median(lambda: identification.fit(data, robot), 5))
        ratio = float(np.median(taken) / np.median(once))
        out.append(Cost(f"mujoco.sysid {name}, {poses} poses", ratio, "times", bound, at_least=True))
        out.append(Cost("  which takes", float(np.median(taken)), "s"))
        out.append(Cost("  and differs from pcalib by", 1e6 * apart(robot, own, found[-1].k), "µm RMS"))
    return out


def apart(robot: Robot, a: np.ndarray, b: np.ndarray) -> float:
    """[m] RMS difference of the plate's position between two geometries over the workspace."""
    q = reachable(robot, 200, np.random.default_rng(4)).q
    x, y = (kinematics.forward(robot.mechanism, k, q).pose.x for k in (a, b))
    return float(np.sqrt(np.mean(np.sum((x - y) ** 2, axis=1))))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return frame.script("benchmark", command, argv)


if __name__ == "__main__":
    sys.exit(main())
