"""A tool that bends under the payload at its end."""

from __future__ import annotations

import numpy as np

from pcalib.effects.base import Contribution, EffectParameter, Situation
from pcalib.effects.library import LibraryEffect, stiffness

REFERENCE = 0.1
"""[m] tool length that the compliance is stated for."""


class ToolBending(LibraryEffect):
    """The tool is a cantilever from the plate's origin: δ = c·(h/100 mm)³·F⊥ with F = payload·g, h = |t|.

    F⊥ is the weight's part across the tool, c [m/N] the tip compliance h³/3EI of a tool of 100 mm (Euler–Bernoulli).
    A vertical tool at rest does not bend: only tilted or sideways tools show it. The plate's rotation is not touched.
    A steel bar of 10 mm has 3 µm/N, a printed holder some 20, and more than 100 is not plausible.
    """

    title = "the tool bends under the payload"
    variants = ("common",)
    channels = ("tool",)
    wants = ("payload", "tools that reach sideways")

    quantities = (EffectParameter("compliance", "um_N", 2e-6, 0.0, 1e-3, plausible=(0.0, 1e-4)),)

    def _unit(self, at: Situation) -> np.ndarray:
        """(N, 3) [m] deflection in the plate frame per unit compliance."""
        weight = (at.pose.R.swapaxes(-1, -2) @ at.g) * at.payload[:, None]
        h2 = np.sum(at.tool**2, axis=-1, keepdims=True)
        across = weight - at.tool * np.sum(at.tool * weight, -1, keepdims=True) / np.where(h2 > 0, h2, 1.0)
        return (np.sqrt(h2) / REFERENCE) ** 3 * across

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        return Contribution(tool=theta[0] * self._unit(at))

    def say(self, quantity: EffectParameter, value: float) -> str:
        return f"{super().say(quantity, value)} for a tool of 100 mm {stiffness(value, quantity.unit)}"


EFFECT = ToolBending
