"""White noise: the components of all rows are independent, with a σ that may grow with the distance."""

from __future__ import annotations

import numpy as np

from bench.noises import Noise, Scene, isotropic


class White(Noise):
    """Normal errors of `sigma_pos` (with `sigma_distance` times the distance added in quadrature) and `sigma_rot`.

    σ is stated row by row.
    """

    def errors(self, scene: Scene) -> np.ndarray:
        return self.scales(scene) * scene.normals

    def scales(self, scene: Scene) -> np.ndarray:
        """Return (N, 6) 1σ of every component."""
        return np.repeat(np.stack(self.stated(scene), axis=1), 3, axis=1)

    def covariance(self, scene: Scene) -> np.ndarray:
        return isotropic(*self.stated(scene))

    def stated(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        v = self.values
        grown = np.hypot(v["sigma_pos"], v["sigma_distance"] * scene.distance)
        return grown, np.full(len(grown), float(v["sigma_rot"]))


NOISE = White
