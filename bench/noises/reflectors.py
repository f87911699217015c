"""The noise of a pose that is a rigid fit to three reflectors on the plate, measured one by one."""

from __future__ import annotations

import numpy as np

from bench.noises import Noise, Scene
from pcalib import rotation
from pcalib.data.instrument import Instrument
from pcalib.settings import Setting


class Reflectors(Noise):
    """Every reflector errs by `sigma_reflector` per component; a rigid fit gives the pose, which is read at the tool.

    The errors of position and rotation are correlated: the further the tool point from the reflectors' centre, the
    more a turn of the fitted plate moves it.
    """

    BESIDE = (False, False)
    SETTINGS = (
        Setting("sigma_reflector", "length", 15e-6, 0.0, 0.1, about="1σ per component of each reflector"),
        Setting("reflector_radius", "length", 0.08, 1e-3, 10.0, about="of the circle of three reflectors"),
        Setting("reflector_centre", "length", np.zeros(3), count=3, about="of that circle, plate frame"),
    )

    @property
    def places(self) -> np.ndarray:
        """(3, 3) [m] the reflectors in the plate frame, one a row."""
        way = np.radians([90.0, 210.0, 330.0])
        circle = np.round(np.stack([np.cos(way), np.sin(way), np.zeros(3)], axis=1), 15)
        return self.values["reflector_centre"] + self.values["reflector_radius"] * circle

    def errors(self, scene: Scene) -> np.ndarray:
        places = self.places
        centre = scene.position + (scene.R @ (places.mean(axis=0) - scene.tool)[:, :, None])[:, :, 0]
        true = (scene.R @ (places - places.mean(axis=0)).T).swapaxes(1, 2)  # (N, reflector, 3) about their centre
        noise = self.values["sigma_reflector"] * scene.more(9).reshape(-1, 3, 3)
        seen = true + noise
        shift = seen.mean(axis=1)
        turn = rotation.laying(true, seen - shift[:, None])
        arm = scene.position - centre
        moved = shift + (turn @ arm[:, :, None])[:, :, 0] - arm
        return np.hstack([moved, rotation.log(turn)])

    def covariance(self, scene: Scene) -> np.ndarray:
        arms = (scene.R[:, None] @ (self.places - scene.tool[:, None])[..., None])[..., 0]
        # A reflector at arm a from the tool point moves by δx + δφ × a.
        cross = np.zeros((*arms.shape, 3))
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            cross[..., i, j], cross[..., j, i] = arms[..., k], -arms[..., k]
        J = np.concatenate([np.broadcast_to(np.eye(3), cross.shape), cross], axis=-1).reshape(len(arms), 9, 6)
        _, R = np.linalg.qr(J)
        root = np.linalg.solve(R, np.broadcast_to(np.eye(6), R.shape))
        return self.values["sigma_reflector"] ** 2 * root @ np.swapaxes(root, 1, 2)

    def description(self, scene: Scene) -> Instrument:
        return Instrument(sigma_reflector=self.values["sigma_reflector"], reflectors=self.places)


NOISE = Reflectors
