"""Poses with the answers of this program, against which exported code is tested."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcalib import compensation, prediction
from pcalib.mechanics.kinematics import Solution
from pcalib.model import Conditions, Model
from pcalib.workspace import reachable

COUNT = 100
"""Poses of a self-test: it is a check of the translation, and no accuracy study."""


@dataclass(frozen=True)
class Vectors:
    """N poses of the robot as built, the effects of the model included."""

    q: np.ndarray
    """(N, nq) [rad or m] commands."""
    conditions: Conditions
    position: np.ndarray
    """(N, 3) [m] tool points for these commands, base frame."""
    rotation: np.ndarray
    """(N, 3, 3) turns of the plate."""
    target: np.ndarray
    """(N, 3) [m] tool points asked for."""
    target_rotation: np.ndarray
    """(N, 3, 3) turns of the plate asked for, as far as the robot can choose them."""
    solved: Solution
    """Commands for the targets, with the status of each."""


def vectors(model: Model, n: int = COUNT, seed: int = 0) -> Vectors:
    """Random poses of the workspace with tools, temperatures and answers."""
    rng = np.random.default_rng(seed)
    q = reachable(model.robot, n, rng).q
    mechanism = model.robot.mechanism
    tool = mechanism.tool_direction * rng.uniform(0.0, 0.3, (n, 1)) + 0.02 * rng.standard_normal((n, 3))
    if 2 not in mechanism.plate_dofs:
        tool[:, 2] = 0.0
    columns = {f"temp_{part}": rng.uniform(15.0, 40.0, n) for part in ("rods", "arms", "base")}
    conditions = Conditions(tool, np.zeros(n), columns)
    seen = prediction.predict(plain(model), q, conditions)
    wanted = reachable(model.robot, n, rng).pose
    target = wanted.tcp(tool)
    turned = wanted.R if {3, 4, 5} & set(mechanism.task) else np.broadcast_to(np.eye(3), (n, 3, 3))
    solved = compensation.exact(plain(model), target, conditions, turned)
    return Vectors(q, conditions, seen.position, seen.rotation, target, turned, solved)


def plain(model: Model) -> Model:
    """The model in the base frame: commands do not depend on where an instrument stands, or on how it errs."""
    kept = tuple(f for f in model.effects if f.effect.channels != ("sensor",))
    return replace(model, frame=None, effects=kept)
