"""What a model says a measurement should read, and how that reading depends on every unknown.

The reading of one pose is the TCP position and the plate's rotation in the measuring frame. Effects depend on the
pose (loads) and move it, so the pose is a fixed point; the loads' own change is of second order and converges fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib import rotation
from pcalib.effects.base import Contribution, Situation
from pcalib.mechanics import kinematics, native
from pcalib.mechanics.kinematics import Closure, Deviation
from pcalib.mechanics.mechanism import Mechanism, Pose
from pcalib.model import Conditions as Conditions
from pcalib.model import Frame, Model


@dataclass(frozen=True)
class View:
    """Rows that sensors read: how what they read follows from the pose of the measured point."""

    rows: np.ndarray
    """(n,) int, ascending."""
    value: np.ndarray
    """(n, 6) [m, rad] predicted readings in their places; 0 where there is none."""
    by_twist: np.ndarray
    """(n, 6, 6) derivatives by a motion (v, ω) of the plate about the measured point, base frame."""
    own: np.ndarray
    """(n, 6, p) derivatives by the unknowns of the set-up."""
    origin: np.ndarray | None = None
    """(n,) int, row of the pose from which is measured, −1 where there is none; None: there is none in any row."""
    by_origin: np.ndarray | None = None
    """(n, 6, 6) derivatives by a motion of the plate there."""

    def read(self, twist: np.ndarray) -> np.ndarray:
        """(n, 6, m) changes of the readings by motions (N, 6, m) of the plates about their measured points."""
        out = self.by_twist @ twist[self.rows]
        if self.origin is not None and self.by_origin is not None:
            some = np.flatnonzero(self.origin >= 0)
            out[some] += self.by_origin[some] @ twist[self.origin[some]]
        return out


@dataclass(frozen=True)
class Prediction:
    """Predicted readings of N poses and the state behind them."""

    position: np.ndarray
    """(N, 3) [m], measuring frame."""
    rotation: np.ndarray
    """(N, 3, 3), measuring frame."""
    q: np.ndarray
    """(N, nq) commanded."""
    pose: Pose
    """Plate pose in the base frame, before base-channel effects."""
    tool: np.ndarray
    """(N, 3) [m] measured point in the plate frame, target offset and tool effects included."""
    contribution: Contribution
    status: np.ndarray
    """(N,) 'ok' or the reason; 'not_converged' also where the load iteration does not converge."""
    situation: Situation | None = None
    """None where the model has no effects."""
    at: Closure | None = None
    """The closure about the plate's origin, where kinematics left it."""
    unsettled: np.ndarray | None = None
    """(N,) bool: the loops close, but the load iteration does not converge; None if it converges everywhere."""
    view: View | None = None
    """What sensors read; None where all rows read poses. `position` and `rotation` are those of all rows."""

    @property
    def reached(self) -> np.ndarray:
        """(N,) bool: poses at which the loops close."""
        ok = self.status == "ok"
        return ok if self.unsettled is None else ok | self.unsettled

    @property
    def deviation(self) -> Deviation:
        """What effects add inside the loops."""
        return self.contribution.deviation


FIXED_POINT = 1e-11
"""Tolerance of the load iteration [m, rad]: the largest change of a pose coordinate in its last round."""
ROUNDS = 20
"""Largest number of load iterations. Compliances converge in three to six; what has not converged after twenty
alternates between two poses, as a joint clearance does whose rod force changes sign with the pose."""


def contributions(model: Model, at: Situation, solved: np.ndarray | None = None) -> Contribution:
    """The sum of all effects of a model.

    Args:
        solved: (N,) bool, rows that have a pose; effects are not asked about the others, to which nothing is added.
    """
    if solved is not None and not solved.all():
        return contributions(model, at.take(solved)).spread(solved) if solved.any() else Contribution()
    total = Contribution()
    for fitted in model.effects:
        total = total + fitted.effect.contribution(at, fitted.theta)
    return total


def settle(
    model: Model, q: np.ndarray, conditions: Conditions, start: Pose | None = None, rounds: int = ROUNDS
) -> tuple[kinematics.Solution, Contribution, Situation | None]:
    """Plate poses with all effects, by a fixed-point iteration between kinematics and effects.

    The status is 'not_converged' where that iteration does not converge.
    """
    mechanism = model.robot.mechanism
    solution = kinematics.forward(mechanism, model.k, q, start)
    if not model.effects:
        return solution, Contribution(), None
    total, at, moved = Contribution(), None, np.zeros(len(q))
    for _ in range(rounds):
        before = solution
        at = model.situation(q, before.pose, conditions, total.deviation)
        total = contributions(model, at, before.ok)
        solution = kinematics.forward(mechanism, model.k, q, before.pose, total.deviation)
        moved = _change(before.pose, solution.pose)
        if not (moved > FIXED_POINT).any():
            return solution, total, at
    return solution.settling(moved, FIXED_POINT), total, at


def _change(a: Pose, b: Pose) -> np.ndarray:
    """(N,) [m, rad] the largest change of any coordinate."""
    parts = (np.abs(getattr(a, name) - getattr(b, name)).reshape(len(a), -1) for name in ("x", "R", "phi"))
    return np.concatenate(list(parts), axis=1).max(axis=1)


def predict(model: Model, q: np.ndarray, conditions: Conditions, start: Pose | None = None) -> Prediction:
    """Readings that the model predicts for commands q (N, nq)."""
    solution, total, at = settle(model, q, conditions, start)
    frame = model.frame or Frame()
    tool = conditions.point(frame)
    if total.tool is not None:
        tool = tool + total.tool
    x, R = _in_base(solution.pose, tool, total)
    if model.frame is not None:
        x = x @ frame.rotation.T + frame.translation
        R = frame.rotation @ R if frame.turn is None else frame.rotation @ R @ frame.turn
    if total.sensor is not None:
        x = x + total.sensor
    unsettled = solution.unsettled if model.effects and not solution.ok.all() else None
    return Prediction(x, R, q, solution.pose, tool, total, solution.status, at, solution.at, unsettled)


def _in_base(pose: Pose, tool: np.ndarray, total: Contribution) -> tuple[np.ndarray, np.ndarray]:
    x, R = pose.tcp(tool), pose.R
    if total.base is None:
        return x, R
    turn = rotation.exp(total.base[:, 3:])
    return (turn @ x[..., None])[..., 0] + total.base[:, :3], turn @ R


def in_base(p: Prediction) -> tuple[np.ndarray, np.ndarray]:
    """The measured points (N, 3) [m] and plates (N, 3, 3) of a prediction in the base frame."""
    return _in_base(p.pose, p.tool, p.contribution)


def closure_of(model: Model, p: Prediction) -> tuple[Closure, np.ndarray]:
    """The closure at a prediction, about the measured point, and J_X (N, m, n_state) there."""
    mechanism = model.robot.mechanism
    if p.at is None:
        at = kinematics.closure(mechanism, model.k, p.q, p.pose, p.tool, p.deviation)
    else:
        at = p.at.about((p.pose.R @ p.tool[..., None])[..., 0]) if p.tool.any() else p.at
    return at, kinematics.jacobian_state(mechanism, at, p.pose)


def geometry_motion(
    model: Model, p: Prediction, at: Closure, JX: np.ndarray, basis: np.ndarray | None = None
) -> np.ndarray:
    """Derivative of the plate's state about the measured point by level coordinates, (N, n_state, nz): S_C·basis
    (paper eq. 22).

    Without a basis the columns are those of all raw parameters.
    """
    mechanism = model.robot.mechanism
    Jk = kinematics.jacobian_parameters(mechanism, model.k, p.q, at, p.pose, p.deviation)
    if basis is not None:
        Jk = Jk @ basis
    return -kinematics.invert(JX) @ Jk


def response(model: Model, p: Prediction, basis: np.ndarray | None = None) -> np.ndarray:
    """:func:`geometry_motion` for callers that do not need the closure: computed in C where possible."""
    mechanism = model.robot.mechanism
    found = native.motion(mechanism, model.k, p.q, p.pose, p.tool) if p.deviation.none else None
    if found is None:
        return geometry_motion(model, p, *closure_of(model, p), basis)
    return found if basis is None else found @ basis


def readings(model: Model, p: Prediction, motion: np.ndarray) -> np.ndarray:
    """Motions of the plate's state about the measured point (N, n_state, n) as changes of the readings (N, 6, n)."""
    return _measured(model, p, _twist(model.robot.mechanism, motion))


def geometry_columns(
    model: Model, p: Prediction, at: Closure, JX: np.ndarray, basis: np.ndarray | None = None
) -> np.ndarray:
    """Derivative of the readings by level coordinates, (N, 6, nz); see :func:`geometry_motion`."""
    return readings(model, p, geometry_motion(model, p, at, JX, basis))


def ahead(model: Model, p: Prediction, motion: np.ndarray) -> Pose:
    """The plate poses after a motion of its state about the measured point, (N, n_state)."""
    there = kinematics.move(model.robot.mechanism, Pose(p.pose.tcp(p.tool), p.pose.R, p.pose.phi), motion)
    return Pose(there.tcp(-p.tool), there.R, there.phi)


def closure_change(mechanism: Mechanism, at: Closure, pose: Pose, part: Contribution) -> np.ndarray:
    """δf that the in-loop channels of a contribution cause, (N, m) [m]."""
    df = np.zeros(at.f.shape)
    if part.actuator is not None:
        df += kinematics.rod_rate(at) * part.actuator[:, mechanism.actuator]
    if part.rod is not None:
        df -= part.rod
    if part.elbow is not None:
        df -= rotation.dot(at.n, part.elbow)
    if part.plate is not None:
        df += rotation.dot(np.matmul(at.n, pose.R), part.plate)
    return df


def outer_twist(pose: Pose, tool: np.ndarray, part: Contribution, base: np.ndarray | None = None) -> np.ndarray:
    """Twist of the measured point that a small contribution outside the loops causes (tool, base), (N, 6).

    Args:
        base: (N, 6) the base channel to which `part` adds; the twist is that of the robot's own base frame.
    """
    twist = np.zeros((len(pose), 6))
    if part.tool is not None:
        twist[:, :3] += (pose.R @ part.tool[..., None])[..., 0]
    if part.base is not None:
        v, turn = part.base[:, :3], part.base[:, 3:]
        if base is not None:  # d(exp(ω)·x + v), seen from the turned base
            v = (rotation.exp(-base[:, 3:]) @ v[..., None])[..., 0]
            turn = (rotation.left_jacobian(-base[:, 3:]) @ turn[..., None])[..., 0]
        twist[:, :3] += v + rotation.cross(turn, pose.tcp(tool))
        twist[:, 3:] += turn
    return twist


def effect_columns(
    model: Model, p: Prediction, at: Closure, JX: np.ndarray, parts: Sequence[Contribution]
) -> np.ndarray:
    """Derivative of the readings by effect parameters, (N, 6, len(parts)), from their unit contributions.

    Loads are held constant; their change with the pose is of second order.
    """
    if not parts:
        return np.zeros((len(p.q), 6, 0))
    mechanism = model.robot.mechanism
    df = np.stack([closure_change(mechanism, at, p.pose, part) for part in parts], axis=-1)
    twist = _twist(mechanism, -kinematics.invert(JX) @ df)
    twist = twist + np.stack([outer_twist(p.pose, p.tool, part, p.contribution.base) for part in parts], axis=-1)
    columns = _measured(model, p, twist)
    posed = slice(None) if p.view is None else np.delete(np.arange(len(p.q)), p.view.rows)
    for j, part in enumerate(parts):
        if part.sensor is not None:  # the tracker's own errors
            columns[posed, :3, j] += part.sensor[posed]
    return columns


def frame_columns(model: Model, p: Prediction, offset: bool = True) -> np.ndarray:
    """Derivative of the readings by the frame: translation, rotation about it, the target's offset and, where that is
    unknown, its turn, (N, 6, 6, 9 or 12)."""
    assert model.frame is not None
    N, turn = len(p.q), model.frame.turn
    J = np.zeros((N, 6, model.frame.unknowns(offset)))
    J[:, :3, :3] = np.eye(3)
    J[:, :3, 3:6] = -rotation.hat(p.position - model.frame.translation)
    J[:, 3:, 3:6] = np.eye(3)
    if offset:
        plate = p.rotation if turn is None else p.rotation @ turn.T
        J[:, :3, 6:9] = plate
        if turn is not None:
            J[:, 3:, 9:] = plate
    if p.view is not None:
        J[p.view.rows] = 0.0
    return J


def setup_columns(p: Prediction, n: int) -> np.ndarray:
    """Derivative of the readings by the n unknowns of the sensors' set-up, (N, 6, n)."""
    J = np.zeros((len(p.q), 6, n))
    if p.view is not None:
        J[p.view.rows] = p.view.own
    return J


def rigid(model: Model, p: Prediction) -> np.ndarray:
    """Derivative of the readings by a motion of the measured body along and about the measuring frame's axes,
    (N, 6, 6); of what sensors read, the base frame's."""
    J = np.tile(np.eye(6), (len(p.q), 1, 1))
    if p.view is not None:
        middle = p.position.mean(axis=0)  # about one point: measured points of one row move alike
        J[p.view.rows] = p.view.by_twist if p.view.origin is None else p.view.read(_about(p.position - middle))
    return J


def unit_contributions(model: Model, at: Situation) -> list[Contribution]:
    """∂(sum of all contributions)/∂θ_j, one Contribution per parameter of the model's effects, one after another."""
    out = []
    for fitted in model.effects:
        parts = fitted.effect.basis(at, fitted.theta)
        for other in model.effects:
            if other.effect.indirect and other is not fitted:
                more = other.effect.through(at, other.theta, fitted.effect, fitted.theta)
                parts = [a + b for a, b in zip(parts, more, strict=True)]
        out += parts
    return out


def _twist(mechanism: Mechanism, state: np.ndarray) -> np.ndarray:
    """State increments (N, n_state, …) as twists of the central body (N, 6, …)."""
    nd = len(mechanism.plate_dofs)
    if nd == 6 and state.shape[1] == 6:
        return state
    twist = np.zeros((state.shape[0], 6, *state.shape[2:]))
    twist[:, list(mechanism.plate_dofs)] = state[:, :nd]
    return twist


def _about(away: np.ndarray) -> np.ndarray:
    """(N, 6, 6) motions of points at `away` (N, 3) from a rigid motion about the origin."""
    out = np.tile(np.eye(6), (len(away), 1, 1))
    out[:, :3, 3:] = -rotation.hat(away)
    return out


def _measured(model: Model, p: Prediction, twist: np.ndarray) -> np.ndarray:
    """Twists at the measured point (N, 6, n), the robot's base frame → what is read."""
    if p.contribution.base is not None:
        twist = _turned(rotation.exp(p.contribution.base[:, 3:]), twist)
    out = twist if model.frame is None else _turned(model.frame.rotation, twist)
    if p.view is not None:
        out = out.copy() if out is twist else out
        out[p.view.rows] = p.view.read(twist)
    return out


def _turned(R: np.ndarray, twist: np.ndarray) -> np.ndarray:
    return np.concatenate([R @ twist[:, :3], R @ twist[:, 3:]], axis=1)
