"""How much of an effect's signal a fitted geometry leaves visible, and which effect of the library has the same one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcalib import effects, prediction
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.problem import problem
from pcalib.diagnosis.screen import INVISIBLE, NUISANCE, project_out, span
from pcalib.effects.base import Effect
from pcalib.effects.user import trial
from pcalib.fitting.unknowns import unknowns_of
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot

FAINT = 0.05
"""κ below which an effect hides almost wholly in the geometry."""
SAME = 0.02
"""Share of an effect's signal below which what lies outside another's span counts as nothing: 2 % of a signal of 50
noise units is one unit, which no data set shows."""
ROWS = 1000
"""Rows that are looked at, about: shares of signals do not depend on how many there are."""


def visibility(model: Model, data: Measurements, own: Sequence[Effect] = ()) -> dict[str, float]:
    """κ of every effect in its simplest variant: the share of its signal that the geometry cannot take up.

    Effects that these poses cannot show at their largest possible size have 0.
    """
    made = problem(model, data, own, all_rows=True, most=ROWS)
    U = span(made.nuisance, NUISANCE)
    out: dict[str, float] = {}
    for c in made.candidates:
        if c.effect is None or c.name in out:
            continue
        columns = made.whitened(c.columns)
        left = project_out(columns, U)
        seen = np.linalg.norm(left * c.limit, 2) > INVISIBLE
        out[c.name] = float(np.linalg.norm(left * c.scale) / np.linalg.norm(columns * c.scale)) if seen else 0.0
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def sentence(shares: dict[str, float]) -> str:
    """The shares in words."""
    clear = [f"{name} {100 * k:.0f} %" for name, k in shares.items() if k >= FAINT]
    faint = [name for name, k in shares.items() if k < FAINT]
    text = f"Of effects the geometry leaves visible: {', '.join(clear)}" if clear else "The geometry hides every effect"
    return text + (f"; under {100 * FAINT:.0f} %: {', '.join(faint)}." if faint else ".")


def kinship(effect: Effect, robot: Robot) -> list[str]:
    """What there is to know before using an effect, one sentence each.

    It is tried on 60 poses with payloads, tools, directions and temperatures, at full poses in the base frame.
    """
    n = 60
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
