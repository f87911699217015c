"""D-optimal plans: pcalib chooses the poses from the instrument's readings and their noise there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench import plan as plans
from bench.commands import Commands
from bench.instrument import MEASURED, Instrument
from pcalib import planning
from pcalib.data import sigma
from pcalib.robot import Robot

CANDIDATES = 600


def make(
    robot: Robot,
    instrument: Instrument,
    n: int,
    *,
    check: int = 0,
    tools: Sequence[np.ndarray] = (),
    payloads: Sequence[float] = (),
    candidates: int = CANDIDATES,
    seed: int = 0,
) -> plans.Plan:
    """The n commands of `candidates` random ones that tell most about the geometry, and `check` random ones after them.

    Args:
        tools: (3,) each [m, plate frame], of which each pose takes the one that tells most; payloads: [kg], in turn.

    Raises:
        InputError: numbers that make no plan.
        ReachError: the workspace has too few poses that the robot can take.
    """
    plans.sensible(n, check)
    # Noise that grows with distance counts as in the middle of the workspace.
    v, space = instrument.values, robot.workspace
    distance = np.linalg.norm([0.0, 0.0, 0.5 * (space.z_min + space.z_max)] - v["position"])
    q, tool = planning.plan(
        robot,
        n,
        tools=np.array(tools) if len(tools) else None,
        sigma_pos=float(np.hypot(v["sigma_pos"], v["sigma_distance"] * distance)) or sigma.DEFAULT_SIGMA_POS,
        sigma_rot=v["sigma_rot"] or sigma.DEFAULT_SIGMA_ROT,
        measured=MEASURED[v["kind"]],
        candidates=candidates,
        seed=seed,
    )
    commands = Commands.of(q, tool, np.resize(payloads or [0.0], len(q)))
    plan = plans.Plan(commands, np.full(n, -1), np.zeros(n, bool), plans.OPTIMAL)
    return plans.with_checks(robot, plan, check, seed) if check else plan
