"""Noise with heavy tails: errors that follow Student's t with three degrees of freedom."""

from __future__ import annotations

import numpy as np

from bench.noises import Scene
from bench.noises.white import White

DEGREES = 3
"""Degrees of freedom: the smallest whole number with a variance."""


class HeavyTails(White):
    """As white noise, with every component drawn from Student's t, scaled to the σ that is stated."""

    def errors(self, scene: Scene) -> np.ndarray:
        squares = scene.more(6 * DEGREES).reshape(-1, 6, DEGREES) ** 2
        t = scene.normals / np.sqrt(squares.mean(axis=2))
        return self.scales(scene) * t * np.sqrt((DEGREES - 2) / DEGREES)


NOISE = HeavyTails
