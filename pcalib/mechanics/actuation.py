"""The ways an actuator moves the base-side ends of its rods: rotary arms, carriages on rails, legs.

Each gives anchors and their derivatives in closed form; a robot kind picks one and names its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcalib import rotation
from pcalib.mechanics.mechanism import Actuation, BaseSide


def _per_rod(v: np.ndarray, M: np.ndarray) -> np.ndarray:
    """vᵀ·M for v (N, m, 3) and one matrix per rod (m, 3, 3): m products of N rows, faster than N·m of one."""
    return np.swapaxes(np.matmul(np.swapaxes(v, 0, 1), M), 0, 1)


def _spread(nk: int, where: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(nk, n) matrix whose column i holds `values[i]` at the rows `where[i]`, both (n, c)."""
    out = np.zeros((nk, len(where)))
    out[where.T, np.arange(len(where))] = values.T
    return out


@dataclass(frozen=True, kw_only=True)
class _Mounted(Actuation):
    """Arms or carriages on mounts that turn by β."""

    actuator: np.ndarray
    """(m,) which one holds each rod."""

    def _turned(self, k: np.ndarray, arms: np.ndarray) -> np.ndarray:
        """−∂(vectors)/∂β as the mounts turn, (m, 3·p, 3), of p vectors (m, p, 3) of each rod."""
        J = rotation.left_jacobian(k[self.beta])[self.actuator]
        return (rotation.hat(arms) @ J[:, None]).reshape(len(arms), -1, 3)


@dataclass(frozen=True, kw_only=True)
class RotaryArms(_Mounted):
    """Arms on motor axes: A = p_i + exp(β_i)·Rz(θ_i)·Rx(q_i)·a_r (paper eqs 8–11, with a finite β)."""

    azimuth: np.ndarray
    """(nq,) [rad] nominal direction θ_i of each motor axis."""

    moves = "arm"
    mount = "motor"

    @property
    def columns(self) -> np.ndarray:
        i = self.actuator
        return np.hstack([self.p[i], self.a, self.beta[i], self.length[:, None]])

    def zeros(self, nk: int) -> np.ndarray:
        return _spread(nk, self.beta, self._nominal_frames[:, :, 0])

    def _frames(self, k: np.ndarray) -> np.ndarray:
        """exp(β_i)·Rz(θ_i), (nq, 3, 3): column 0 is the motor axis as built."""
        return rotation.exp(k[self.beta]) @ self._nominal_frames

    @cached_property
    def _nominal_frames(self) -> np.ndarray:
        return rotation.about(np.array([0.0, 0.0, 1.0]), self.azimuth)

    def _circle(self, k: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every anchor runs on a circle, A = O + C cos q + S sin q: three (m, 3) arrays."""
        E, a = frames[self.actuator], k[self.a]
        ax, ay, az = a[:, :1], a[:, 1:2], a[:, 2:]
        centre = k[self.p][self.actuator] + E[:, :, 0] * ax
        return centre, E[:, :, 1] * ay + E[:, :, 2] * az, E[:, :, 2] * ay - E[:, :, 1] * az

    def base(self, k: np.ndarray, q: np.ndarray) -> BaseSide:
        frames = self._frames(k)
        centre, C, S = self._circle(k, frames)
        each = np.repeat(self.actuator[:, None], 3, axis=1)  # one per coordinate: faster than to broadcast over three
        c, s = np.cos(q)[:, each], np.sin(q)[:, each]
        return BaseSide(A=centre + c * C + s * S, dA=c * S - s * C, length=k[self.length], frames=frames)

    def rows(self, k: np.ndarray, q: np.ndarray, side: BaseSide, n: np.ndarray, d: np.ndarray) -> np.ndarray:
        N, m = n.shape[:2]
        out = np.empty((N, m, 10))
        out[..., 0:3] = -n
        assert side.frames is not None
        E = side.frames[self.actuator]
        along = _per_rod(n, E)  # n in the arm's frame at q = 0
        c, s = np.cos(q)[:, self.actuator], np.sin(q)[:, self.actuator]
        out[..., 3] = -along[..., 0]
        out[..., 4] = -(c * along[..., 1] + s * along[..., 2])
        out[..., 5] = -(c * along[..., 2] - s * along[..., 1])
        beta = k[self.beta]
        J = rotation.left_jacobian(beta)[self.actuator]
        arm = side.A - k[self.p][self.actuator]
        out[..., 6:9] = -_per_rod(rotation.cross(arm, n), J)
        out[..., 9] = -1.0
        return out

    def slopes(self, k: np.ndarray) -> np.ndarray:
        frames = self._frames(k)
        centre, C, S = self._circle(k, frames)
        out = np.zeros((len(centre), 14, 10))
        out[:, :3, :3] = -np.eye(3)
        x, y, z = np.moveaxis(frames[self.actuator], -1, 0)
        out[:, :3, 3], out[:, 3:6, 4], out[:, 6:9, 4], out[:, 3:6, 5], out[:, 6:9, 5] = -x, -y, -z, -z, y
        out[:, :9, 6:9] = self._turned(k, np.stack([centre - k[self.p][self.actuator], C, S], axis=1))
        out[:, 12, 9] = -1.0
        return out

    def reach(self, k: np.ndarray, B: np.ndarray) -> np.ndarray:
        centre, C, S = self._circle(k, self._frames(k))
        d = B - centre
        # |d − C cos q − S sin q|² = l², with C ⟂ S and |C| = |S|
        E = rotation.dot(d, C)
        F = rotation.dot(d, S)
        G = 0.5 * (rotation.dot(d, d) + rotation.dot(C, C) - k[self.length] ** 2)
        with np.errstate(invalid="ignore"):
            return np.arctan2(F, E) + np.arccos(G / np.hypot(E, F))

    def weight_moment(self, k: np.ndarray, q: np.ndarray, mass: Mapping[str, float], g: np.ndarray) -> np.ndarray:
        E = self._frames(k)
        c, s = np.cos(q)[..., None], np.sin(q)[..., None]
        turn = mass.get("arm_com", 0.0) * (c * E[:, :, 2] - s * E[:, :, 1])  # derivative of the centre of mass
        return mass.get("arm", 0.0) * turn @ g


@dataclass(frozen=True, kw_only=True)
class Carriages(_Mounted):
    """Carriages on straight rails: A = p_i + exp(β_i)·(a_r + s_i·q_i·e_i); β_i leans the rail, s_i scales its motor."""

    direction: np.ndarray
    """(nq, 3) nominal unit directions e_i of the rails, base frame."""

    moves = "carriage"
    mount = "rail"

    @property
    def columns(self) -> np.ndarray:
        i = self.actuator
        return np.hstack([self.p[i], self.a, self.beta[i], self.scale[i, None], self.length[:, None]])

    def zeros(self, nk: int) -> np.ndarray:
        return _spread(nk, self.p, self.direction)

    def _rails(self, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every anchor runs on a line, A = O + q·D: exp(β) of each rail (nq, 3, 3), O and D (m, 3)."""
        E = rotation.exp(k[self.beta])
        D = (E @ self.direction[..., None])[..., 0] * k[self.scale][:, None]
        origin = k[self.p][self.actuator] + (E[self.actuator] @ k[self.a][..., None])[..., 0]
        return E, origin, D[self.actuator]

    def base(self, k: np.ndarray, q: np.ndarray) -> BaseSide:
        E, origin, D = self._rails(k)
        A = origin + q[:, self.actuator, None] * D
        return BaseSide(A=A, dA=np.broadcast_to(D, A.shape), length=k[self.length], frames=E)

    def rows(self, k: np.ndarray, q: np.ndarray, side: BaseSide, n: np.ndarray, d: np.ndarray) -> np.ndarray:
        N, m = n.shape[:2]
        assert side.frames is not None
        out = np.empty((N, m, 11))
        out[..., 0:3] = -n
        in_frame = _per_rod(n, side.frames[self.actuator])
        out[..., 3:6] = -in_frame
        J = rotation.left_jacobian(k[self.beta])[self.actuator]
        arm = side.A - k[self.p][self.actuator]
        out[..., 6:9] = -_per_rod(rotation.cross(arm, n), J)
        out[..., 9] = -q[:, self.actuator] * rotation.dot(in_frame, self.direction[self.actuator])
        out[..., 10] = -1.0
        return out

    def slopes(self, k: np.ndarray) -> np.ndarray:
        E, origin, D = self._rails(k)
        out = np.zeros((len(origin), 14, 11))
        out[:, :3, :3] = -np.eye(3)
        out[:, :3, 3:6] = -E[self.actuator]
        turned = self._turned(k, np.stack([origin - k[self.p][self.actuator], D], axis=1))
        out[:, :3, 6:9], out[:, 9:12, 6:9] = turned[:, :3], turned[:, 3:]
        out[:, 9:12, 9] = -(E @ self.direction[..., None])[self.actuator, :, 0]
        out[:, 12, 10] = -1.0
        return out

    def reach(self, k: np.ndarray, B: np.ndarray) -> np.ndarray:
        _, origin, D = self._rails(k)
        d = B - origin
        along, speed = rotation.dot(d, D), rotation.dot(D, D)
        with np.errstate(invalid="ignore"):
            # The carriage ahead of the plate on its rail is the working branch.
            return (along + np.sqrt(along**2 - speed * (rotation.dot(d, d) - k[self.length] ** 2))) / speed

    def weight_moment(self, k: np.ndarray, q: np.ndarray, mass: Mapping[str, float], g: np.ndarray) -> np.ndarray:
        D = (rotation.exp(k[self.beta]) @ self.direction[..., None])[..., 0] * k[self.scale][:, None]
        return np.broadcast_to(mass.get("carriage", 0.0) * (D @ g), q.shape)


@dataclass(frozen=True, kw_only=True)
class Legs(Actuation):
    """Legs of commanded length from fixed base joints: l_r = l0_r + s_r·travel_r·q_r.

    Half of each leg's mass stands at either end, so that no moving mass loads the actuators beside the rod forces.
    """

    travel: np.ndarray
    """(m,) nominal lengthening per unit of command: 1, or [m/rad] where motors are commanded."""

    drive = "leg"

    @property
    def columns(self) -> np.ndarray:
        return np.hstack([self.p, self.length[:, None], self.scale[:, None]])

    def zeros(self, nk: int) -> np.ndarray:
        return _spread(nk, self.length[:, None], self.travel[:, None])

    def base(self, k: np.ndarray, q: np.ndarray) -> BaseSide:
        A = np.broadcast_to(k[self.p], (len(q), *self.p.shape))
        rate = k[self.scale] * self.travel
        return BaseSide(A, np.zeros(A.shape), k[self.length] + rate * q, np.broadcast_to(rate, q.shape))

    def rows(self, k: np.ndarray, q: np.ndarray, side: BaseSide, n: np.ndarray, d: np.ndarray) -> np.ndarray:
        out = np.empty((*n.shape[:2], 5))
        out[..., 0:3] = -n
        out[..., 3] = -1.0
        out[..., 4] = -self.travel * q
        return out

    def slopes(self, k: np.ndarray) -> np.ndarray:
        out = np.zeros((len(self.p), 14, 5))
        out[:, :3, :3] = -np.eye(3)
        out[:, 12, 3], out[:, 13, 4] = -1.0, -self.travel
        return out

    def reach(self, k: np.ndarray, B: np.ndarray) -> np.ndarray:
        length = np.linalg.norm(B - k[self.p], axis=-1)
        return (length - k[self.length]) / (k[self.scale] * self.travel)
