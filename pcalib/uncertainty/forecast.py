"""What a fit to measurements would tell, before it is made: where landings would lie, by the length of the tool.

The derivatives of the readings are taken at the robot as drawn. Together with the manufacturing tolerances they give
the posterior covariance of the geometry, R⁻¹R⁻ᵀ with R the triangular factor of [J; 1/prior] whitened, which is carried
to the TCP as a fit's own is. The residuals play no part: a forecast says what such data could tell at best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pcalib import workspace
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.fitting import drawing, least_squares
from pcalib.fitting.identifiability import THRESHOLD, without
from pcalib.fitting.linearisation import information
from pcalib.fitting.unknowns import Unknowns, unknowns_of
from pcalib.model import Conditions, Model
from pcalib.posterior import Posterior, Remaining
from pcalib.robot import Robot
from pcalib.uncertainty import radius
from pcalib.uncertainty.propagation import beside_a_frame
from pcalib.wording import size

TOOLS = (0.0, 0.15, 0.3)
"""[m] lengths of tools: none, and two usual ones."""
ROWS = 1000
"""Rows whose derivatives are taken; of more rows every k-th, each of which counts k times."""
SPOTS = 60
"""Poses through the workspace at which landings are forecast, as `pcalib plan --within` does."""
_UNSEEN = 3.0
"""Times the radius at the plate from which on a long tool's is said to be large."""


@dataclass(frozen=True)
class Forecast:
    """What a fit of level `complete` would tell."""

    identified: int
    """Directions of the level that the data identify."""
    u95: tuple[tuple[float, float], ...]
    """(length of the tool [m], radius [m] that contains 95 % of landings once the frame of the cell is taught)."""

    @property
    def landings(self) -> str:
        """The radii in words."""
        where = ("at the plate" if length == 0 else f"with a {1e3 * length:.0f} mm tool" for length, _ in self.u95)
        return ", ".join(f"{size(u)} {place}" for place, (_, u) in zip(where, self.u95, strict=True))

    @property
    def tilts_unseen(self) -> bool:
        """Whether errors that turn the plate are seen so badly that a long tool lands far worse than the plate."""
        return self.u95[-1][1] > _UNSEEN * self.u95[0][1]

    def to_json(self) -> dict[str, Any]:
        """For `pcalib.inspect/1`."""
        rows = [{"tool_mm": 1e3 * length, "u95_um": 1e6 * u} for length, u in self.u95]
        return {"identified": self.identified, "landings": rows}


def forecast(data: Measurements, robot: Robot) -> Forecast | None:
    """What the fitted rows would tell; None where the robot as drawn cannot take the commands, or nothing is told."""
    most = drawing.some_rows(data, ROWS)
    made = drawing.start(most, robot) if len(most) else None
    if made is None:
        return None
    model, rows, at = made
    unknowns = unknowns_of(model, "complete", frame=data.frame == "tracker")
    count = len(data.fit_rows) / max(len(rows), 1)
    found = information(model, rows, unknowns, at, Noise.of(rows), np.full(len(rows), max(count, 1.0)))
    R = found.triangle[:, :-1] * unknowns.scale
    if not np.isfinite(R).all():
        return None
    g = unknowns.n_geometry
    spectrum = np.linalg.svd(without(R[:, :g], R[:, g:]), compute_uv=False)
    posterior = _posterior(model, unknowns, R)
    if posterior is None:
        return None
    q = workspace.reachable(robot, SPOTS, np.random.default_rng(1)).q
    known = replace(model, level="complete", posterior=posterior)
    u95 = []
    for length in TOOLS if robot.mechanism.plate_turns else TOOLS[:1]:
        covariance = beside_a_frame(known, q, Conditions.of(len(q), length * _outwards(robot)))
        u95.append((length, radius.pooled(covariance)))
    return Forecast(int(np.sum(spectrum > THRESHOLD)), tuple(u95))


def _posterior(model: Model, unknowns: Unknowns, R: np.ndarray) -> Posterior | None:
    """Covariance of the geometry from the whitened derivatives (·, n) by the scaled unknowns; None: it is singular."""
    rows = np.hstack([R, np.zeros((len(R), 1))])
    n, g = len(unknowns.names), unknowns.n_geometry
    half = least_squares.root(least_squares.solve(rows, np.zeros(n), unknowns.prior / unknowns.scale)[1])
    if not np.isfinite(half).all():
        return None
    half = (half * unknowns.scale[:, None])[:g]
    return Posterior.of(model.robot.mechanism.levels["complete"].columns, half, Remaining(np.ones(2)))


def _outwards(robot: Robot) -> np.ndarray:
    """(3,) direction of a tool: down where the plate can tilt, and in the plane of the robot where it cannot."""
    if not {3, 4} & set(robot.mechanism.plate_dofs):
        return np.array([1.0, 0.0, 0.0])
    down = robot.gravity[2] <= 0
    return np.array([0.0, 0.0, -1.0 if down else 1.0])
