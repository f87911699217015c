"""Where a robot stood still in a continuous recording, and what was read there on average."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcalib.errors import InputError
from pcalib.recordings import Recording

STILL = 5.0
"""Times the median step between samples of the stillest half, from which on the robot moves."""
SHORTEST = 0.3
"""[s] Shortest stop that counts."""
STANDS = 2e-3
"""[m] Largest extent of a stop; settling and noise stay below it."""
_MARGIN = 0.2
"""Share of a stop at either end that is left out: the robot settles."""


def dwells(recording: Recording) -> Recording:
    """One reading for each stop: means over the middle of it, time of its middle. Single readings stay as they are.

    Raises:
        InputError: no stop is found.
    """
    if recording.time is None:
        return recording
    t, x = recording.time, recording.position
    window = max(1, round(0.1 / max(float(np.median(np.diff(t))), 1e-6))) if len(t) > 1 else 1
    moved = np.full(len(t), np.inf)
    if len(t) > 2 * window:
        step = np.linalg.norm(x[window:] - x[:-window], axis=1)
        moved = np.concatenate([np.full(window - window // 2, step[0]), step, np.full(window // 2, step[-1])])
    quiet = float(np.median(np.sort(moved)[: max(len(moved) // 2, 1)]))
    still = moved <= max(STILL * quiet, 1e-9)
    edge = np.flatnonzero(np.diff(np.r_[False, still, False].astype(int)))
    stops = [
        (a, b) for a, b in edge.reshape(-1, 2)
        if t[b - 1] - t[a] >= SHORTEST and np.ptp(x[a:b], axis=0).max() < STANDS
    ]  # fmt: skip
    if not stops:
        raise InputError(
            f"the robot stands still nowhere for {SHORTEST:g} s", file=recording.source,
            remedy="let it wait a second at every pose",
        )  # fmt: skip
    position, rotation, middle, lines, scatter = [], [], [], [], []
    for a, b in stops:
        trim = int(_MARGIN * (b - a))
        part = slice(a + trim, max(b - trim, a + trim + 1))
        position.append(x[part].mean(axis=0))
        rotation.append(_mean(recording.rotation[part]))
        middle.append(0.5 * (t[a] + t[b - 1]))
        lines.append(recording.lines[(a + b) // 2])
        scatter.append(x[part].std(axis=0).mean())
    note = f"{len(stops)} stops, at which readings scatter by {1e6 * float(np.median(scatter)):.2g} µm"
    return replace(
        recording, position=np.array(position), rotation=np.array(rotation), lines=np.array(lines),
        time=np.array(middle), notes=(*recording.notes, note),
    )  # fmt: skip


def _mean(R: np.ndarray) -> np.ndarray:
    """The rotation nearest to the mean of rotations (n, 3, 3); NaN where they are not measured."""
    if np.isnan(R).any():
        return np.full((3, 3), np.nan)
    U, _, Vt = np.linalg.svd(R.mean(axis=0))
    return U @ Vt
