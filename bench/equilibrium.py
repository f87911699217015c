"""Static equilibrium of robots with springs: Newton on MuJoCo's own forces and constraints.

At rest every free joint balances and every loop is closed,

    F(q) + J(q)ᵀ·λ = 0,    c(q) = 0,    F = passive forces (springs) − weight + applied forces,

with F, c and J from MuJoCo and λ the forces of the constraints. One step solves

    [K  −Jᵀ] [dq]   [F + Jᵀλ]
    [J    0] [dλ] = [−c     ]

The matrix need not be exact. The springs of the joints stand for K, which leaves out what pre-stressed geometry adds:
load/(length × stiffness) of it, 1e-5 for stiff machine parts. J is that of the pose where the search began, a few
micrometres off. So the matrix is factored once, and each step gains three digits or more. Where steps gain too little
it is made anew for each, and where that does not help K is taken by central differences of F + Jᵀλ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs  # pyright: ignore[reportAttributeAccessIssue]

from bench.closing import Loops

TOLERANCE = 1e-12
"""Norm of the loop errors [m] and of the last step [m, rad] below which the search ends."""
SLOW = 0.1
"""A step longer than this share of the one before calls for a better matrix."""


@dataclass(frozen=True)
class Rest:
    """How the search for equilibrium ended; the pose itself stands in the MjData."""

    ok: bool
    residual: float
    """Norm of loop errors and last step [m, rad]."""
    iterations: int


class Equilibrium:
    """Rest positions of one model, in the MjData of its loops.

    Args:
        loops: the rigid robot, all springs held.
        springs: names of those held joints that are springs, and free here.
    """

    def __init__(self, loops: Loops, springs: Sequence[str] = ()):
        self.loops, model = loops, loops.model
        joints = np.array([model.joint(name).id for name in springs], int)
        self._spring_qpos, spring_dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.springs, self._joints = tuple(springs), joints
        self.free = np.sort(np.concatenate([loops.free, spring_dofs]))
        self._diagonal = np.searchsorted(self.free, spring_dofs)
        self._step = np.zeros(model.nv)
        self._bias = np.zeros(model.nv)
        self._multipliers = np.zeros(0)
        self._factors: tuple[np.ndarray, np.ndarray, float] | None = None
        """See :meth:`_factored`."""
        self.reaction = np.zeros(model.nv)
        """(nv,) [N, N·m] F + Jᵀλ: zero on free joints; on a held one the load that it has to carry, positive where
        the load pushes the joint towards positive values."""

    def forces(self) -> np.ndarray:
        """Return F (nv,) at `data.qpos` at rest; kinematics must be up to date."""
        model, data = self.loops.model, self.loops.data
        mujoco.mj_passive(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        return data.qfrc_passive + data.qfrc_applied - self._bias

    def settle(self, again: bool = False, tolerance: float = TOLERANCE, max_iterations: int = 40) -> Rest:
        """Newton from `data.qpos`, which should be closed, until loops and forces balance.

        Args:
            again: whether the pose is nearly that of the call before, so that the search may begin with its matrix and
                its constraint forces.
        """
        loops, free, n = self.loops, self.free, len(self.free)
        if not again:
            self._factors, self._multipliers = None, np.zeros(0)
        effort, K = 0, None  # 0: one matrix for all steps; 1: one for each step; 2: with the exact tangent
        last, residual = math.inf, math.inf
        iteration = 0
        for iteration in range(max_iterations):
            c, J = loops.evaluate()
            F = self.forces()
            if not len(self._multipliers):
                self._multipliers = np.zeros(len(c))
            if self._factors is None or effort:
                self._factors = self._factored(self._springs() if K is None else K, J)
            if self._factors is None:
                return Rest(False, math.inf, iteration)
            lu, pivots, scale = self._factors
            push = F + J.T @ self._multipliers
            solution, _ = dgetrs(lu, pivots, np.concatenate([push[free] / scale, -c]))
            if not np.isfinite(solution).all():
                return Rest(False, math.inf, iteration)
            step = solution[:n]
            self._multipliers = self._multipliers + solution[n:] * scale
            self.reaction = F + J.T @ self._multipliers
            size = math.sqrt(step.dot(step))
            residual = math.sqrt(c.dot(c)) + size
            if residual <= tolerance:
                return Rest(True, residual, iteration)
            if size > SLOW * last and size > 1e3 * tolerance:
                effort, last = min(effort + 1, 2), math.inf
                if effort == 2:
                    K = self._tangent()
                continue
            last = size
            limit = 0.1  # [m, rad] no part of a machine gives way by more in one step
            self._step[free] = step if size <= limit else step * (limit / size)
            mujoco.mj_integratePos(loops.model, loops.data.qpos, self._step, 1.0)
        return Rest(False, residual, iteration)

    def _factored(self, K: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Return LU, pivots and scale of the matrix of one step; None where it is singular."""
        n, m = len(self.free), len(J)
        matrix = np.zeros((n + m, n + m), order="F")
        scale = max(1.0, np.abs(K).max())  # keeps springs of 1e8 N/m and unit Jacobians in one system
        Jf = J[:, self.free]
        matrix[:n, :n], matrix[:n, n:], matrix[n:, :n] = K / scale, -Jf.T, Jf
        lu, pivots, info = dgetrf(matrix, overwrite_a=True)
        return (lu, pivots, scale) if info == 0 else None

    def _springs(self) -> np.ndarray:
        """Return K from the springs of the joints alone, (n_free, n_free)."""
        model, data = self.loops.model, self.loops.data
        K = np.zeros((len(self.free), len(self.free)))
        x = data.qpos[self._spring_qpos] - model.qpos_spring[self._spring_qpos]
        poly = model.jnt_stiffnesspoly[self._joints]
        k = model.jnt_stiffness[self._joints] + 2 * poly[:, 0] * x + 3 * poly[:, 1] * x**2
        K[self._diagonal, self._diagonal] = k
        return K

    def _tangent(self) -> np.ndarray:
        """Return K = −∂(F + Jᵀλ)/∂q at fixed λ by central differences, (n_free, n_free)."""
        step = 1e-6  # [m, rad]
        loops = self.loops
        here, multipliers = loops.data.qpos.copy(), self._multipliers
        K = np.zeros((len(self.free), len(self.free)))
        move = np.zeros(loops.model.nv)
        for column, dof in enumerate(self.free):
            total = np.zeros(len(self.free))
            for sign in (1.0, -1.0):
                loops.data.qpos[:] = here
                move[dof] = sign * step
                mujoco.mj_integratePos(loops.model, loops.data.qpos, move, 1.0)
                move[dof] = 0.0
                _, J = loops.evaluate()
                total += sign * (self.forces() + J.T @ multipliers)[self.free]
            K[:, column] = -total / (2 * step)
        loops.data.qpos[:] = here
        return K
