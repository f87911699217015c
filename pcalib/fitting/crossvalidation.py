"""Cross-validation: every pose predicted by a fit that never saw it.

Rows go to the folds in turn, those of one command or one `pose_id` to the same fold. The result is the error at
held-out poses, also as apparent rod-length errors, which say at which rods model and measurement disagree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcalib import rotation
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError
from pcalib.fitting import identification
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Model
from pcalib.prediction import Prediction
from pcalib.robot import Robot


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Errors at held-out poses."""

    folds: int
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad], NaN where not measured."""
    rod: np.ndarray
    """(N, m) [m] apparent rod-length errors; NaN in rows that are no full pose."""
    spread: np.ndarray
    """(nz,) standard deviation of each unknown over the folds [its unit]."""
    names: tuple[str, ...]
    """(nz,) names of the unknowns."""

    @property
    def rms_pos(self) -> float:
        """[m] root of the mean squared position error."""
        return rms(self.error[:, :3])

    @property
    def rms_rot(self) -> float:
        """[rad], NaN without rotations."""
        return rms(self.error[:, 3:])

    @property
    def max_pos(self) -> float:
        """[m] largest position error."""
        length = np.sqrt(np.nansum(self.error[:, :3] ** 2, axis=1))
        return float(length.max(initial=0.0))

    @property
    def rms_rod(self) -> float:
        """[m] root mean square over rods and poses, NaN without full poses."""
        seen = self.rod[~np.isnan(self.rod)]
        return float(np.sqrt(np.mean(seen**2))) if seen.size else float("nan")

    def json(self) -> dict[str, Any]:
        """Stable keys, as `pcalib fit --folds` writes them."""
        values = {
            "rms_pos_um": self.rms_pos, "max_pos_um": self.max_pos, "rms_rot_urad": self.rms_rot,
            "rms_rod_um": self.rms_rod,
        }  # fmt: skip
        return {"folds": self.folds, **{k: v * 1e6 if np.isfinite(v) else None for k, v in values.items()}}


def rms(error: np.ndarray) -> float:
    """Root mean square length of errors (N, 3), over the rows that have any."""
    some = ~np.isnan(error).all(axis=1)
    return float(np.sqrt(np.mean(np.nansum(error[some] ** 2, axis=1)))) if some.any() else float("nan")


def require_folds(data: Measurements, folds: int) -> np.ndarray:
    """(N,) which fold holds a row out; −1 on rows that are `set = check`.

    Raises:
        InputError: fewer than two folds, or more than there are commands.
    """
    group = _groups(data)
    count = int(group.max(initial=-1)) + 1
    if not 2 <= folds <= count:
        raise InputError(f"{folds} folds of {count} commands", file=data.source, remedy=f"choose 2 to {count} folds")
    fold = np.where(group >= 0, group % folds, -1)
    if data.readings is not None and data.readings.origin is not None:  # both ends of a distance stay together
        far = np.flatnonzero(data.readings.origin >= 0)
        fold[data.readings.origin[far]] = fold[far]
    return fold


def cross_validate(
    data: Measurements,
    robot: Robot | Model,
    level: str = "complete",
    folds: int = 6,
    tick: Callable[[], None] | None = None,
    **options: Any,
) -> CrossValidation:
    """Fit as often as there are folds, each time without one of them, and predict that one.

    Args:
        folds: at least 2, at most the number of distinct commands.
        tick: called after every fold, for a progress bar.
        options: of :func:`pcalib.fitting.identification.fit`.

    Raises:
        InputError: fewer commands than folds, or a fold whose fit the rest of the data cannot support.
        FitError: a fold's fit is not usable.
    """
    fold = require_folds(data, folds)
    error = np.full((len(data), 6), np.nan)
    rod: np.ndarray | None = None
    estimates, names = [], ()
    for f in range(folds):
        rest = data.take((fold >= 0) & (fold != f))
        found = identification.fit(rest, robot, level, suspect=f == 0, **options)
        held = data.take(fold == f)
        error[fold == f], p = identification.residuals(found.model, held)
        rods = rod_errors(found.model, error[fold == f], p)
        rod = np.full((len(data), rods.shape[1]), np.nan) if rod is None else rod
        rod[fold == f] = rods
        estimates.append(found.estimate)
        names = found.unknowns.names
        if tick:
            tick()
    assert rod is not None
    return CrossValidation(folds, error, rod, np.std(estimates, axis=0), names)


def _groups(data: Measurements) -> np.ndarray:
    """(N,) a running number for what is held out together; rows that are held out by the user have −1.

    Rows of one command go together, with a `pose_id` or without, and so do rows of one `pose_id`.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    group, rows = np.full(len(data), -1), data.fit_rows
    mark, one = data.pose_id[rows], np.arange(len(rows))
    command = _first(np.column_stack([np.round(data.q[rows], 12), data.tool[rows]]))
    named = np.where(mark >= 0, _first(mark[:, None]), one)
    links = coo_array((np.ones(2 * len(one)), (np.tile(one, 2), np.append(command, named))), (len(one), len(one)))
    part = connected_components(links, directed=False)[1]
    group[rows] = np.unique(_first(part[:, None]), return_inverse=True)[1]
    return group


def _first(values: np.ndarray) -> np.ndarray:
    """(N,) the first row that is like each row of values (N, n)."""
    _, first, like = np.unique(values, axis=0, return_index=True, return_inverse=True)
    return first[like.ravel()]


def rod_errors(model: Model, error: np.ndarray, p: Prediction) -> np.ndarray:
    """Closure at the measured poses, (N, m) [m]: by how much each rod seems too short; NaN where no full pose was seen.

    Args:
        error: (N, 6) measured − predicted in the measuring frame, and
        p: the prediction, as :func:`pcalib.fitting.identification.residuals` gives them.
    """
    mechanism = model.robot.mechanism
    turn = np.eye(3) if model.frame is None else model.frame.rotation
    full = ~np.isnan(error).any(axis=1)
    d = np.nan_to_num(error)
    R = rotation.exp(d[:, 3:] @ turn) @ p.pose.R
    tcp = p.pose.tcp(p.tool) + d[:, :3] @ turn
    pose = Pose(tcp - (R @ p.tool[..., None])[..., 0], R, p.pose.phi)
    at = kinematics.closure(mechanism, model.k, p.q, pose, deviation=p.deviation)
    f = at.f.copy()
    if mechanism.hinges:  # their angles are not measured: what they can take up is no error of a rod
        J = kinematics.jacobian_state(mechanism, at, pose)[..., len(mechanism.plate_dofs) :]
        f = f - (J @ np.linalg.pinv(J) @ f[..., None])[..., 0]
    f[~full] = np.nan
    return f
