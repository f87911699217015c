"""Where to measure: reachable poses, and the D-optimal choice among them.

The criterion is Bayesian: log det(I + Σ JᵀJ) with J whitened by the instrument and scaled by manufacturing priors,
so it is defined for any number of poses, and needs no decision about which parameters are identifiable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pcalib import prediction, units
from pcalib.errors import InputError
from pcalib.fitting.identifiability import priors
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot
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
    C = len(blocks)
    if n > C:
        raise InputError(f"{n} poses wanted of {C} candidates")
    design = _Design(blocks)
    chosen: list[int] = []
    total = n * (1 + exchanges)
    for i in range(n):
        chosen.append(design.best(chosen))
        design.change(chosen[-1], 1)
        if tick:
            tick((i + 1) / total)
    for sweep in range(exchanges):
        moved = False
        design.refresh(chosen)
        for slot, old in enumerate(chosen):
            design.change(old, -1)
            chosen[slot] = design.best(chosen[:slot] + chosen[slot + 1 :])
            design.change(chosen[slot], 1)
            moved |= chosen[slot] != old
            if tick:
                tick((n * (1 + sweep) + slot + 1) / total)
        if not moved:
            break
    return np.array(chosen)


class _Design:
    """M = I + Σ BᵀB of the chosen poses, kept as what each candidate B would add to it: B·M⁻¹·Bᵀ."""

    def __init__(self, blocks: np.ndarray):
        self.blocks = blocks
        self.flat = blocks.reshape(-1, blocks.shape[-1])
        self.eye = np.eye(blocks.shape[1])
        self.refresh([])

    def refresh(self, chosen: list[int]) -> None:
        """Compute both from the definition, because updates accumulate rounding errors."""
        some = self.blocks[chosen].reshape(-1, self.blocks.shape[-1])
        self.inverse = np.linalg.inv(np.eye(self.blocks.shape[-1]) + some.T @ some)
        self.gram = self.blocks @ self.inverse @ np.swapaxes(self.blocks, -1, -2)

    def best(self, taken: list[int]) -> int:
        """The candidate that adds most to log det M."""
        gain = np.linalg.slogdet(self.eye + self.gram)[1]
        gain[taken] = -np.inf
        return int(np.argmax(gain))

    def change(self, pick: int, sign: int) -> None:
        """Add (1) or remove (−1) a candidate, by the Woodbury identity."""
        K = self.inverse @ self.blocks[pick].T
        S = np.linalg.inv(sign * self.eye + self.blocks[pick] @ K)
        W = (self.flat @ K).reshape(self.gram.shape)
        self.gram -= W @ S @ np.swapaxes(W, -1, -2)
        self.inverse -= K @ S @ K.T


def plan(
    robot: Robot,
    n: int,
    *,
    tools: np.ndarray | None = None,
    sigma_pos: float = 2e-5,
    sigma_rot: float = np.radians(0.005),
    measured: Sequence[bool] = (True,) * 6,
    level: str = "complete",
    candidates: int = 1500,
    seed: int = 0,
    tick: Callable[[float], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """D-optimal commands (n, nq) and tools (n, 3) for a robot.

    Args:
        tools: (T, 3) [m] tools at hand; each candidate pose is offered with each tool.
        sigma_pos, sigma_rot: [m], [rad] noise of the instrument.
        measured: which of x, y, z, rx, ry, rz the instrument measures.
    """
    tools = np.zeros((1, 3)) if tools is None else np.atleast_2d(tools)
    found = reachable(robot, max(candidates, 3 * n), np.random.default_rng(seed))
    q = np.repeat(found.q, len(tools), axis=0)
    t = np.tile(tools, (len(found.q), 1))
    sigma = np.r_[np.full(3, sigma_pos), np.full(3, sigma_rot)]
    order = d_optimal(information_blocks(robot, q, t, sigma, np.array(measured), level), n, tick=tick)
    return q[order], t[order]


def table(robot: Robot, q: np.ndarray, conditions: Conditions, position: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of a plan as a file names them.

    Args:
        q: (n, nq) [rad or m] commands.
        position: (n, 3) [m] where the model expects the measured point, measuring frame.
    """
    suffix, factor = robot.command_unit, units.UNITS[robot.command_unit].factor
    columns = {f"{name}_{suffix}": q[:, i] / factor for i, name in enumerate(robot.mechanism.actuators)}
    if conditions.tool.any():
        columns |= {f"tool_{axis}_mm": conditions.tool[:, i] * 1e3 for i, axis in enumerate("xyz")}
    columns["payload_kg"] = np.array(conditions.payload)
    named = {"time": "time_s"} | {f"temp{part}": f"temp{part}_degC" for part in ("", "_arms", "_rods", "_base")}
    columns |= {named.get(name, name): np.asarray(values) for name, values in conditions.columns.items()}
    return columns | {f"expected_{axis}_mm": position[:, i] * 1e3 for i, axis in enumerate("xyz")}
