"""The noise of a camera that sees a board: small in the image, larger in depth and in rotations that tilt the board.

The camera looks along the z axis of the measuring frame.
"""

from __future__ import annotations

import numpy as np

from bench.noises import Noise, Scene
from pcalib.settings import Setting


class Camera(Noise):
    """Errors of `sigma_pos` in x and y and of `sigma_depth` in z; `sigma_rot` about z and `sigma_out` about x and y."""

    SETTINGS = (
        Setting("sigma_depth", "length", 100e-6, 0.0, 0.1, about="1σ in depth"),
        Setting("sigma_out", "angle", 200e-6, 0.0, 0.2, about="1σ of rotations about x and y, which tilt the board"),
        Setting("state_axes", "flag", True, about="whether the file states σ by component, or only their mean"),
    )

    def errors(self, scene: Scene) -> np.ndarray:
        return self._scales() * scene.normals

    def covariance(self, scene: Scene) -> np.ndarray:
        return np.tile(np.diag(self._scales() ** 2), (len(scene.rows), 1, 1))

    def stated(self, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
        if not self.values["state_axes"]:
            return super().stated(scene)
        n, each = len(scene.rows), self._scales()
        return np.tile(each[:3], (n, 1)), np.tile(each[3:], (n, 1))

    def _scales(self) -> np.ndarray:
        v = self.values
        across, out = v["sigma_pos"], v["sigma_out"]
        return np.array([across, across, v["sigma_depth"], out, out, v["sigma_rot"]])


NOISE = Camera
