"""Closing the loops: Newton on MuJoCo's own constraint residual.

MuJoCo keeps equality constraints soft, so letting a robot swing to rest leaves micrometres of loop error. Its residual
and constraint Jacobian are exact, though: with the driven joints held, `efc_pos(qpos) = 0` is solved for all others to
rounding. Nothing here knows what robot it is, nor any formula of parallel robots.

Compliant robots have more free joints than constraints; their rest position is found in `bench.equilibrium`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.linalg.lapack import dgesv, dgetrf  # pyright: ignore[reportAttributeAccessIssue]

TOLERANCE = 1e-12
"""[m] loop error of a closed pose."""
LARGEST_STEP = 2.0
"""[m, rad] norm to which Newton steps are shortened, so that far starts creep instead of jumping branch."""


@dataclass(frozen=True)
class Closed:
    """How a Newton run ended; the pose itself stands in the MjData."""

    residual: float
    """[m] Norm of the loop errors; NaN if the iteration overflowed."""
    iterations: int
    orientation: float
    """Sign of det J of the free joints: it changes across singular poses and so marks the assembly mode."""
    ok: bool
    """Whether the loops are closed."""


class Loops:
    """The constraint equations of one model in one MjData, split into driven and free joints.

    Args:
        model: compiled model whose only constraints are equalities.
        driven: names of the joints that are held (hinges and slides).
    """

    def __init__(self, model: mujoco.MjModel, driven: Sequence[str]):
        self.model = model
        self.data = mujoco.MjData(model)
        joints = [model.joint(name).id for name in driven]
        self.driven_qpos = model.jnt_qposadr[joints]
        self.driven_dof = model.jnt_dofadr[joints]
        self.free = np.setdiff1d(np.arange(model.nv), self.driven_dof)
        self._step = np.zeros(model.nv)
        self._geared = np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT)
        self._follower = model.jnt_qposadr[model.eq_obj1id[self._geared]]
        self._leader = model.jnt_qposadr[model.eq_obj2id[self._geared]]

    def drive(self, theta: np.ndarray) -> None:
        """Put the driven joints at theta (n_driven,) [rad or m], and what they drive by a gear where it then starts."""
        qpos = self.data.qpos
        qpos[self.driven_qpos] = theta
        if len(self._geared):
            qpos[self._follower] = self.model.eq_data[self._geared, 1] * qpos[self._leader]

    def evaluate(self) -> tuple[np.ndarray, np.ndarray]:
        """Return residual (nefc,) [m] and Jacobian (nefc, nv) at `data.qpos`, views that change with the next call."""
        model, data = self.model, self.data
        mujoco.mj_fwdKinematics(model, data)
        mujoco.mj_makeConstraint(model, data)
        return data.efc_pos, data.efc_J.reshape(-1, model.nv)

    def move(self, step: np.ndarray) -> None:
        """Add a step of the free joints (n_free,) to `data.qpos`, shortened to LARGEST_STEP in norm."""
        size = step.dot(step)
        self._step[self.free] = step if size <= LARGEST_STEP**2 else step * (LARGEST_STEP / math.sqrt(size))
        self.step(self._step)

    def step(self, step: np.ndarray) -> None:
        """Add a step of all joints (nv,), the driven ones included, to `data.qpos`."""
        mujoco.mj_integratePos(self.model, self.data.qpos, step, 1.0)

    def close(self, tolerance: float = TOLERANCE, max_iterations: int = 30) -> Closed:
        """Newton from `data.qpos` until the loops are open by no more than `tolerance` [m] in norm.

        On return kinematics and constraints of `data` belong to the final pose.
        """
        lu = pivots = None
        iteration, residual = 0, math.inf
        for iteration in range(max_iterations + 1):
            f, J = self.evaluate()
            residual = math.sqrt(f.dot(f))
            if residual <= tolerance:
                if lu is None or pivots is None:
                    lu, pivots, _ = dgetrf(J.take(self.free, axis=1))
                return Closed(residual, iteration, _sign_of_determinant(lu, pivots), True)
            if not math.isfinite(residual) or iteration == max_iterations:
                break
            lu, pivots, step, info = dgesv(J.take(self.free, axis=1), -f)
            if info != 0:
                break
            self.move(step)
        return Closed(residual, iteration, 0.0, False)


def _sign_of_determinant(lu: np.ndarray, pivots: np.ndarray) -> float:
    odd = (np.count_nonzero(pivots != np.arange(len(pivots))) + np.count_nonzero(np.diagonal(lu) < 0)) % 2
    return -1.0 if odd else 1.0
