"""Batched forward and inverse kinematics of any mechanism: Newton on the closure of :mod:`pcalib.mechanics.loops`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pcalib import rotation
from pcalib.mechanics import native
from pcalib.mechanics.loops import RIGID as RIGID
from pcalib.mechanics.loops import Closure as Closure
from pcalib.mechanics.loops import Deviation as Deviation
from pcalib.mechanics.loops import base_side as base_side
from pcalib.mechanics.loops import close, plate_side
from pcalib.mechanics.loops import closure as closure
from pcalib.mechanics.loops import jacobian_actuators as jacobian_actuators
from pcalib.mechanics.loops import jacobian_parameters as jacobian_parameters
from pcalib.mechanics.loops import jacobian_state as jacobian_state
from pcalib.mechanics.loops import local_parameters as local_parameters
from pcalib.mechanics.loops import rod_rate as rod_rate
from pcalib.mechanics.mechanism import Mechanism, Pose

CHUNK = 2000
"""Poses per batch: the working set of one batch stays in the processor's cache."""
TOLERANCE = 1e-14
"""[m] closure error at which Newton stops: a few times what rounding leaves on a robot of metres."""
CLOSED = 1e-9
"""[m] closure error up to which the loops count as closed."""
TOGETHER = 6
"""Newton steps of the whole batch; afterwards only the poses that have not converged are iterated."""
SINGULAR = 1e12
"""A pose is singular where J⁻¹ has entries beyond this [m or rad of motion per metre of closure error]."""


@dataclass(frozen=True)
class Solution:
    """Poses and actuator values from a solver, with a status per pose."""

    q: np.ndarray
    """(N, nq) actuator values [rad or m]."""
    pose: Pose
    status: np.ndarray
    """(N,) of 'ok', 'not_converged' or 'wrong_branch'."""
    iterations: int
    residual: np.ndarray
    """(N,) [m], largest closure error."""
    at: Closure | None = None
    """The closure at these poses about the plate's origin; None where rows were joined or replaced."""

    @property
    def ok(self) -> np.ndarray:
        """(N,) bool."""
        return self.status == "ok"

    @property
    def unsettled(self) -> np.ndarray:
        """(N,) bool: the loops close, but the iteration between loads and pose does not converge."""
        return (self.status == "not_converged") & (self.residual <= CLOSED)

    def settling(self, moved: np.ndarray, most: float) -> Solution:
        """This solution, 'not_converged' where the last load iteration moved it (N,) by more than `most` [m, rad]."""
        return replace(self, status=np.where(self.ok & (moved > most), "not_converged", self.status))

    def take(self, rows: np.ndarray) -> Solution:
        """The solutions of some rows."""
        return Solution(self.q[rows], self.pose.take(rows), self.status[rows], self.iterations, self.residual[rows])

    def put(self, rows: np.ndarray, later: Solution) -> Solution:
        """This solution with some rows replaced by those of a later one."""

        def merged(mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
            out = mine.copy()
            out[rows] = theirs
            return out

        return Solution(
            merged(self.q, later.q),
            Pose(*(merged(getattr(self.pose, a), getattr(later.pose, a)) for a in ("x", "R", "phi"))),
            merged(self.status, later.status),
            later.iterations,
            merged(self.residual, later.residual),
        )


def sensitivity(
    mechanism: Mechanism,
    k: np.ndarray,
    q: np.ndarray,
    pose: Pose,
    tool: np.ndarray | float = 0.0,
    deviation: Deviation = RIGID,
) -> np.ndarray:
    """S_C = −J_X⁻¹·∂f/∂k at the TCP of `tool`, (N, n_state, nk) (paper eq. 22)."""
    at = closure(mechanism, k, q, pose, tool, deviation)
    return -invert(jacobian_state(mechanism, at, pose)) @ jacobian_parameters(mechanism, k, q, at, pose, deviation)


def move(mechanism: Mechanism, pose: Pose, step: np.ndarray) -> Pose:
    """Poses after state increments (N, n_state): translation of C, left-multiplied rotation, hinge angles."""
    nd = len(mechanism.plate_dofs)
    twist = step[:, :nd]
    if nd < 6:
        full = np.zeros((len(step), 6))
        full[:, list(mechanism.plate_dofs)] = twist
        twist = full
    phi = pose.phi + step[:, nd:] if mechanism.hinges else pose.phi
    return Pose(pose.x + twist[:, :3], rotation.exp(twist[:, 3:]) @ pose.R, phi)


def _limited(step: np.ndarray, largest: float = 0.5) -> np.ndarray:
    """Newton steps of at most `largest` [m, rad], so that a far start does not jump to another branch."""
    size = np.abs(step)
    if size.max(initial=0.0) <= largest:
        return step
    size = size.max(axis=-1, keepdims=True)
    return np.where(size > largest, step * (largest / np.maximum(size, largest)), step)


def _regular(A: np.ndarray) -> np.ndarray:
    """(N,) bool: which matrices are not exactly singular; no warning is raised for NaN, of poses that do not exist."""
    with np.errstate(invalid="ignore"):
        return np.linalg.det(A) != 0


def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A⁻¹·b for A (N, n, n) and b (N, n); NaN at the poses whose A is singular."""
    try:
        return np.linalg.solve(A, b[..., None])[..., 0]
    except np.linalg.LinAlgError:
        regular = _regular(A)
        out = np.full(b.shape, np.nan)
        out[regular] = np.linalg.solve(A[regular], b[regular][..., None])[..., 0]
        return out


def invert(A: np.ndarray) -> np.ndarray:
    """A⁻¹ (N, n, n); NaN at the poses whose A is singular to working precision."""
    try:
        out = np.linalg.inv(A)
    except np.linalg.LinAlgError:
        regular = _regular(A)
        out = np.full(A.shape, np.nan)
        out[regular] = np.linalg.inv(A[regular])
    size = np.abs(out)
    if not size.max(initial=0.0) <= SINGULAR:
        out[size.max(axis=(1, 2)) > SINGULAR] = np.nan
    return out


def _worst(at: Closure) -> float:
    """Largest closure error of all poses [m]; poses that are NaN are ignored."""
    return float(np.fmax.reduce(np.abs(at.f), axis=None, initial=0.0))


def judged(
    mechanism: Mechanism, at: Closure, residual: np.ndarray, pose: Pose, reference: np.ndarray, tolerance: float
) -> np.ndarray:
    """(N,) the status of plate poses whose largest closure error is `residual` (N,) [m], see :class:`Solution`.

    Args:
        reference: (N, 3, 3) from which a plate on the working branch is turned by `max_tilt` at most.
    """
    status = np.full(len(residual), "ok", dtype="<U13")
    turned = _upright(mechanism, pose.R, reference) < np.cos(mechanism.max_tilt)
    if mechanism.rod_side:
        turned |= (at.n[:, mechanism.is_rod, 2] * mechanism.rod_side <= 0).any(axis=-1)
    status[turned] = "wrong_branch"
    status[~(residual <= tolerance)] = "not_converged"
    return status


def in_chunks(rows: np.ndarray, solver: Callable[[np.ndarray], Solution]) -> Solution:
    """Run a solver over at most CHUNK of the rows (N,) at a time and join the answers."""
    parts = [solver(rows[i : i + CHUNK]) for i in range(0, max(len(rows), 1), CHUNK)]
    return parts[0] if len(parts) == 1 else join(parts)


def join(parts: list[Solution]) -> Solution:
    """The solutions of consecutive batches as one."""
    return Solution(
        q=np.concatenate([p.q for p in parts]),
        pose=Pose(*(np.concatenate([getattr(p.pose, a) for p in parts]) for a in ("x", "R", "phi"))),
        status=np.concatenate([p.status for p in parts]),
        iterations=max(p.iterations for p in parts),
        residual=np.concatenate([p.residual for p in parts]),
    )


def forward(
    mechanism: Mechanism,
    k: np.ndarray,
    q: np.ndarray,
    start: Pose | None = None,
    deviation: Deviation = RIGID,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
) -> Solution:
    """FPR_C: plate poses for actuator values q (N, nq), by Newton on the complete closure.

    Args:
        start: where Newton starts; the kind's closed form when absent.
        tolerance: [m] on the largest closure error, reached in 3–4 iterations from the closed form.

    Returns:
        Solution, with a status per pose: nothing is raised for a pose that cannot be reached.
    """
    q = np.atleast_2d(np.asarray(q, float))
    if tolerance == TOLERANCE and max_iterations >= native.ROUNDS:
        found = native.forward(mechanism, k, q, start, deviation)
        if found is not None:

            def remaining(rows: np.ndarray) -> Solution:
                near = None if start is None else start.take(rows)
                return _forward(mechanism, k, q[rows], near, deviation.take(rows))

            return completed(found, remaining)
    return _forward(mechanism, k, q, start, deviation, tolerance, max_iterations)


def completed(found: native.Found, remaining: Callable[[np.ndarray], Solution]) -> Solution:
    """What the extension solved, and what is left to NumPy."""
    status = np.full(len(found.q), "ok", dtype="<U13")
    out = Solution(found.q, found.pose, status, native.ROUNDS, found.residual)
    rows = np.flatnonzero(~found.solved)
    return out.put(rows, remaining(rows)) if len(rows) else out


def _forward(
    mechanism: Mechanism,
    k: np.ndarray,
    q: np.ndarray,
    start: Pose | None = None,
    deviation: Deviation = RIGID,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
) -> Solution:
    """:func:`forward` in NumPy, for commands (N, nq)."""
    origin = np.zeros(3)

    def run(rows: np.ndarray, pose: Pose, reference: np.ndarray, count: int, most: int) -> Solution:
        dev = deviation.take(rows)
        side = base_side(mechanism, k, q[rows], dev)
        plate = plate_side(mechanism, k, pose.phi, dev)
        at = close(side, plate, pose.x, pose.R, origin)
        while count < most and _worst(at) > tolerance:
            pose = move(mechanism, pose, _limited(solve(jacobian_state(mechanism, at, pose), -at.f)))
            if mechanism.hinges:
                plate = plate_side(mechanism, k, pose.phi, dev)
            at = close(side, plate, pose.x, pose.R, origin)
            count += 1
        pose = Pose(pose.x, rotation.renormalise(pose.R), pose.phi)
        residual = np.abs(at.f).max(axis=-1)
        status = judged(mechanism, at, residual, pose, reference, max(tolerance, CLOSED))
        found = Solution(q[rows], pose, status, count, residual, at)
        late = np.flatnonzero(found.residual > tolerance)
        if count >= max_iterations or not len(late):
            return found
        return found.put(late, run(rows[late], pose.take(late), reference[late], count, max_iterations))

    def batch(rows: np.ndarray) -> Solution:
        pose = mechanism.start(k, q[rows]) if start is None else start.take(rows)
        return run(rows, pose, pose.R, 0, min(TOGETHER, max_iterations))

    return in_chunks(np.arange(len(q)), batch)


def _upright(mechanism: Mechanism, R: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Cosine (N,) of the plate's rotation from `reference` about the axes that no command prescribes."""
    commanded = {3, 4, 5} & set(mechanism.task)
    if {3, 4} <= commanded:
        return np.ones(len(R))
    if commanded:
        return rotation.dot(R[..., 2], reference[..., 2])
    return 0.5 * (np.einsum("nij,nij->n", R, reference) - 1)


def inverse(
    mechanism: Mechanism,
    k: np.ndarray,
    position: np.ndarray,
    rotation_matrix: np.ndarray | None = None,
    tool: np.ndarray | float = 0.0,
    start: Solution | None = None,
    deviation: Deviation = RIGID,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
) -> Solution:
    """IPR_C: actuator values that bring the TCP to given positions (N, 3) [m]; the plate's free turn is solved for.

    The unknowns are q and the components of the plate's twist *at the TCP* that the task does not prescribe:
    the TCP never leaves its target, and the system is m × m. A translation outside the task (the planar
    mechanism's y) is solved for too; what `position` says of it is ignored.

    Args:
        rotation_matrix: (N, 3, 3) commanded orientation where the robot has one (hexa, H4, hexapod); identity
            when absent. Components that the task does not prescribe are only a start.
        tool: (3,) or (N, 3) [m], TCP in the plate frame.
        start: an earlier solution to start from; the closed-form inverse at R when absent.
    """
    position = np.atleast_2d(np.asarray(position, float))
    if tolerance == TOLERANCE and max_iterations >= native.ROUNDS:
        t, R = np.asarray(tool, float), rotation_matrix
        found = native.inverse(mechanism, k, position, R, t, start and (start.q, start.pose), deviation)
        if found is not None:

            def remaining(rows: np.ndarray) -> Solution:
                turn, near = None if R is None else R[rows], None if start is None else start.take(rows)
                point = t[rows] if t.ndim == 2 else t
                return _inverse(mechanism, k, position[rows], turn, point, near, deviation.take(rows))

            return completed(found, remaining)
    return _inverse(mechanism, k, position, rotation_matrix, tool, start, deviation, tolerance, max_iterations)


def _inverse(
    mechanism: Mechanism,
    k: np.ndarray,
    position: np.ndarray,
    rotation_matrix: np.ndarray | None = None,
    tool: np.ndarray | float = 0.0,
    start: Solution | None = None,
    deviation: Deviation = RIGID,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
) -> Solution:
    """:func:`inverse` in NumPy, for positions (N, 3)."""
    N = len(position)
    if rotation_matrix is None:
        rotation_matrix = np.broadcast_to(np.eye(3), (N, 3, 3))
    tools = np.broadcast_to(np.asarray(tool, float), (N, 3))
    free = mechanism.free_state
    loose = [d for d in mechanism.plate_dofs if d < 3 and d not in mechanism.task]
    nq = len(mechanism.actuators)
    keep_yaw = 5 in mechanism.task and not {3, 4} & set(mechanism.task) and len(mechanism.plate_dofs) == 6

    def run(rows: np.ndarray, first: Solution | None, count: int, most: int) -> Solution:
        dev = deviation.take(rows)
        target, R0, t = position[rows], rotation_matrix[rows], tools[rows]
        reference = t[:, None, :] if np.ptp(t, axis=0).any() else t[0]
        n = len(target)
        if first is not None:
            q, R, phi = first.q, first.pose.R, first.pose.phi
        else:
            R, phi = R0, _level(mechanism, k, R0)
            q = initial_actuators(mechanism, k, Pose(target - (R @ t[..., None])[..., 0], R, phi))
        p = target
        if loose:  # a translation that the task leaves free carries the TCP with it
            p = target.copy()
            near = first.pose if first is not None else mechanism.start(k, q)
            p[:, loose] = near.tcp(t)[:, loose]
        plate = plate_side(mechanism, k, phi, dev)
        at = close(base_side(mechanism, k, q, dev), plate, p, R, reference)
        while count < most and _worst(at) > tolerance:
            now = Pose(p, R, phi)
            J = np.concatenate(
                [jacobian_actuators(mechanism, at), jacobian_state(mechanism, at, now)[..., free]], axis=-1
            )
            step = _limited(solve(J, -at.f))
            q = q + step[:, :nq]
            state = np.zeros((n, mechanism.n_state))
            state[:, free] = step[:, nq:]
            moved_pose = move(mechanism, now, state)
            p, R, phi = moved_pose.x, moved_pose.R, moved_pose.phi
            if keep_yaw:
                R = _with_yaw_of(R, R0)
            if mechanism.hinges:
                plate = plate_side(mechanism, k, phi, dev)
            at = close(base_side(mechanism, k, q, dev), plate, p, R, reference)
            count += 1
        R = rotation.renormalise(R)
        pose = Pose(p - (R @ t[..., None])[..., 0], R, phi)
        residual = np.abs(at.f).max(axis=-1)
        status = judged(mechanism, at, residual, pose, R0, max(tolerance, CLOSED))
        found = Solution(q, pose, status, count, residual)
        late = np.flatnonzero(found.residual > tolerance)
        if count >= max_iterations or not len(late):
            return found
        return found.put(late, run(rows[late], found.take(late), count, max_iterations))

    def batch(rows: np.ndarray) -> Solution:
        return run(rows, None if start is None else start.take(rows), 0, min(TOGETHER, max_iterations))

    return in_chunks(np.arange(N), batch)


def _level(mechanism: Mechanism, k: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Hinge angles (N, h) that bring hinged bodies nearest to their turn at R = I, as parallel rods hold them."""
    if not mechanism.hinges:
        return np.zeros((len(R), 0))
    turn = rotation.to_quaternion(R)
    return np.stack(
        [-2 * np.arctan2(turn[:, 1:] @ hinge.at(k).axis, turn[:, 0]) for hinge in mechanism.hinges], axis=-1
    )


def initial_actuators(mechanism: Mechanism, k: np.ndarray, pose: Pose) -> np.ndarray:
    """IPR_S: closed-form actuator values for given plate poses, the mean over each actuator's rods, (N, nq)."""
    b, _ = plate_side(mechanism, k, pose.phi, RIGID)
    B = pose.x[:, None] + np.matmul(b, np.swapaxes(pose.R, -1, -2))
    each = mechanism.actuation.reach(k, B)
    if mechanism.actuator_dimension == "angle":
        each = np.mod(each + np.pi, 2 * np.pi) - np.pi
    nq = len(mechanism.actuators)
    spread = np.zeros((each.shape[1], nq))
    spread[np.arange(each.shape[1]), mechanism.actuator] = 1.0
    known = ~np.isnan(each).all(axis=0)  # guided rows have no reach of their own
    spread[~known] = 0.0
    count = spread.sum(axis=0)
    count[count == 0.0] = np.nan  # no rod of this actuator reaches its pose anywhere
    return np.where(known, each, 0.0) @ (spread / count)


def _with_yaw_of(R: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """R turned about z so that its twist about the base's z axis is that of `wanted` (swing–twist split)."""
    w, z = (rotation.to_quaternion(R)[..., c] for c in (0, 3))
    w0, z0 = (rotation.to_quaternion(wanted)[..., c] for c in (0, 3))
    turn = 2 * (np.arctan2(z0, w0) - np.arctan2(z, w))
    return R @ rotation.about(np.array([0.0, 0.0, 1.0]), turn)


def task_jacobian(mechanism: Mechanism, at: Closure, pose: Pose) -> np.ndarray:
    """∂(task)/∂q at the reference point of `at`, (N, len(task), nq); its inverse is the paper's J_S^m (eq. 32)."""
    J = -invert(jacobian_state(mechanism, at, pose)) @ jacobian_actuators(mechanism, at)
    rows = [mechanism.plate_dofs.index(d) for d in mechanism.task]
    return J[:, rows]
