"""Sessions of one robot over time: what changed in each, and how far the robot lands from where the model says.

Alarms are held at their rate over the whole history: with n sessions each is judged at a chance of 5 %/n (Bonferroni).
That costs little: a rod that changed by 30 µm is found by one check of 12 poses among 52.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from pcalib import prediction
from pcalib.changes.results import Changes
from pcalib.changes.search import changes
from pcalib.changes.session import FRAME_PRIOR
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.adequacy import ALPHA
from pcalib.fitting import linearisation
from pcalib.model import Model

_IN_NAME = re.compile(r"(?<!\d)(\d{4})-?(\d{2})-?(\d{2})(?!\d)")


@dataclass(frozen=True)
class Visit:
    """One session of a history."""

    path: Path
    when: date | None
    """None where neither the file nor its name says it."""
    found: Changes
    landing: float
    """[m] RMS distance of the measured positions from the model's, the measuring frame allowed for."""

    @property
    def label(self) -> str:
        """The date of the session, else the name of its file."""
        return self.path.stem if self.when is None else self.when.isoformat()


def history(
    model: Model, sessions: Sequence[tuple[Path, Measurements]], same_setup: bool = False, seed: int = 0
) -> list[Visit]:
    """What changed in every session since that of the model, the earliest first if all have a date.

    Args:
        sessions: files and what stands in them.
    """
    dated = [(when(path, data), path, data) for path, data in sessions]
    if all(day is not None for day, _, _ in dated):
        dated.sort(key=lambda one: one[0] or date.min)
    level = ALPHA / len(dated)
    visits = []
    for day, path, data in dated:
        found = changes(model, data, same_setup, level, seed=seed)
        visits.append(Visit(path, day, found, _landing(found)))
    return visits


def when(path: Path, data: Measurements) -> date | None:
    """The date of a session: `# date = 2026-06-01` in the file, else the date in its name."""
    if data.date is not None:
        return data.date
    for year, month, day in _IN_NAME.findall(path.stem):
        try:
            return date(int(year), int(month), int(day))
        except ValueError:
            continue
    return None


def _landing(found: Changes) -> float:
    new = found.session
    error, p = linearisation.residuals(new.model, new.data)
    error = np.nan_to_num(error)
    if len(found.frame):
        free = prediction.frame_columns(new.model, p, offset=new.data.frame == "tracker")
        columns = new.noise.whiten(free * FRAME_PRIOR[: free.shape[-1]])
        size = np.linalg.lstsq(columns, new.noise.whiten(error[..., None])[:, 0], rcond=1e-10)[0]
        error = error - np.nan_to_num(free) @ (size * FRAME_PRIOR[: free.shape[-1]])
    seen = new.data.mask[:, :3]
    rows = seen.any(axis=1)
    return float(np.sqrt(np.mean(np.sum((error[:, :3] * seen)[rows] ** 2, axis=1)))) if rows.any() else float("nan")
