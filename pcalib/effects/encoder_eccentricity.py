"""Encoders whose reading errs once per turn."""

from __future__ import annotations

from pcalib.effects.base import EffectParameter
from pcalib.effects.library import Harmonic


class EncoderEccentricity(Harmonic):
    """δq_i = A·sin q_i + B·cos q_i [rad]. A disc of 50 mm that runs 10 µm off centre errs by 83″.

    What four times as much would need (1.6e-3 rad) is no longer plausible.
    """

    title = "encoder discs run off centre"
    wants = ("wide range of motor angles",)
    cycles = (1,)
    quantities = tuple(
        EffectParameter(part, "arcsec", 2e-4, -1e-2, 1e-2, plausible=(-1.6e-3, 1.6e-3)) for part in ("sine", "cosine")
    )


EFFECT = EncoderEccentricity
