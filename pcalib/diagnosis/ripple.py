"""Which number of cycles per turn a gear ripple has, where the robot file does not say."""

from __future__ import annotations

import numpy as np

from pcalib import effects
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.screen import NUISANCE, Search, project_out, span
from pcalib.effects.gear_ripple import SCANNED, GearRipple

DRAWS = 256
"""Draws of pure noise on which the search is repeated, to learn what it finds by chance."""
RARE = 0.9
"""Quantile of their best at which independent tries are counted: neighbouring frequencies are nearly one."""


def scanned(point: Point, y: np.ndarray, nuisance: np.ndarray, whiten) -> list[tuple[GearRipple, Search]]:
    """The best ripple of each variant, common and by arm, and what the search costs.

    Args:
        y: (M,) whitened residuals.
        nuisance: (M, n) whitened columns of what the model has.
        whiten: (N, 6, p) columns → (M, p).
    """
    robot = point.model.robot
    U = span(nuisance, NUISANCE)
    noise = np.random.default_rng(0).standard_normal((len(y), DRAWS), dtype=np.float32)
    rest = project_out(y, U)
    draws = project_out(noise, U.astype(np.float32))
    response = point.response().actuator
    q = point.situation.q
    gains: dict[str, list[np.ndarray]] = {"common": [], "arm": []}
    columns = {"common": 2, "arm": 2 * q.shape[1]}
    for n in SCANNED:
        waves = np.concatenate([response * np.sin(n * q)[:, None], response * np.cos(n * q)[:, None]], axis=-1)
        each = project_out(whiten(waves), U)
        half = each.shape[1] // 2
        together = np.stack([each[:, :half].sum(axis=1), each[:, half:].sum(axis=1)], axis=1)
        for per, E in (("common", together), ("arm", each)):
            Q, _ = np.linalg.qr(E)
            by_chance = Q.astype(np.float32).T @ draws
            gains[per].append(np.append(np.sum(by_chance**2, axis=0), np.sum((Q.T @ rest) ** 2)))
    out = []
    for per, gain in gains.items():
        best = SCANNED[int(np.argmax([g[-1] for g in gain]))]
        effect = effects.get("gear_ripple", per, robot, cycles=[best])
        assert isinstance(effect, GearRipple)
        out.append((effect, _search(np.max(gain, axis=0)[:-1], columns[per])))
    return out


def _search(best: np.ndarray, d: int) -> Search:
    """From the best χ²(d) of every draw of pure noise (n,)."""
    from scipy.special import chdtr

    tries = np.log(RARE) / np.log(chdtr(d, np.quantile(best, RARE)))
    return Search(float(max(tries, 1.0)), float(max(np.mean(best) - d, 0.0)))
