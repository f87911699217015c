"""Plans that campaigns measure and targets that they check, within joint range and workspace of the nominal robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench import plan as plans
from bench.commands import Commands
from bench.instrument import Instrument
from bench.jobs import optimal
from bench.jobs.campaign.cell import Plan
from pcalib import workspace
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.robot import Robot


def shared(robot: Robot, wanted: Plan, instrument: Instrument, seed: int) -> plans.Plan | None:
    """The plan of all robots of a cell, from a file or D-optimal; None where each robot has a plan of its own."""
    if wanted.listed is not None:
        return listed(wanted.listed)
    if wanted.kind != "d-optimal":
        return None
    return optimal.make(
        robot, instrument, wanted.poses, tools=list(wanted.tools), payloads=wanted.payloads,
        candidates=wanted.candidates, seed=seed,
    )  # fmt: skip


def own(robot: Robot, wanted: Plan, seed: int) -> plans.Plan:
    """The plan of one robot: `pcbench simulate` makes the same from this seed.

    Raises:
        ReachError: the workspace has too few poses that the robot can take.
    """
    return plans.make(
        robot, wanted.kind, wanted.poses, tools=list(wanted.tools), payloads=wanted.payloads, seed=seed,
        solver=_solver(robot),
    )  # fmt: skip


def targets(robot: Robot, places: str, n: int, spacing: float, seed: int) -> Pose:
    """Plate poses: n 'random' ones in the workspace or on its 'border', or a 'grid' through it of this spacing [m].

    Raises:
        ReachError: the workspace has too few poses that the robot can take.
    """
    if places == "grid":
        x = workspace.workspace_grid(robot, spacing or None)
        return Pose(x, np.broadcast_to(np.eye(3), (len(x), 3, 3)), np.zeros((len(x), len(robot.mechanism.hinges))))
    q = plans.make(robot, places, n, seed=seed, solver=_solver(robot)).commands.q
    return kinematics.forward(robot.mechanism, robot.mechanism.nominal, q).pose


def listed(table: Mapping[str, Any]) -> plans.Plan:
    """A plan from plain lists, see :func:`as_lists`."""
    columns = {name: np.array(values, float) for name, values in table["columns"].items()}
    commands = Commands(np.array(table["q"]), np.array(table["tool"]), np.array(table["payload"]), columns)
    return plans.Plan(commands, np.array(table["pose_id"], int), np.array(table["check"], bool), "file")


def as_lists(plan: plans.Plan) -> dict[str, object]:
    """A plan as plain lists, to be kept and sent [SI]."""
    c = plan.commands
    return {
        "q": c.q.tolist(), "tool": c.tool.tolist(), "payload": c.payload.tolist(), "pose_id": plan.pose_id.tolist(),
        "check": plan.check.tolist(), "columns": {name: values.tolist() for name, values in c.columns.items()},
    }  # fmt: skip


def _solver(robot: Robot) -> plans.Solver:
    """Commands of the nominal robot by pcalib's inverse, many at a time: the bench's own gives the same, one by one."""
    mechanism = robot.mechanism

    def solve(x: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = kinematics.inverse(mechanism, mechanism.nominal, x, R)
        with np.errstate(invalid="ignore"):
            inside = (found.q >= robot.joint_min) & (found.q <= robot.joint_max)
        return found.q, found.ok & inside.all(axis=1)

    return solve
