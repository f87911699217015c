"""Where base-side anchors run, in numbers alone.

With the geometry fixed, every base-side anchor runs on a circle or a straight line, whatever the kind of robot:

    A = O + C·cos q + S·sin q + D·q        l = L + s·q
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.mechanics.mechanism import BaseSide, Mechanism

SAME = 1e-12
"""[m] by which an anchor may miss the circle or line that was read off it: rounding leaves 1e-16."""


@dataclass(frozen=True)
class Paths:
    """Circles, lines and lengths of the m rods, vectors in metres, base frame."""

    centre: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    slope: np.ndarray
    """(m, 3) [m, m, m, m per unit of q]: O, C, S and D."""
    length: np.ndarray
    rate: np.ndarray
    """(m,) L [m] and s [m per unit of q]."""
    guided: np.ndarray
    """(m,) bool: rows whose direction the actuator prescribes, n = guide_cosine·cos q + guide_sine·sin q."""
    guide_cosine: np.ndarray
    guide_sine: np.ndarray
    """(m, 3); zero on plain rods."""
    guide_length: np.ndarray
    """(m,) [m] length of the rod that a guided row turns, which joins the same anchors; 1 on plain rods."""

    def misses(self, mechanism: Mechanism, k: np.ndarray) -> float:
        """[m] by which an anchor or a length, at a command in between, is not where these paths have it."""
        q = 0.7
        there = _at(mechanism, k, q)
        A = self.centre + np.cos(q) * self.cosine + np.sin(q) * self.sine + q * self.slope
        return float(max(np.abs(A - there.A[0]).max(), np.abs(self.length + q * self.rate - there.length).max()))


def _at(mechanism: Mechanism, k: np.ndarray, q: float) -> BaseSide:
    return mechanism.actuation.base(k, np.full((1, len(mechanism.actuators)), q))


def base_paths(mechanism: Mechanism, k: np.ndarray) -> Paths:
    """The paths for parameters k (nk,), read off the anchors at zero and at a quarter turn."""
    zero, quarter = _at(mechanism, k, 0.0), _at(mechanism, k, 0.5 * np.pi)
    m = zero.A.shape[1]
    straight = np.all(np.abs(zero.dA[0] - quarter.dA[0]) < SAME, axis=1)[:, None]
    cosine = np.where(straight, 0.0, -quarter.dA[0])
    guided, guides, turned = np.zeros(m, bool), np.zeros((2, m, 3)), np.ones(m)
    length = np.broadcast_to(zero.length, (1, m))[0].copy()
    centre = zero.A[0] - cosine
    if zero.guide is not None and quarter.guide is not None:
        guided = ~np.isnan(zero.guide[0, :, 0])
        guides = np.nan_to_num(np.stack([zero.guide[0], quarter.guide[0]]))
        plate = mechanism.plate_points(k)
        for g in np.flatnonzero(guided):
            same = np.abs(centre - centre[g]).max(axis=1) + np.abs(plate - plate[g]).max(axis=1)
            same[guided] = np.inf
            turned[g] = length[int(np.argmin(same))]
    return Paths(
        centre=centre, cosine=cosine, sine=np.where(straight, 0.0, zero.dA[0]),
        slope=np.where(straight, zero.dA[0], 0.0), length=length, rate=np.broadcast_to(zero.dlength, (1, m))[0].copy(),
        guided=guided, guide_cosine=guides[0], guide_sine=guides[1], guide_length=turned,
    )  # fmt: skip
