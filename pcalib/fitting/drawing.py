"""How far measurements are from a robot as drawn: a quick fit of a few rows, with priors as wide as parts go wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.errors import InputError, PcalibError
from pcalib.fitting import least_squares
from pcalib.fitting.identifiability import PRIOR
from pcalib.fitting.linearisation import body_turned, linearise, residuals, seen_from
from pcalib.fitting.minimisation import Task, minimise
from pcalib.fitting.unknowns import Unknowns, current, unknowns_of
from pcalib.model import Model
from pcalib.prediction import Prediction
from pcalib.robot import Robot

ROWS = 40
"""Rows of a quick fit: enough for every parameter of a kind to count, few enough for a hundred fits in a second."""
_EACH = 8
"""Rows of each station or surface: its place has three unknowns, and the others must tell whether they are right."""
WIDTH = 6.0
"""Priors of a quick fit in manufacturing tolerances (0.1 mm, 0.05°, 0.1 %): 1σ of errors spread evenly up to 1 mm and
0.5°, as machines that were put together without care have them."""
STEPS = 6
"""Steps of a quick fit: from such errors Gauss–Newton needs three or four."""
PATIENT = 60
"""Steps of a quick fit that decides whether anything is wrong: from a body that seems turned against the plate, the
first steps may have to be damped."""
REACHED = 0.8
"""Share of commands that the robot must be able to take."""
FAR = 20.0
"""Manufacturing tolerances (2 mm, 1°, 2 %) from which on a parameter is far from the drawing: twice the errors that a
robot put together without care has."""
LEFT = 1e-3
"""[m] and"""
LEFT_TURN = np.radians(1.0)
"""[rad] residuals from which on data are far from the drawing too: physics that geometry cannot take up leaves less
on any machine that is worth a calibration."""
ALIKE = 12.0
"""Difference of cost up to which two explanations explain the data alike: a likelihood ratio of 400."""
_SEARCH = 25
"""Steps of a search for numbers: from a rod 200 mm too long it takes twelve."""
_NEXT = 1e-6
"""[m, rad, 1] step of the differences by a number: rounding and curvature are both far below the noise there."""
_SETTLED = 1e-5
"""Share of the longest step below which a search has arrived."""
_STRIDE = {"m": 0.04, "rad": 0.2, "1": 0.3}
"""[m, rad, 1] longest step of a number: what the geometry's linear approximation bears."""


@dataclass(frozen=True)
class DrawingDistance:
    """How far data are from a robot as drawn, after a quick fit."""

    misfit: float
    """Σ (residual/σ)² of what the fit leaves."""
    prior: float
    """Σ (change/width)² of the changes of parameters that the fit needed."""
    readings: int
    parameters: int
    """Number of parameters that the fit could change."""
    tolerances: float
    """Largest change of a parameter, in manufacturing tolerances."""
    rms_pos: float
    """[m] RMS of what the fit leaves of positions, per component; NaN without any."""
    rms_rot: float
    """[rad] RMS of what the fit leaves of rotations, per component; NaN without any."""
    ratio_pos: float
    """RMS of the residuals of positions over their σ; NaN without any."""
    ratio_rot: float
    """RMS of the residuals of rotations over their σ; NaN without any."""

    @property
    def cost(self) -> float:
        """The cost by which readings of the columns are compared: −2 log of the posterior, up to a constant."""
        return self.misfit + self.prior

    @property
    def fits(self) -> bool:
        """Whether nothing large is left, however far parameters had to go."""
        return not (self.rms_pos > LEFT or self.rms_rot > LEFT_TURN)

    @property
    def near(self) -> bool:
        """Whether no parameter has to go far from the drawing, and nothing large is left."""
        return self.tolerances < FAR and self.fits


def some_rows(data: Measurements, most: int = ROWS) -> Measurements:
    """Some of the fitted rows that hold a measurement: evenly spaced, and of every station or surface at least _EACH.

    Stations often take turns. Rows that are evenly spaced in the file might all belong to one of them.
    """
    rows = np.flatnonzero(~data.check & data.mask.any(axis=1))
    data = replace(data, correlation=None, instrument=None)  # far off, it matters little how readings go together
    sensed = [] if data.readings is None else [np.intersect1d(rows, part) for *_, part in data.readings.parts]
    posed = np.setdiff1d(rows, np.concatenate(sensed)) if sensed else rows
    share = most / max(len(rows), 1)
    picked = [spaced(posed, round(share * len(posed)))]
    picked += [spaced(part, max(round(share * len(part)), _EACH)) for part in sensed]
    return data.take(data.whole(np.sort(np.concatenate(picked))))


def spaced(rows: np.ndarray, most: int) -> np.ndarray:
    """At most that many of the rows, evenly spaced."""
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), most)).astype(int)]


def distance(data: Measurements, robot: Robot, steps: int = STEPS) -> DrawingDistance | None:
    """A quick fit; None where the robot cannot take the commands or a tracker's frame cannot be registered."""
    try:
        model, data, at = _start(data, robot)
        unknowns = _unknowns(model, data)
        every = np.arange(len(unknowns.names))
        state = minimise(Task(data, Noise.of(data), unknowns, every, "linear", 1.0, steps), model, at)
    except (PcalibError, np.linalg.LinAlgError):
        return None
    g = unknowns.n_geometry
    change = current(state.model, unknowns)[:g] / unknowns.prior[:g]
    error = state.at[0]
    whitened = np.where(data.mask, error / data.sigma, np.nan)
    if not np.isfinite(whitened[data.mask]).all():
        return None

    def rms(values: np.ndarray) -> float:
        seen = values[~np.isnan(values)]
        return float(np.sqrt(np.mean(seen**2))) if len(seen) else float("nan")

    return DrawingDistance(
        misfit=float(np.nansum(whitened**2)), prior=float(change @ change), readings=int(data.mask.sum()),
        parameters=g, tolerances=float(WIDTH * np.abs(change).max(initial=0.0)),
        rms_pos=rms(error[:, :3]), rms_rot=rms(error[:, 3:]),
        ratio_pos=rms(whitened[:, :3]), ratio_rot=rms(whitened[:, 3:]),
    )  # fmt: skip


Change = Callable[[Measurements, Robot, np.ndarray], tuple[Measurements, Robot]]
"""Measurements and robot with some numbers changed by so much."""


def search(data: Measurements, robot: Robot, numbers: tuple[str, ...], change: Change) -> np.ndarray | None:
    """Numbers (n,) of file or robot for which the data fit the drawing best, all geometry being free beside them.

    Args:
        numbers: 'm', 'rad' or '1': what each number counts.

    Returns:
        The changes; None where the search leads nowhere.
    """
    stride = np.array([_STRIDE[unit] for unit in numbers])
    n = len(numbers)
    alpha = np.zeros(n)
    data = replace(data, lines=np.arange(len(data)))  # so that rows are known again after some were left out
    try:
        for _ in range(_SEARCH):
            model, rows, at = _start(*change(data, robot, alpha))
            unknowns = _unknowns(model, rows)
            linear = linearise(model, rows, unknowns, at)
            slopes = np.empty((len(linear.residual), n))
            for j in range(n):
                beside, robot_beside = change(data, robot, alpha + _NEXT * (np.arange(n) == j))
                there = replace(model, robot=robot_beside, k=robot_beside.mechanism.nominal)
                error = residuals(there, beside.take(np.isin(beside.lines, rows.lines)), at[1].pose)[0]
                moved = error[linear.row, linear.component] / rows.sigma[linear.row, linear.component]
                slopes[:, j] = (linear.residual - moved) / _NEXT
            free = np.append(unknowns.prior, np.full(n, np.inf))
            whole = least_squares.triangle(np.hstack([linear.jacobian, slopes]), linear.residual)
            step = least_squares.solve(whole, np.zeros(len(free)), free)[0][-n:]
            if not np.isfinite(step).all():
                return None
            step = step / max(1.0, float(np.max(np.abs(step) / stride)))
            alpha = alpha + step
            if np.all(np.abs(step) < _SETTLED * stride):
                break
    except (PcalibError, np.linalg.LinAlgError):
        return None
    return alpha


def start(data: Measurements, robot: Robot) -> tuple[Model, Measurements, tuple[np.ndarray, Prediction]] | None:
    """The robot as drawn in the frame of the data, the rows that it can take, and residuals; None: no such rows."""
    try:
        return _start(data, robot)
    except PcalibError:
        return None


def _start(data: Measurements, robot: Robot) -> tuple[Model, Measurements, tuple[np.ndarray, Prediction]]:
    """The robot as drawn in the frame of the data, the rows that it can take, and their residuals.

    Raises:
        InputError: too few rows are left, or a tracker's frame cannot be registered.
    """
    model = seen_from(Model.nominal(robot), data)
    model = body_turned(model, data) or model
    at = residuals(model, data)
    reached = at[1].reached
    if reached.mean() < REACHED:
        raise InputError("the robot as drawn cannot take these commands", file=data.source)
    if not reached.all():
        data = data.take(reached)
        at = residuals(model, data)
    return model, data, at


def _unknowns(model: Model, data: Measurements) -> Unknowns:
    widths = {unit: WIDTH * tolerance for unit, tolerance in PRIOR.items()}
    return unknowns_of(model, "complete", frame=data.frame == "tracker", prior=widths)
