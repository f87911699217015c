"""Many poses of one robot at once: the loops of `bench.machine`, closed by MuJoCo's batch interface.

    many = BatchMachine(robot)                  # compiled once
    many.become(k)                              # true geometry, written in place (0.2 ms)
    landing = many.land(q, tool, near=(x, R))   # several times faster than Machine: docs/scale.md

It is for rigid robots whose kind has the variant 'tendons'. MuJoCo evaluates a whole batch of poses per call; its
tendon lengths are the residual of the loops (what `efc_pos` of an equality of a tendon holds) and its tendon
Jacobian their derivative, so that every Newton iteration is one call and one stack of small linear systems.
Poses that do not close, or close on another branch, are given to a `Machine`, which walks there.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch

from bench import kinds
from bench.closing import LARGEST_STEP, TOLERANCE
from bench.commands import Commands, Landing
from bench.geometry import Geometry
from bench.machine import JOINT_SLACK, Machine
from pcalib import rotation
from pcalib.errors import ReachError
from pcalib.robot import Robot

VARIANT = "tendons"
CHUNK = 1000
"""Poses per call of MuJoCo."""
MAX_ITERATIONS = 12
"""Newton steps from a start near the pose: 3 are usual. A pose that needs more than this is given to a `Machine`."""


POSITION = int(mujoco.mjtStage.mjSTAGE_POS)  # type: ignore[attr-defined]
"""The forward stage of MuJoCo that knows tendon lengths and their Jacobian."""
Near = tuple[np.ndarray, np.ndarray]
"""Plate positions (N, 3) [m] and orientations (N, 3, 3)."""


def possible(robot: Robot) -> bool:
    """Return whether this robot has a MuJoCo model whose loops can be closed for many poses at once."""
    return VARIANT in kinds.get(robot.kind).variants


class BatchMachine:
    """A rigid robot whose true geometry changes from one robot of a campaign to the next.

    Args:
        robot: nominal robot, of a kind that has the variant 'tendons'.
        chunk: largest number of poses per call of MuJoCo.
    """

    def __init__(self, robot: Robot, chunk: int = CHUNK):
        self.robot, self.kind = robot, kinds.get(robot.kind)
        maker = self.kind.variants[VARIANT]
        spec = maker.spec(robot)
        for key in spec.keys:
            spec.delete(key)
        self.model = model = spec.compile()
        self._geometry = Geometry(model, robot.mechanism.parameters, maker.places(robot))
        joints = [model.joint(name).id for name in robot.mechanism.actuators]
        self._driven = model.jnt_qposadr[joints]
        plate = model.joint("plate")
        self._x = plate.qposadr[0] + np.arange(3)
        self._turn = plate.qposadr[0] + 3 + np.arange(4)
        # Where the derivatives by the plate's six velocities stand among the stored ones of each tendon.
        rods = [model.tendon(f"rod{r}").id for r in robot.mechanism.rods]
        self._rods = np.array(rods)
        self._columns = np.array([self._stored(t, plate.dofadr[0] + np.arange(6)) for t in rods])
        self._a = np.array([model.site(f"a{r}").id for r in robot.mechanism.rods])
        self._b = np.array([model.site(f"b{r}").id for r in robot.mechanism.rods])
        self._plate, self._tool = model.body("plate").id, model.body("tool").id

        self._batch = batch.Batch(model, chunk, 1)
        self._qpos = self._batch.bind("qpos")
        self._seen = {name: self._batch.bind(name) for name in ("ten_length", "ten_J", "xpos", "xmat", "site_xpos")}
        self._home = self.kind.home(robot)
        self.become(robot.mechanism.nominal)

    def _stored(self, tendon: int, dofs: np.ndarray) -> list[int]:
        model = self.model
        start, count = model.ten_J_rowadr[tendon], model.ten_J_rownnz[tendon]
        columns = list(model.ten_J_colind[start : start + count])
        return [int(start) + columns.index(dof) for dof in dofs]

    def become(self, k: np.ndarray) -> None:
        """Give the robot the true geometry k (nk,) [m, rad] and assemble it in its home pose.

        Raises:
            ReachError: such a robot cannot be assembled in its home pose.
        """
        self.k = np.array(k, float)
        self._geometry.write(self.k)
        self._batch.set_models(self.model)
        self._length = self.model.tendon_length0[self._rods]
        home = self._home
        self._sign = 0.0
        found = self._close(home.q[None], home.x[None], home.R[None])
        self._sign = found[3][0]
        if not self._fits(*found)[0]:
            raise ReachError(
                f"the robot '{self.robot.name}' with this geometry cannot be assembled in its home pose, joints at "
                f"{', '.join(f'{v:.4g}' for v in home.q)}: check the geometric errors and the robot file"
            )

    def land(self, q: np.ndarray, tool: np.ndarray | float = 0.0, near: Near | None = None) -> Landing:
        """Return poses and TCPs for joint commands (N, nq) [rad or m] with a tool (3,) or (N, 3) [m, plate frame]."""
        return self.run(Commands.of(q, tool), near=near)

    def run(self, commands: Commands, miss: np.ndarray | None = None, near: Near | None = None) -> Landing:
        """Carry out commands; a status per row, nothing is raised for a pose that cannot be reached.

        Args:
            miss: (N, nq) [rad or m], repeatability errors of the drives.
            near: where Newton starts, home when absent. It changes how long that takes, and the result by no more
                than rounding.
        """
        q, tools, n = commands.q, commands.tool, len(commands)
        home = self._home
        near_x, near_R = near if near is not None else (np.tile(home.x, (n, 1)), np.tile(home.R, (n, 1, 1)))
        status = np.full(n, "ok", dtype="<U13")
        low, high = self.robot.joint_range
        status[((q < low - JOINT_SLACK) | (q > high + JOINT_SLACK)).any(axis=1)] = "joint_limit"
        status[~np.isfinite(q).all(axis=1)] = "not_converged"
        if miss is not None:
            q = q + miss
        x, tcp = np.full((2, n, 3), np.nan)
        R = np.full((n, 3, 3), np.nan)
        todo = np.flatnonzero(status == "ok")
        for start in range(0, len(todo), self._batch.nsim):
            rows = todo[start : start + self._batch.nsim]
            found = self._close(q[rows], near_x[rows], near_R[rows])
            good = self._fits(*found)
            here = np.flatnonzero(good)
            seen = self._seen
            x[rows[good]] = seen["xpos"][here, self._plate]
            R[rows[good]] = seen["xmat"][here, self._plate].reshape(-1, 3, 3)
            turn = seen["xmat"][here, self._tool].reshape(-1, 3, 3)
            tcp[rows[good]] = seen["xpos"][here, self._tool] + (turn @ tools[rows[good]][..., None])[..., 0]
            status[rows[~good]] = "walk"
        walk = np.flatnonzero(status == "walk")
        if len(walk):
            walked = Machine(self.robot, self.k, variant=VARIANT).run(
                commands.take(walk), None if miss is None else miss[walk]
            )
            x[walk], R[walk], tcp[walk], status[walk] = walked.x, walked.R, walked.tcp, walked.status
        return Landing(x, R, tcp, status)

    def _close(
        self, q: np.ndarray, x: np.ndarray, R: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Newton on n poses; residual (n,) [m], heights of plate and base anchors, sign of det J of each."""
        n = len(q)
        qpos = self._qpos
        qpos[:n, self._driven] = q
        qpos[:n, self._x] = x
        qpos[:n, self._turn] = rotation.to_quaternion(R)
        lengths, stored = self._seen["ten_length"], self._seen["ten_J"]
        open_rows = np.arange(n)
        residual, sign = np.full(n, np.inf), np.zeros(n)
        for iteration in range(MAX_ITERATIONS + 1):
            self._batch.forward(open_rows, POSITION)
            f = lengths[open_rows][:, self._rods] - self._length
            J = stored[open_rows[:, None, None], self._columns]
            residual[open_rows] = size = np.sqrt(np.einsum("ni,ni->n", f, f))
            closed = size <= TOLERANCE
            if closed.any():
                sign[open_rows[closed]] = np.sign(np.linalg.det(J[closed]))
            left = ~closed & np.isfinite(size)
            open_rows, f, J = open_rows[left], f[left], J[left]
            if not len(open_rows) or iteration == MAX_ITERATIONS:
                break
            self._move(open_rows, _solve(J, f))
        sites = self._seen["site_xpos"]
        return residual, sites[:n, self._b, 2], sites[:n, self._a, 2], sign

    def _move(self, rows: np.ndarray, step: np.ndarray) -> None:
        """Add steps (n, 6) of the plate: translation in the base frame, rotation in its own."""
        size = np.sqrt(np.einsum("ni,ni->n", step, step))[:, None]
        step = step * np.where(size > LARGEST_STEP, LARGEST_STEP / np.maximum(size, LARGEST_STEP), 1.0)
        self._qpos[np.ix_(rows, self._x)] += step[:, :3]
        old = self._qpos[np.ix_(rows, self._turn)]
        self._qpos[np.ix_(rows, self._turn)] = _turned(old, step[:, 3:])

    def _fits(self, residual: np.ndarray, b: np.ndarray, a: np.ndarray, sign: np.ndarray) -> np.ndarray:
        """Return which poses are closed and on the working branch, by the guards of `Machine`."""
        n = len(residual)
        good = (residual <= TOLERANCE) & (sign == self._sign)
        if self.kind.rods_down:
            good &= (b < a).all(axis=1)
        trace = self._seen["xmat"][:n, self._plate] @ self._home.R.ravel()
        return good & (0.5 * (trace - 1.0) >= np.cos(self.kind.max_turn(self.robot)))


def _solve(J: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Return steps −J⁻¹f (n, 6); NaN where J is singular."""
    try:
        return np.linalg.solve(J, -f[..., None])[..., 0]
    except np.linalg.LinAlgError:
        step = np.full(f.shape, np.nan)
        fine = np.linalg.cond(J) < 1e14
        step[fine] = np.linalg.solve(J[fine], -f[fine][..., None])[..., 0]
        return step


def _turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return unit quaternions (n, 4) after rotations by vectors (n, 3) [rad] in their own frames."""
    angle = np.sqrt(np.einsum("ni,ni->n", turn, turn))
    w = np.cos(0.5 * angle)
    v = turn * (0.5 * np.sinc(angle / (2 * np.pi)))[:, None]
    w0, v0 = quaternion[:, 0], quaternion[:, 1:]
    out = np.empty_like(quaternion)
    out[:, 0] = w0 * w - rotation.dot(v0, v)
    out[:, 1:] = w0[:, None] * v + w[:, None] * v0 + rotation.cross(v0, v)
    return out / np.sqrt(np.einsum("ni,ni->n", out, out))[:, None]
