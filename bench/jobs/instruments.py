"""Robots calibrated with what a workshop has, and where they land with a long tool.

Each robot has random errors and is measured by the virtual robot's own sensors; pcalib fits it, makes commands for
targets all over the workspace, and MuJoCo lands them. Instruments of unknown place say nothing of where the robot's
base stands: the attained positions are laid onto the wanted ones by a rigid motion, as an integrator teaches a frame.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench import simulate
from bench import truth as truths
from bench.commands import Commands
from bench.jobs.alignment import align
from bench.plan import Plan
from bench.truth import Truth
from pcalib import compensation, planning
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.model import Conditions
from pcalib.robot import Robot

DELTA = Path(__file__).parents[2] / "models" / "delta.toml"
LONG = np.array([0.0, 0.0, -0.3])
"""[m] tool that lands."""
TOOLS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.15]])
"""[m] tools that measure."""
TARGETS = 60
BALLS = np.array([[0.22, 0.0, -1.0], [-0.11, 0.19, -1.0], [-0.11, -0.19, -1.0]])
"""[m] places of the ballbar's balls on a table below the robot."""
REACH = (0.1, 0.3)
"""[m] shortest and longest telescoping bar."""
_BAR = f"""[sensors.ballbar]
sigma_um = 2
stations_m = {BALLS.ravel().tolist()}
shortest_m = {REACH[0]}
longest_m = {REACH[1]}
"""
_LEVEL = """[sensors.inclinometer]
sigma_urad = {}
zero_mrad = [3, -2]
level_mrad = [1, 2]
turn_deg = 1
"""
_PROBE = """[sensors.dial_gauge]
sigma_um = 5
place_mm = [0, 0, -1100]
slope = [0.01, -0.005]
"""
_CAMERA = """noise = "camera"
frame = "tracker"
sigma_pos_um = 20
sigma_depth_um = 100
sigma_rot_urad = 60
sigma_out_urad = 250
"""


@dataclass(frozen=True)
class Case:
    """A way to measure."""

    name: str
    rows: int
    instrument: str
    """Lines of [instrument] and sections of sensors of a truth file."""
    tools: int = 2
    within: float = np.inf
    """[m] RMS that is asked of it."""
    short: bool = False
    """Whether poses must be within reach of the ballbar."""


CASES = (
    Case("ballbar, two tools, 2 µm", 120, f'kind = "none"\n{_BAR}', within=10e-6, short=True),
    Case("ballbar and inclinometer 20 µrad", 120, f'kind = "none"\n{_BAR}{_LEVEL.format(20)}', short=True),
    Case("ballbar, one tool", 120, f'kind = "none"\n{_BAR}', tools=1, short=True),
    Case("probe 5 µm, inclinometer 100 µrad", 60, f'kind = "none"\n{_PROBE}{_LEVEL.format(100)}', 1, 40e-6),
    Case("probe 5 µm alone", 60, f'kind = "none"\n{_PROBE}', 1),
    Case("camera 20 and 100 µm, σ by component", 80, _CAMERA, within=20e-6),
    Case("camera, one σ for all", 80, f"{_CAMERA}state_axes = false\n"),
)


def truth_of(case: Case, seed: int) -> Truth:
    """A robot with errors of 0.1 mm and 0.05° in every parameter, before that instrument."""
    text = (
        f'robot = "{DELTA}"\n[geometry]\nsigma_length_mm = 0.1\nsigma_angle_deg = 0.05\nseed = {seed}\n'
        f"[instrument]\n{case.instrument}"
    )
    return truths.parse(text, DELTA.parent / "truth.toml")


def plan_of(case: Case, robot: Robot, seed: int) -> Plan:
    """Random poses, with the tools by turns; those of a ballbar within reach of the ball whose turn it is."""
    rng = np.random.default_rng([1717, seed])
    space = planning.reachable(robot, 40 * case.rows if case.short else case.rows, rng)
    tool = TOOLS[rng.integers(0, case.tools, len(space.q))]
    rows = np.arange(len(space.q))
    if case.short:
        away = np.linalg.norm((space.pose.x + tool)[:, None] - BALLS, axis=-1)  # (n, balls); the plate hardly tilts
        inside = (away > REACH[0] + 0.005) & (away < REACH[1] - 0.005)
        free, rows = np.ones(len(away), bool), np.zeros(0, int)
        for i in range(case.rows):
            found = np.flatnonzero(free & inside[:, i % len(BALLS)])[0]
            free[found] = False
            rows = np.append(rows, found)
    n = len(rows)
    commands = Commands(space.q[rows], tool[rows], np.zeros(n), {})
    return Plan(commands, np.full(n, -1), np.zeros(n, bool), "random")


def landed(truth: Truth, measured: Measurements, seed: int, level: str = "complete") -> float:
    """RMS [m] of the distances of TCPs with the long tool from their targets, after a rigid alignment."""
    found = identification.fit(measured, truth.robot, level).model
    rng = np.random.default_rng([3, seed])
    wanted = planning.reachable(truth.robot, TARGETS, rng).pose.x + LONG
    conditions = Conditions.of(len(wanted), LONG)
    made = compensation.compensate(found, wanted, conditions=conditions, limits=False)
    ok = made.status == "ok"
    reached = truth.machine().land(made.q[ok], LONG)
    there = align(reached.tcp[None], wanted[ok])[0]
    seen = reached.ok  # the true robot stops at its joint range a little earlier or later than the drawing's
    assert seen.mean() > 0.9
    return float(np.sqrt(np.mean(np.sum((there - wanted[ok])[seen] ** 2, axis=1))))


def one(case: Case, seed: int) -> float:
    """Where one robot lands."""
    truth = truth_of(case, seed)
    data = simulate.run(truth, plan_of(case, truth.robot, seed), seed).measurements
    return landed(truth, data, seed)


def study(count: int, seed: int, say: Callable[[str], None] = print) -> dict[str, np.ndarray]:
    """RMS (count,) [m] of every case."""
    say("| instrument | rows | median | RMS of all | worst | asked |\n|---|---|---|---|---|---|")
    out = {}
    for case in CASES:
        found = np.array([one(case, 1000 * seed + i) for i in range(count)])
        out[case.name] = found
        rms = np.sqrt(np.mean(found**2))
        asked = f"≤ {1e6 * case.within:.0f} µm" if np.isfinite(case.within) else ""
        figures = " | ".join(f"{1e6 * value:.1f} µm" for value in (np.median(found), rms, found.max()))
        say(f"| {case.name} | {case.rows} | {figures} | {asked} |")
    return out


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Robots calibrated with workshop instruments, landed in MuJoCo.")
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="three robots")
    asked = parser.parse_args(arguments)
    study(3 if asked.quick else asked.robots, asked.seed)


if __name__ == "__main__":
    main()
