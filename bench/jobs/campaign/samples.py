"""Measuring plans and targets of campaigns, within joint range and workspace of the nominal robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench import plan as plans
from bench.commands import Commands
from bench.instrument import Instrument
from bench.jobs import optimal
from bench.jobs.campaign.cell import Poses, Verify
from pcalib import workspace
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.robot import Robot, Workspace


def shared(robot: Robot, wanted: Poses, instrument: Instrument, seed: int) -> plans.Plan | None:
    """The plan of all robots of a cell, from a file or D-optimal; None where each robot has a plan of its own."""
    if wanted.listed is not None:
        return listed(wanted.listed)
    if wanted.kind != plans.OPTIMAL:
        return None
    return optimal.make(
        robot, instrument, wanted.poses, tools=list(wanted.tools), payloads=wanted.payloads,
        candidates=wanted.candidates, seed=seed,
    )  # fmt: skip


def own(robot: Robot, wanted: Poses, seed: int) -> plans.Plan:
    """The plan of one robot: `pcbench simulate` makes the same from this seed.

    Raises:
        ReachError: the workspace has too few poses that the robot can take.
    """
    if wanted.inside < 1:
        robot = replace(robot, workspace=_shrunk(robot.workspace, wanted.inside))
    if wanted.kind == "joint":
        n = wanted.poses
        q = workspace.reachable(robot, n, np.random.default_rng(seed)).q
        commands = Commands.of(q, np.resize(wanted.tools, (n, 3)), np.resize(wanted.payloads or [0.0], n))
        return plans.Plan(commands, np.full(n, -1), np.zeros(n, bool), wanted.kind)
    return plans.make(
        robot, wanted.kind, wanted.poses, tools=list(wanted.tools), payloads=wanted.payloads, seed=seed,
        solver=_solver(robot),
    )  # fmt: skip


def targets(robot: Robot, verify: Verify, seed: int) -> Pose:
    """Plate poses: random ones in the workspace or on its border, or a level grid or level rings through it.

    Raises:
        ReachError: the workspace has too few poses that the robot can take.
    """
    if verify.places in ("grid", "rings"):
        rings = verify.places == "rings"
        x = _rings(robot.workspace) if rings else workspace.workspace_grid(robot, verify.spacing or None)
        return Pose(x, np.broadcast_to(np.eye(3), (len(x), 3, 3)), np.zeros((len(x), len(robot.mechanism.hinges))))
    q = plans.make(robot, verify.places, verify.targets, seed=seed, solver=_solver(robot)).commands.q
    return kinematics.forward(robot.mechanism, robot.mechanism.nominal, q).pose


def _rings(w: Workspace, levels: int = 5, count: int = 3, around: int = 24) -> np.ndarray:
    """Plate positions (P, 3) [m] in levels through the working cylinder: on its axis and on rings out to its border."""
    radius = np.append(0.0, np.repeat(w.radius * np.arange(1, count + 1) / count, around))
    azimuth = np.append(0.0, np.tile(2 * np.pi * np.arange(around) / around, count))
    disc = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth)], axis=-1)
    z = np.repeat(np.linspace(w.z_min, w.z_max, levels), len(disc))
    return np.column_stack([np.tile(disc, (levels, 1)), z])


def _shrunk(w: Workspace, size: float) -> Workspace:
    """The working cylinder with its radius and height multiplied by `size`, about its middle."""
    middle, half = 0.5 * (w.z_max + w.z_min), 0.5 * size * (w.z_max - w.z_min)
    return replace(w, radius=size * w.radius, z_min=middle - half, z_max=middle + half)


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
