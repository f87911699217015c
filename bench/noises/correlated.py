"""Noise that is correlated in time, as from air that moves slowly or a stand that warms up."""

from __future__ import annotations

import numpy as np

from bench.noises import Scene
from bench.noises.white import White
from pcalib.settings import Setting


class Correlated(White):
    """As white noise, with a share of the variance in an Ornstein–Uhlenbeck process from row to row.

    The correlation of that share falls as exp(−|i − j|/rows) between rows i and j of the plan. A single row has the σ
    that is stated.
    """

    SETTINGS = (
        Setting("correlated_share", "number", 0.5, 0.0, 1.0, about="share of the variance that is correlated"),
        Setting("correlated_rows", "number", 6.0, 0.01, 1e6, about="rows after which the correlation is 1/e"),
    )

    def errors(self, scene: Scene) -> np.ndarray:
        share, decay = self.values["correlated_share"], np.exp(-1.0 / self.values["correlated_rows"])
        steps = scene.more(6, np.arange(scene.rows.max() + 1))
        process = np.empty_like(steps)
        process[0] = steps[0]
        for i in range(1, len(steps)):
            process[i] = decay * process[i - 1] + np.sqrt(1 - decay**2) * steps[i]
        mixed = np.sqrt(1 - share) * scene.normals + np.sqrt(share) * process[scene.rows]
        return self.scales(scene) * mixed


NOISE = Correlated
