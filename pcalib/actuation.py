"""The ways an actuator moves the base-side ends of its rods: rotary arms, carriages on rails, legs.

Each gives anchors and their derivatives in closed form; a robot kind picks one and names its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcalib import rotation
from pcalib.mechanism import BaseSide


@dataclass(frozen=True)
class RotaryArms:
    """Arms on motor axes: A = p_i + exp(β_i)·Rz(θ_i)·Rx(q_i)·a_r (paper eqs 8–11, with a finite β)."""

    azimuth: np.ndarray
    """(nq,) [rad] nominal direction θ_i of each motor axis."""
    actuator: np.ndarray
    """(m,) arm of each rod."""
    p: np.ndarray
    """(nq, 3) where p_i stands in k."""
    beta: np.ndarray
    """(nq, 3) where β_i stands in k."""
    a: np.ndarray
    """(m, 3) where a_r stands in k."""
    length: np.ndarray
    """(m,) where l_r stands in k."""

    @property
    def columns(self) -> np.ndarray:
        i = self.actuator
        return np.hstack([self.p[i], self.a, self.beta[i], self.length[:, None]])

    def _frames(self, k: np.ndarray) -> np.ndarray:
        """exp(β_i)·Rz(θ_i), (nq, 3, 3): column 0 is the motor axis as built."""
        return rotation.exp(k[self.beta]) @ rotation.about(np.array([0.0, 0.0, 1.0]), self.azimuth)

    def _circle(self, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every anchor runs on a circle, A = O + C cos q + S sin q: three (m, 3) arrays."""
        E, a = self._frames(k)[self.actuator], k[self.a]
        ax, ay, az = a[:, :1], a[:, 1:2], a[:, 2:]
        centre = k[self.p][self.actuator] + E[:, :, 0] * ax
        return centre, E[:, :, 1] * ay + E[:, :, 2] * az, E[:, :, 2] * ay - E[:, :, 1] * az

    def base(self, k: np.ndarray, q: np.ndarray) -> BaseSide:
        centre, C, S = self._circle(k)
        c, s = np.cos(q)[:, self.actuator, None], np.sin(q)[:, self.actuator, None]
        return BaseSide(A=centre + c * C + s * S, dA=c * S - s * C, length=k[self.length])

    def rows(self, k: np.ndarray, q: np.ndarray, side: BaseSide, n: np.ndarray, d: np.ndarray) -> np.ndarray:
        N, m = n.shape[:2]
        out = np.empty((N, m, 10))
        out[..., 0:3] = -n
        E = self._frames(k)[self.actuator]
        along = np.matmul(n[:, :, None, :], E)[:, :, 0]  # n in the arm's frame at q = 0
        c, s = np.cos(q)[:, self.actuator], np.sin(q)[:, self.actuator]
        out[..., 3] = -along[..., 0]
        out[..., 4] = -(c * along[..., 1] + s * along[..., 2])
        out[..., 5] = -(c * along[..., 2] - s * along[..., 1])
        beta = k[self.beta]
        J = rotation.left_jacobian(beta)[self.actuator]
        arm = side.A - k[self.p][self.actuator]
        out[..., 6:9] = -np.matmul(rotation.cross(arm, n)[:, :, None, :], J)[:, :, 0]
        out[..., 9] = -1.0
        return out

    def reach(self, k: np.ndarray, B: np.ndarray) -> np.ndarray:
        centre, C, S = self._circle(k)
        d = B - centre
        # |d − C cos q − S sin q|² = l², with C ⟂ S and |C| = |S|
        E = np.sum(d * C, axis=-1)
        F = np.sum(d * S, axis=-1)
        G = 0.5 * (np.sum(d * d, axis=-1) + np.sum(C * C, axis=-1) - k[self.length] ** 2)
        with np.errstate(invalid="ignore"):
            return np.arctan2(F, E) + np.arccos(G / np.hypot(E, F))

    def weight_moment(self, k: np.ndarray, q: np.ndarray, mass: Mapping[str, float], g: np.ndarray) -> np.ndarray:
        E = self._frames(k)
        c, s = np.cos(q)[..., None], np.sin(q)[..., None]
        turn = mass.get("arm_com", 0.0) * (c * E[:, :, 2] - s * E[:, :, 1])  # derivative of the centre of mass
        return mass.get("arm", 0.0) * turn @ g
