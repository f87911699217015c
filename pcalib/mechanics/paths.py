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
        there = _at(mechanism, k, [q])
        A = self.centre + np.cos(q) * self.cosine + np.sin(q) * self.sine + q * self.slope
        return float(max(np.abs(A - there.A[0]).max(), np.abs(self.length + q * self.rate - there.length).max()))


def _at(mechanism: Mechanism, k: np.ndarray, q: list[float]) -> BaseSide:
    return mechanism.actuation.base(k, np.repeat(q, len(mechanism.actuators)).reshape(len(q), -1))


def base_paths(mechanism: Mechanism, k: np.ndarray) -> Paths:
    """The paths for parameters k (nk,), read off the anchors at zero and at a quarter turn."""
    side = _at(mechanism, k, [0.0, 0.5 * np.pi])
    m = side.A.shape[1]
    straight = (np.abs(side.dA[0] - side.dA[1]) < SAME).all(axis=1)[:, None]
    cosine = np.where(straight, 0.0, -side.dA[1])
    guided, guides, turned = np.zeros(m, bool), np.zeros((2, m, 3)), np.ones(m)
    length = side.length if side.length.ndim == 1 else side.length[0]
    centre = side.A[0] - cosine
    if side.guide is not None:
        guided = ~np.isnan(side.guide[0, :, 0])
        guides = np.nan_to_num(side.guide)
        plate = mechanism.plate_points(k)
        for g in np.flatnonzero(guided):
            same = np.abs(centre - centre[g]).max(axis=1) + np.abs(plate - plate[g]).max(axis=1)
            same[guided] = np.inf
            turned[g] = length[int(np.argmin(same))]
    return Paths(
        centre=centre, cosine=cosine, sine=np.where(straight, 0.0, side.dA[0]),
        slope=np.where(straight, side.dA[0], 0.0), length=length, rate=np.broadcast_to(side.dlength, (2, m))[0],
        guided=guided, guide_cosine=guides[0], guide_sine=guides[1], guide_length=turned,
    )  # fmt: skip
