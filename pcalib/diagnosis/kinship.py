"""What an effect resembles: one of the library, or something that the geometry absorbs."""

from __future__ import annotations

import numpy as np

from pcalib import effects, prediction
from pcalib.diagnosis.channels import Point
from pcalib.diagnosis.screen import project_out, span
from pcalib.effects.base import Effect
from pcalib.effects.user import trial
from pcalib.fitting.unknowns import unknowns_of
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot

SAME = 0.02
"""Share of an effect's signal below which what lies outside another's span is nothing."""


def kinship(effect: Effect, robot: Robot, n: int = 60) -> list[str]:
    """What there is to know before using an effect, one sentence each.

    It is tried on n poses with payloads, tools, directions and temperatures, at full poses in the base frame.
    """
    at = trial(robot, effect.needs, n)
    model = Model(robot, robot.mechanism.nominal.copy(), "complete")
    conditions = Conditions(at.tool, at.payload, at.columns)
    point = Point.of(model, prediction.predict(model, at.q, conditions), conditions)
    weight = np.r_[np.full(3, 1 / 15e-6), np.full(3, 1 / 60e-6)][:, None]

    def whitened(e: Effect) -> np.ndarray:
        scale = np.array([p.prior for p in e.parameters])
        return (point.columns(e.basis(point.situation)) * scale * weight).reshape(6 * n, -1)

    unknowns = unknowns_of(model, "complete")
    geometry = prediction.geometry_columns(model, point.prediction, point.closure, point.JX) * weight
    U = span(geometry.reshape(6 * n, -1) * unknowns.scale[: unknowns.n_geometry], 1e-3)
    mine = whitened(effect)
    size = float(np.linalg.norm(mine))
    kappa = float(np.linalg.norm(project_out(mine, U))) / size if size else 0.0
    if kappa < SAME:
        return [
            f"The geometry absorbs it: {100 * kappa:.1g} % of its signal is left after a fit of all lengths. "
            "No measurement of poses can show it."
        ]
    lines = [f"{100 * kappa:.0f} % of its signal is left after a fit of all lengths."]
    for name in effects.names():
        kind = effects.get(name)
        if name == effect.name or kind.unsuited(robot.mechanism):
            continue
        for per in kind.variants:
            other = whitened(effects.get(name, per, robot))
            Q = span(np.hstack([U, project_out(other, U)]), 1e-3)
            left = float(np.linalg.norm(project_out(mine, Q))) / size
            if left < SAME * kappa:
                more = "" if per == kind.variants[0] else f":{per}"
                lines.append(f"It is no different from {name}{more} of the library (with the geometry free).")
                break
    return lines
