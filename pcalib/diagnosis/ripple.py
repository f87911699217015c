"""Which number of cycles per turn a gear ripple has, where the robot file does not say."""

from __future__ import annotations

import numpy as np

from pcalib import effects
from pcalib.diagnosis.channels import Point
from pcalib.diagnosis.screen import NUISANCE, project_out, span
from pcalib.effects.gear_ripple import SCANNED, GearRipple


def scanned(point: Point, y: np.ndarray, nuisance: np.ndarray, whiten) -> list[tuple[GearRipple, int]]:
    """The best ripple of each variant and how many cycles per turn were tried, for the look-elsewhere effect.

    Args:
        y: (M,) whitened residuals.
        nuisance: (M, n) whitened columns of what the model has.
        whiten: (N, 6, p) columns → (M, p).
    """
    robot = point.model.robot
    U = span(nuisance, NUISANCE)
    rest = project_out(y, U)
    response = point.response().actuator
    q = point.situation.q
    out = []
    gains = {"common": [], "arm": []}
    for n in SCANNED:
        waves = np.concatenate([response * np.sin(n * q)[:, None], response * np.cos(n * q)[:, None]], axis=-1)
        columns = project_out(whiten(waves), U)
        half = columns.shape[1] // 2
        together = np.stack([columns[:, :half].sum(axis=1), columns[:, half:].sum(axis=1)], axis=1)
        for per, E in (("common", together), ("arm", columns)):
            Q, _ = np.linalg.qr(E)
            gains[per].append(float(np.sum((Q.T @ rest) ** 2)))
    for per, gain in gains.items():
        best = SCANNED[int(np.argmax(gain))]
        effect = effects.get("gear_ripple", per, robot, cycles=[best])
        assert isinstance(effect, GearRipple)
        out.append((effect, len(SCANNED)))
    return out
