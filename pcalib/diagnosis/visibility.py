"""What of every effect a fitted geometry leaves visible, before anything is said to be missing."""

from __future__ import annotations

from collections.abc import Sequence

from pcalib.data.measurement import Measurements
from pcalib.diagnosis.problem import problem
from pcalib.effects.base import Effect
from pcalib.model import Model

FAINT = 0.05
"""κ below which an effect hides almost wholly in the geometry."""


def visibility(model: Model, data: Measurements, own: Sequence[Effect] = ()) -> dict[str, float]:
    """κ of every effect in its simplest variant: the share of its signal that the geometry cannot take up.

    Effects that these poses cannot show at their largest possible size have 0.
    """
    made = problem(model, data, own, all_rows=True)
    screen = made.screen(n_draws=2)
    out: dict[str, float] = {}
    for g, c in enumerate(made.candidates):
        if c.effect is not None and c.name not in out:
            out[c.name] = screen.kappa(g) if screen.visible[g] else 0.0
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def sentence(shares: dict[str, float]) -> str:
    """The shares in words."""
    clear = [f"{name} {100 * k:.0f} %" for name, k in shares.items() if k >= FAINT]
    faint = [name for name, k in shares.items() if k < FAINT]
    text = f"Of effects the geometry leaves visible: {', '.join(clear)}" if clear else "The geometry hides every effect"
    return text + (f"; under {100 * FAINT:.0f} %: {', '.join(faint)}." if faint else ".")
