"""Commands that bring the plate to wanted poses, by MuJoCo: what a plan needs of the nominal robot.

The loops and the wanted components of the plate's pose are solved together for all joints, the motors included.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgesv  # pyright: ignore[reportAttributeAccessIssue]

from bench.closing import LARGEST_STEP, TOLERANCE
from bench.machine import Machine
from pcalib import rotation


def reach(machine: Machine, x: np.ndarray, R: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return commands for plate positions x (N, 3) [m] and, where the robot commands it, orientations R (N, 3, 3).

    Returns:
        q (N, nq) [rad or m] and which of them hold: reached on the working branch and within the joint range.
    """
    x = np.atleast_2d(np.asarray(x, float))
    R = np.broadcast_to(np.eye(3), (len(x), 3, 3)) if R is None else R
    solver = _Solver(machine)
    q = np.full((len(x), machine.rig.actuators), np.nan)
    for n in range(len(x)):
        found = solver.solve(x[n], R[n])
        if found is not None:
            q[n] = found
    low, high = machine.robot.joint_range
    with np.errstate(invalid="ignore"):
        return q, np.all((q >= low) & (q <= high), axis=1)


class _Solver:
    def __init__(self, machine: Machine):
        if machine.faults:
            raise ValueError("plans are made with a rigid robot")
        self.machine, self.loops, model = machine, machine.loops, machine.model
        self.task = machine.robot.mechanism.task
        self.plate = model.body("plate").id
        self.dof = model.joint("plate").dofadr[0]
        machine.go_home()
        data = self.loops.data
        self.home = data.xpos[self.plate].copy(), data.xmat[self.plate].reshape(3, 3).copy()

    def solve(self, x: np.ndarray, R: np.ndarray) -> np.ndarray | None:
        """Return q (nq,) from home, at one go or in steps; None where that fails."""
        for steps in (1, 6):
            self.machine.go_home()
            turn = rotation.log(R @ self.home[1].T)
            for s in np.arange(1, steps + 1) / steps:
                on_way = self.home[0] + s * (x - self.home[0]), rotation.exp(s * turn) @ self.home[1]
                if not self._newton(*on_way) or not self.machine.fits(self.loops.close()):
                    break
            else:
                return self.loops.data.qpos[self.loops.driven_qpos].copy()
        return None

    def _newton(self, x: np.ndarray, R: np.ndarray, max_iterations: int = 15) -> bool:
        loops, data, dof = self.loops, self.loops.data, self.dof
        nv = loops.model.nv
        wanted = np.zeros((len(self.task), nv))
        for _ in range(max_iterations):
            f, J = loops.evaluate()
            now = data.xmat[self.plate].reshape(3, 3)
            error = np.concatenate([data.xpos[self.plate] - x, -rotation.log(R @ now.T)])[list(self.task)]
            if np.sqrt(f @ f + error @ error) <= TOLERANCE:
                return True
            for row, component in enumerate(self.task):
                if component < 3:
                    wanted[row, dof + component] = 1.0
                else:  # MuJoCo turns a free body about its own axes
                    wanted[row, dof + 3 : dof + 6] = now[component - 3]
            matrix = np.vstack([J, wanted])
            if matrix.shape != (nv, nv):
                raise ValueError("as many commanded components as actuators are needed")
            _, _, step, info = dgesv(matrix, -np.concatenate([f, error]))
            if info != 0 or not np.isfinite(step).all():
                return False
            size = np.sqrt(step @ step)
            loops.step(step if size <= LARGEST_STEP else step * (LARGEST_STEP / size))
        return False
