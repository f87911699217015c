"""The noise of a laser tracker: small along its beam, larger across it."""

from __future__ import annotations

import numpy as np

from bench.noises import Noise, Scene
from pcalib.data.instrument import Instrument
from pcalib.settings import Setting


class RangeAngle(Noise):
    """Errors of the range (`sigma_range`, and `sigma_distance` times the distance) and of both angles (`sigma_angle`).

    Across the beam the error is the angle's times the distance. Rotations have white noise of `sigma_rot`.
    """

    BESIDE = (False, True)
    SETTINGS = (
        Setting("sigma_range", "length", 2e-6, 0.0, 0.1, about="1σ along the beam"),
        Setting("sigma_angle", "angle", 5e-6, 0.0, 0.1, about="1σ of either angle of the beam"),
    )

    def errors(self, scene: Scene) -> np.ndarray:
        axes, sigma = self._beam(scene)
        across = (axes @ (sigma * scene.normals[:, :3])[:, :, None])[:, :, 0]
        return np.hstack([across, self.values["sigma_rot"] * scene.normals[:, 3:]])

    def covariance(self, scene: Scene) -> np.ndarray:
        axes, sigma = self._beam(scene)
        out = np.zeros((len(axes), 6, 6))
        out[:, :3, :3] = axes @ (sigma[:, :, None] ** 2 * np.swapaxes(axes, 1, 2))
        out[:, 3:, 3:] = self.values["sigma_rot"] ** 2 * np.eye(3)
        return out

    def _beam(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        """Return (N, 3, 3) axes along the beam and across it, as columns; (N, 3) [m] 1σ along each."""
        v, distance = self.values, scene.distance
        along = (scene.position - scene.station) / distance[:, None]
        # Any direction across will do: that of the coordinate axis to which the beam is least parallel.
        least = np.eye(3)[np.argmin(np.abs(along), axis=1)]
        first = np.cross(along, least)
        first /= np.linalg.norm(first, axis=1)[:, None]
        axes = np.stack([along, first, np.cross(along, first)], axis=2)
        over = v["sigma_angle"] * distance
        return axes, np.stack([np.hypot(v["sigma_range"], v["sigma_distance"] * distance), over, over], axis=1)

    def description(self, scene: Scene) -> Instrument:
        v = self.values
        return Instrument(v["sigma_range"], v["sigma_distance"], v["sigma_angle"], scene.station)


NOISE = RangeAngle
