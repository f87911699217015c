"""Compensation: commands that bring the TCP to its targets, under the tool, load and conditions of each target.

* exact: the inverse of the complete model, effects included (paper eq. 27, which it calls difficult).
* first-order: the paper's approximation (eqs 29–33), with S_C at the actual tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib import prediction, rotation
from pcalib.effects.base import Contribution
from pcalib.errors import InputError, unknown
from pcalib.mechanics import kinematics, native
from pcalib.mechanics.kinematics import Solution
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.shown import Tabled
from pcalib.workspace import oriented

METHODS = ("exact", "first-order")


@dataclass(frozen=True)
class Compensated(Tabled):
    """The command for each target, and whether there is one."""

    q: np.ndarray
    """(N, nq) [rad or m]; NaN where the status is not 'ok'."""
    status: np.ndarray
    """(N,) 'ok', 'outside_workspace', 'outside_joint_range', 'unreachable', or 'not_converged' where the load iteration
    does not converge."""


def compensate(
    model: Model,
    position: np.ndarray,
    tool: np.ndarray | Sequence[float] | float = 0.0,
    *,
    rotation_matrix: np.ndarray | None = None,
    conditions: Conditions | None = None,
    method: str = "exact",
    limits: bool = True,
) -> Compensated:
    """Commands for TCP targets in the base frame.

    Args:
        position: (N, 3) [m] wanted TCP positions.
        tool: (3,) or (N, 3) [m] TCP in the plate frame; `conditions.tool` is used where conditions are given.
        rotation_matrix: (N, 3, 3) wanted orientation, for robots that can choose it.
        conditions: payload, temperature, direction … for models with effects.
        method: 'exact' or 'first-order'.
        limits: whether to refuse targets outside a stated workspace and commands outside the joint range.
    """
    if method not in METHODS:
        raise InputError(unknown("method", method, METHODS))
    position = np.atleast_2d(np.asarray(position, float))
    if conditions is None:
        conditions = Conditions.of(len(position), tool)
    solve = exact if method == "exact" else first_order
    found = solve(model, position, conditions, rotation_matrix)
    status = np.where(found.ok, "ok", "unreachable").astype("<U20")
    status[found.unsettled] = "not_converged"
    if limits:
        robot = model.robot
        inside = (found.q >= robot.joint_min - 1e-9) & (found.q <= robot.joint_max + 1e-9)
        status[(status == "ok") & ~inside.all(axis=1)] = "outside_joint_range"
        if robot.workspace.stated:
            R = np.eye(3) if rotation_matrix is None else rotation_matrix
            within = robot.workspace.contains(position - (R @ conditions.tool[..., None])[..., 0])
            if rotation_matrix is not None:
                within &= oriented(robot, rotation_matrix)
            status[~within] = "outside_workspace"
    return Compensated(np.where((status == "ok")[:, None], found.q, np.nan), status)


def exact(
    model: Model, position: np.ndarray, conditions: Conditions, rotation_matrix: np.ndarray | None = None
) -> Solution:
    """IPR_C with all effects: the inverse of the closure, iterated until the effects at its solution converge."""
    mechanism = model.robot.mechanism
    if not model.effects:
        return kinematics.inverse(mechanism, model.k, position, rotation_matrix, conditions.tool)
    found = kinematics.inverse(mechanism, model.k, position, rotation_matrix, conditions.tool)
    total, moved = Contribution(), np.zeros(len(position))
    for _ in range(prediction.ROUNDS):
        usable = Solution(
            np.nan_to_num(found.q), Pose(np.nan_to_num(found.pose.x), found.pose.R, found.pose.phi),
            found.status, found.iterations, found.residual,
        )  # fmt: skip
        at = model.situation(usable.q, usable.pose, conditions, total.deviation)
        total = prediction.contributions(model, at, found.ok)
        tool = conditions.tool + (0.0 if total.tool is None else total.tool)
        goal, turn = position, rotation_matrix
        if total.base is not None:
            undo = np.swapaxes(rotation.exp(total.base[:, 3:]), -1, -2)
            goal = (undo @ (position - total.base[:, :3])[..., None])[..., 0]
            turn = None if rotation_matrix is None else undo @ rotation_matrix
        previous = found.q
        found = kinematics.inverse(
            mechanism, model.k, goal, turn, tool, start=None if total.base is not None else usable,
            deviation=total.deviation,
        )  # fmt: skip
        moved = np.abs(found.q - previous).max(axis=1)
        if not (moved > prediction.FIXED_POINT).any():
            return found
    return found.settling(moved, prediction.FIXED_POINT)


def first_order(
    model: Model, position: np.ndarray, conditions: Conditions, rotation_matrix: np.ndarray | None = None
) -> Solution:
    """Paper eqs (29)–(33): q = IPR_S(x), δX = S_C·δk at the tool, δq = J_S^m·δx, q − δq."""
    mechanism, tool = model.robot.mechanism, conditions.tool

    def in_numpy(rows: np.ndarray) -> Solution:
        turn = None if rotation_matrix is None else rotation_matrix[rows]
        return _first_order_chunk(model, position[rows], conditions.take(rows), turn)

    if not model.effects:
        found = native.inverse(mechanism, mechanism.nominal, position, rotation_matrix, tool, errors=model.errors)
        if found is not None:
            return kinematics.completed(found, lambda rows: kinematics.in_chunks(rows, in_numpy))
    return kinematics.in_chunks(np.arange(len(position)), in_numpy)


def _first_order_chunk(
    model: Model, position: np.ndarray, conditions: Conditions, rotation_matrix: np.ndarray | None
) -> Solution:
    mechanism = model.robot.mechanism
    nominal = mechanism.nominal
    n = len(position)
    wanted = np.broadcast_to(np.eye(3) if rotation_matrix is None else rotation_matrix, (n, 3, 3))
    if mechanism.closed_form_inverse and rotation_matrix is None:
        pose = Pose(position - conditions.tool, wanted, np.zeros((n, len(mechanism.hinges))))
        q = kinematics.initial_actuators(mechanism, nominal, pose)
    else:
        start = kinematics.inverse(mechanism, nominal, position, rotation_matrix, conditions.tool)
        q, pose = start.q, start.pose
    tool = conditions.tool if np.ptp(conditions.tool, axis=0).any() else conditions.tool[0]
    at = kinematics.closure(mechanism, nominal, q, pose, tool)
    residual = np.abs(at.f).max(axis=-1)
    status = kinematics.judged(mechanism, at, residual, pose, wanted, kinematics.CLOSED)
    # ∂f/∂k·δk rod by rod: each depends on a few parameters only, so S_C itself is never built.
    rows, columns = kinematics.local_parameters(mechanism, nominal, q, at, pose)
    df = np.einsum("nmc,mc->nm", rows, model.errors[columns])
    extra = np.zeros((n, 6))
    if model.effects:
        usable = np.asarray(np.isfinite(q).all(axis=1))
        df = np.where(usable[:, None], df, np.nan)
        there = model.with_geometry(nominal).situation(np.nan_to_num(q), pose, conditions)
        total = prediction.contributions(model, there, usable)
        df = df + prediction.closure_change(mechanism, at, pose, total)
        extra = prediction.outer_twist(pose, conditions.tool, total)
    JX = kinematics.jacobian_state(mechanism, at, pose)
    Jq = kinematics.jacobian_actuators(mechanism, at)
    free = mechanism.free_state
    task = [mechanism.plate_dofs.index(d) for d in mechanism.task]
    # With the task held, (J_q, J_X,free)·(δq, δX_free) = −(∂f/∂k·δk − J_X,task·δx_outer): eqs (30)–(32) in one solve.
    A = np.concatenate([Jq, JX[..., free]], axis=-1)
    rhs = -df + np.einsum("nmt,nt->nm", JX[..., task], extra[:, list(mechanism.task)])
    q = q + kinematics.solve(A, rhs)[:, : q.shape[1]]
    status = np.where((status == "ok") & ~np.isfinite(q).all(axis=1), "not_converged", status)
    return Solution(q, pose, status, 1, residual)
