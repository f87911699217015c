"""Explanations that the data cannot rule out beside the one that a model has: which, and their weights.

The weight of an explanation is exp(−ΔBIC/2) of it among all that are adequate (Kass and Raftery 1995). Each rival is
refitted, so that the model knows where it would put the TCP.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pcalib import modelfile
from pcalib.data.measurement import Measurements
from pcalib.effects.base import Effect
from pcalib.errors import PcalibError
from pcalib.model import Model

if TYPE_CHECKING:  # weighing the rivals that a model keeps needs no diagnosis
    from pcalib.diagnosis.diagnose import Diagnosis
    from pcalib.diagnosis.verdict import Explanation

LEAST = 0.02
"""Weight below which a rival changes no radius by as much as 1 %, unless it puts the TCP seven times as far away."""
MOST = 3
"""Rivals that are kept, the weightiest first: each costs a prediction per command."""


def kept(model: Model, before: Model, data: Measurements, spec: str, own: Sequence[Effect] = ()) -> Model:
    """The model with the rivals of the effect that was just added to it.

    Args:
        model: fitted with the effect, with its uncertainty.
        before: the model that the effect was added to.
        spec: of the effect.
    """
    from pcalib.diagnosis.diagnose import diagnose

    if model.uncertainty is None or spec in model.robot.mechanism.levels:
        return model
    try:
        found = diagnose(before, data, own)
    except PcalibError:  # what cannot be diagnosed has no rivals that are known
        return model
    return replace(model, uncertainty=replace(model.uncertainty, rivals=tuple(_entries(found, before, data, spec))))


def _entries(found: Diagnosis, before: Model, data: Measurements, spec: str) -> list[dict[str, Any]]:
    """Rivals as history entries of a model file, each with its weight."""
    from pcalib.diagnosis.held_out import refitted

    name = spec.partition(":")[0] if ".py" not in spec else spec
    own = [e for e in found.sets if name in e.names or spec in e.specs]
    if not own:  # added against the verdict: no evidence weighs it against others
        return []
    shares = _weights([own[0], *(e for e in found.sets if e not in own)])
    out = []
    for explanation, weight in shares[1 : MOST + 1]:
        if weight < LEAST:
            continue
        model = refitted(before, data, explanation.pairs)
        if model is not None:
            words = " + ".join(explanation.names)
            out.append(modelfile.snapshot(model, "rival", weight=weight, effect=words))
    return out


def _weights(sets: Sequence[Explanation]) -> list[tuple[Explanation, float]]:
    """The sets with their weights by BIC; the first stays first, the others follow by weight."""
    bic = np.array([e.bic for e in sets])
    weight = np.exp(-0.5 * (bic - bic.min()))
    each = list(zip(sets, (weight / weight.sum()).tolist(), strict=True))
    return [each[0], *sorted(each[1:], key=lambda pair: -pair[1])]


def models(model: Model, effect_files: Sequence[str] = ()) -> list[Model]:
    """The rivals that a model keeps.

    Raises:
        EffectError: a rival uses an effect of the user's own that was not named.
    """
    if model.uncertainty is None:
        return []
    return [modelfile.restore(model, entry, effect_files) for entry in model.uncertainty.rivals]


def words(model: Model) -> str:
    """The rivals in words, '' where there are none."""
    if model.uncertainty is None or not model.uncertainty.rivals:
        return ""
    each = [f"{r.get('effect', 'another')} ({100 * float(r['weight']):.0f} %)" for r in model.uncertainty.rivals]
    return ", ".join(each)
