"""Arms that bend under the pull of their rods and their own weight."""

from __future__ import annotations

import numpy as np

from pcalib import rotation
from pcalib.effects.base import EffectParameter, Situation
from pcalib.effects.library import PlacedEffect, motor_axes, pivots, stiffness, unsuited_without_arms
from pcalib.mechanics.mechanism import Mechanism


class ArmBending(PlacedEffect):
    """Each arm is a cantilever from its motor axis; c = a³/3EI [m/N] is how far a force on the elbow moves the elbow.

    With tip force F, tip moment M and the arm's weight W spread evenly from the axis to L = 2·arm_com, in either plane:

        δ = c·(F + 1.5·M/a + W·L²·(4a − L)/8a³)         elbow displacement [m]
        φ = c·(1.5·F/a + 3·M/a² + W·L²/2a³)             elbow rotation [rad]

    (Euler–Bernoulli.) *vertical* bends in the arm's plane, *lateral* along the motor axis. Anchors beside the arm's
    axis move by δ + φ × offset, so lateral bending skews the parallelogram. The vertical part is all but a drive
    compliance; the lateral one is not. A steel arm has 5 N/µm, the softest printed one 0.1.
    """

    title = "arms bend under load"
    channels = ("elbow",)
    wants = ("payload",)

    quantities = tuple(
        EffectParameter(way, "um_N", 2e-7, 0.0, 5e-5, plausible=(0.0, 1e-5), alike=0.5)
        for way in ("vertical", "lateral")
    )

    def unsuited(self, mechanism: Mechanism) -> str:
        return unsuited_without_arms(mechanism)

    def shapes(self, at: Situation) -> np.ndarray:
        mechanism = at.robot.mechanism
        u = motor_axes(mechanism, at.k)
        assert u is not None
        P = pivots(at)
        offset = at.side.A - P  # (N, m, 3)
        share = np.zeros((len(mechanism.rods), len(mechanism.actuators)))
        share[np.arange(len(share)), mechanism.actuator] = 1.0
        middle = np.swapaxes(np.swapaxes(offset, 1, 2) @ (share / share.sum(axis=0)), 1, 2)  # (N, nq, 3) elbow − P
        along = middle - np.sum(middle * u, axis=-1, keepdims=True) * u
        length = np.linalg.norm(along, axis=-1, keepdims=True)
        e = along / length
        up = rotation.cross(np.broadcast_to(u, e.shape), e)

        def on_arms(values: np.ndarray) -> np.ndarray:
            return np.swapaxes(np.swapaxes(values, 1, 2) @ share, 1, 2)

        beside = offset - along[:, mechanism.actuator]  # anchors about the tip of the arm's axis
        force = at.elbow_force
        F, M = on_arms(force), on_arms(rotation.cross(beside, force))
        a = length[..., 0]
        L = np.minimum(2 * at.robot.mass.get("arm_com", 0.0), a)
        W = at.robot.mass.get("arm", 0.0) * at.g
        out = []
        # Turning about `axis` by φ > 0 moves the tip along `way`: up for the motor axis, −u for the arm's own normal.
        for axis, way in ((np.broadcast_to(u, e.shape), up), (up, -np.broadcast_to(u, e.shape))):
            f, m, w = np.sum(F * way, -1), np.sum(M * axis, -1), way @ W
            tip = f + 1.5 * m / a + w * L**2 * (4 * a - L) / (8 * a**3)
            turn = 1.5 * f / a + 3 * m / a**2 + w * L**2 / (2 * a**3)
            moved = (tip[..., None] * way)[:, mechanism.actuator]
            out.append(moved + rotation.cross((turn[..., None] * axis)[:, mechanism.actuator], beside))
        return np.stack(out)

    def say(self, quantity: EffectParameter, value: float) -> str:
        return f"{super().say(quantity, value)} {stiffness(value, quantity.unit, 'elbow')}"


EFFECT = ArmBending
