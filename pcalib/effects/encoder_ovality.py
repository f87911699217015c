"""Encoders whose reading errs twice per turn."""

from __future__ import annotations

from pcalib.effects.base import EffectParameter
from pcalib.effects.library import Harmonic


class EncoderOvality(Harmonic):
    """δq_i = A·sin 2q_i + B·cos 2q_i [rad]. From an oval disc or a wobbling shaft; some ten arc seconds.

    A badly wobbling shaft makes 165″ (8e-4 rad); more is not plausible.
    """

    title = "encoder discs run oval"
    wants = ("wide range of motor angles",)
    cycles = (2,)
    quantities = tuple(
        EffectParameter(part, "arcsec", 1e-4, -1e-2, 1e-2, plausible=(-8e-4, 8e-4)) for part in ("sine", "cosine")
    )


EFFECT = EncoderOvality
