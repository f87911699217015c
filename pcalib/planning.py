"""Where to measure: reachable poses, and the D-optimal choice among them.

The criterion is Bayesian: log det(I + Σ JᵀJ) with J whitened by the instrument and scaled by manufacturing priors,
so it is defined for any number of poses, and needs no decision about which parameters are identifiable.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_triangular

from pcalib import prediction
from pcalib.errors import InputError
from pcalib.identifiability import priors
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot
from pcalib.workspace import allowed as allowed
from pcalib.workspace import reachable as reachable


def information_blocks(
    robot: Robot, q: np.ndarray, tools: np.ndarray, sigma: np.ndarray, measured: np.ndarray, level: str = "complete"
) -> np.ndarray:
    """Whitened, prior-scaled Jacobian of each candidate, (C, r, nz)."""
    model = Model.nominal(robot)
    chosen = robot.mechanism.levels[level]
    p = prediction.predict(model, q, Conditions.of(len(q), tools))
    at, JX = prediction.closure_of(model, p)
    J = prediction.geometry_columns(model, p, at, JX, chosen.basis)
    seen = np.flatnonzero(measured)
    return J[:, seen] / sigma[seen][:, None] * priors(chosen.units)


def d_optimal(
    blocks: np.ndarray, n: int, exchanges: int = 2, tick: Callable[[float], None] | None = None
) -> np.ndarray:
    """Indices of the n candidates that maximise log det(I + Σ BᵀB): greedy choice, then Fedorov exchanges.

    Args:
        blocks: (C, r, nz) whitened Jacobian of each candidate; a candidate may be chosen once.
        tick: called with the share done, for a progress bar.
    """
    C, r, nz = blocks.shape
    if n > C:
        raise InputError(f"{n} poses wanted of {C} candidates")
    flat = blocks.reshape(C * r, nz)
    eye = np.eye(r)
    M = np.eye(nz)
    chosen: list[int] = []
    total = n * (1 + exchanges)

    def gains(M: np.ndarray) -> np.ndarray:
        L = np.linalg.cholesky(M)
        Y = solve_triangular(L, flat.T, lower=True).T.reshape(C, r, nz)
        return np.linalg.slogdet(eye + Y @ np.swapaxes(Y, -1, -2))[1]

    def best(M: np.ndarray, taken: list[int]) -> int:
        gain = gains(M)
        gain[taken] = -np.inf
        return int(np.argmax(gain))

    for i in range(n):
        pick = best(M, chosen)
        chosen.append(pick)
        M = M + blocks[pick].T @ blocks[pick]
        if tick:
            tick((i + 1) / total)
    for sweep in range(exchanges):
        moved = False
        for slot in range(n):
            old = chosen[slot]
            without = M - blocks[old].T @ blocks[old]
            pick = best(without, chosen[:slot] + chosen[slot + 1 :])
            if pick != old:
                chosen[slot], moved = pick, True
                M = without + blocks[pick].T @ blocks[pick]
            if tick:
                tick((n * (1 + sweep) + slot + 1) / total)
        if not moved:
            break
    return np.array(chosen)


def plan(
    robot: Robot,
    n: int,
    *,
    tools: np.ndarray | None = None,
    sigma_pos: float = 2e-5,
    sigma_rot: float = np.radians(0.005),
    rotations: bool = True,
    level: str = "complete",
    candidates: int = 600,
    seed: int = 0,
    tick: Callable[[float], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """D-optimal commands (n, nq) and tools (n, 3) for a robot.

    Args:
        tools: (T, 3) [m] tools at hand; each candidate pose is offered with each tool.
        sigma_pos, sigma_rot: [m], [rad] noise of the instrument.
        rotations: whether it measures orientation.
    """
    tools = np.zeros((1, 3)) if tools is None else np.atleast_2d(tools)
    found = reachable(robot, max(candidates, 3 * n), np.random.default_rng(seed))
    q = np.repeat(found.q, len(tools), axis=0)
    t = np.tile(tools, (len(found.q), 1))
    sigma = np.r_[np.full(3, sigma_pos), np.full(3, sigma_rot)]
    measured = np.r_[np.ones(3, bool), np.full(3, rotations)]
    order = d_optimal(information_blocks(robot, q, t, sigma, measured, level), n, tick=tick)
    return q[order], t[order]
