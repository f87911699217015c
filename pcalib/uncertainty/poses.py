"""How many poses reach an accuracy with an instrument, or that no number does.

Poses are chosen D-optimally in sequence, so that the first n of them are a plan of n poses. The posterior covariance of
the geometry after n poses, (I + Σ BᵀB)⁻¹ in units of the manufacturing tolerances, is carried to the TCP at a grid
through the workspace: the radius that contains 95 % of the landings follows before anything is measured. Beyond the
candidates at hand, poses repeat and the information grows in proportion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib import planning, workspace
from pcalib.robot import Robot
from pcalib.uncertainty import radius

CANDIDATES = 400
"""Reachable poses to choose from: twice as many change the radius of 40 chosen ones by 3 %."""
CHOSEN = 120
"""Poses chosen one by one; more of them tell as much as these repeated."""
MOST = 3000
"""Poses beyond which no more are advised: two days of work with a tracker."""
BETTER = (0.5, 0.25, 0.1)
"""Shares of σ that are tried where no number of poses suffices."""


@dataclass(frozen=True, eq=False)
class Reach:
    """What poses would reach."""

    within: float
    """[m] radius asked for."""
    poses: int | None
    """The smallest number that reaches it; None where none up to MOST does."""
    counts: tuple[int, ...]
    u95: tuple[float, ...]
    """[m] radius after each of `counts` poses, and"""
    rms: tuple[float, ...]
    """[m] RMS miss."""
    limit: float
    """[m] radius after MOST poses."""
    sigma: tuple[float, float] | None
    """(position [m], rotation [rad]) 1σ of an instrument, a round factor better, that reaches the radius."""
    with_rotations: int | None
    """Poses after which it would be reached if orientation were measured as well; None where it is, or would not do."""


def reach(
    robot: Robot, within: float, tool: np.ndarray, tools: np.ndarray, sigma: np.ndarray, level: str = "complete",
    seed: int = 0,
) -> Reach:  # fmt: skip
    """How many poses reach a radius with a tool.

    Args:
        within: [m] radius that is to contain 95 % of the landings.
        tool: (3,) [m] TCP that is commanded.
        tools: (T, 3) [m] points that are measured.
        sigma: (6,) [m, rad] 1σ of the instrument; inf where a component is not measured.
    """
    found = _Information(robot, tool, tools, sigma, level, seed)
    poses = found.smallest(within)
    counts: tuple[int, ...] = tuple(sorted({10, 20, 40, 80, 160, 320, poses or 10}))
    spreads = [found.landings(n) for n in counts]
    better, more = None, None
    if poses is None:
        for share in BETTER:
            if _Information(robot, tool, tools, share * sigma, level, seed).smallest(within) is not None:
                rotation = share * sigma[3] if np.isfinite(sigma[3]) else np.nan
                better = (float(share * sigma[0]), float(rotation))
                break
        if not np.isfinite(sigma[3]):
            seen = np.r_[sigma[:3], np.full(3, ROTATIONS)]
            more = _Information(robot, tool, tools, seen, level, seed).smallest(within)
    return Reach(
        within, poses, counts, tuple(radius.pooled(c) for c in spreads), tuple(_rms(c) for c in spreads),
        radius.pooled(found.landings(MOST)), better, more,
    )  # fmt: skip


ROTATIONS = 9e-5
"""[rad] 1σ of an instrument that reads orientation, 0.005°, where the user's does not."""


def _rms(covariance: np.ndarray) -> float:
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))


class _Information:
    """What poses tell of the geometry, in units of its tolerances, and the TCP's derivatives by it."""

    def __init__(
        self, robot: Robot, tool: np.ndarray, tools: np.ndarray, sigma: np.ndarray, level: str, seed: int
    ):
        candidates = workspace.reachable(robot, CANDIDATES, np.random.default_rng(seed)).q
        q, t = np.repeat(candidates, len(tools), axis=0), np.tile(tools, (len(candidates), 1))
        measured = np.isfinite(sigma) & np.isin(np.arange(6), robot.mechanism.plate_dofs)
        self.blocks = planning.information_blocks(robot, q, t, sigma, measured, level)
        self.order = planning.d_optimal(self.blocks, min(CHOSEN, len(q)), exchanges=0)
        spots = workspace.reachable(robot, 60, np.random.default_rng([seed, 1])).q
        axes = np.isin(np.arange(6), robot.mechanism.task) & (np.arange(6) < 3)
        ones = np.ones(6)
        where = np.broadcast_to(tool, (len(spots), 3))
        self.carry = np.zeros((len(spots), 3, self.blocks.shape[-1]))
        self.carry[:, axes[:3]] = planning.information_blocks(robot, spots, where, ones, axes, level)

    def landings(self, n: int) -> np.ndarray:
        """(P, 3, 3) [m²] covariance of landings after n poses."""
        full, rest = divmod(n, len(self.order))
        B = self.blocks[self.order]
        first = B[:rest].reshape(-1, B.shape[-1])
        whole = B.reshape(-1, B.shape[-1])
        stacked = np.concatenate([np.eye(B.shape[-1]), first, np.sqrt(full) * whole])
        R = np.asarray(np.linalg.qr(stacked, mode="r"))
        half = np.linalg.solve(R.T, np.swapaxes(self.carry, 1, 2).transpose(1, 0, 2).reshape(B.shape[-1], -1))
        half = half.reshape(B.shape[-1], len(self.carry), 3).transpose(1, 2, 0)
        return half @ np.swapaxes(half, 1, 2)

    def smallest(self, within: float) -> int | None:
        """The smallest number of poses with which 95 % of landings lie within a radius; None where MOST do not."""
        if radius.pooled(self.landings(MOST)) > within:
            return None
        low, high = 0, MOST
        while high - low > max(1, low // 50):
            middle = (low + high) // 2
            low, high = (middle, high) if radius.pooled(self.landings(middle)) > within else (low, middle)
        return high
