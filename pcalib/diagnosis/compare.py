"""Where a model and measurements differ: how much in units of noise, at which poses, in which channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcalib.data import readings as sensed
from pcalib.data.measurement import Measurements
from pcalib.data.noise import Noise
from pcalib.diagnosis import adequacy
from pcalib.diagnosis.patterns import Cell, cells
from pcalib.diagnosis.problem import Problem, problem
from pcalib.diagnosis.scatters import Scatter, scatter
from pcalib.diagnosis.screen import Misfit, misfit
from pcalib.effects.base import Effect
from pcalib.errors import InputError, unknown
from pcalib.fitting import linearisation
from pcalib.fitting.identification import Accuracy, accuracy
from pcalib.fitting.noise_level import NoiseLevel
from pcalib.model import Model
from pcalib.shown import Shown

N_DRAWS = 1024


@dataclass(frozen=True)
class FarRow:
    """One pose at which model and measurement are far apart."""

    index: int
    line: int
    error: np.ndarray
    """(6,) measured − predicted [m, rad], measuring frame; NaN where not measured."""
    times_noise: float
    """RMS over its readings, in units of the noise."""
    check: bool
    outlier: bool
    """Whether the row fits neither the model nor any pattern, so that a diagnosis sets it aside."""


@dataclass(frozen=True)
class Comparison(Shown):
    """A model against measurements."""

    fit: Accuracy
    check: Accuracy | None
    noise: NoiseLevel
    misfit: Misfit
    times_noise: tuple[float, float | None]
    """RMS of all readings over the noise: of fit rows, those set aside included, and of check rows. What a new fit
    would leave of it stands in `misfit`."""
    worst: tuple[FarRow, ...]
    """Worst first."""
    cells: tuple[Cell, ...]
    """Map of channels × variables, hottest first."""
    error: np.ndarray
    """(N, 6) measured − predicted [m, rad]."""
    position: np.ndarray
    """(N, 3) [m] predicted position of the measured point, measuring frame."""
    problem: Problem
    set_up_anew: float | None = None
    """[m] RMS of positions in the frame of a tracker that was set up anew; None where it stands where it stood."""


def residual_columns(found: Comparison, data: Measurements) -> dict[str, np.ndarray | list[str]]:
    """A row a pose: where it stands, its residuals by component, and the same in units of the noise."""
    unit, factor = ("deg", np.degrees(1.0)) if data.actuator_dimension == "angle" else ("mm", 1e3)
    out: dict[str, np.ndarray | list[str]] = {"line": data.lines, "set": ["check" if c else "fit" for c in data.check]}
    out |= {f"{name}_{unit}": factor * q for name, q in zip(data.actuators, data.q.T, strict=True)}
    out |= {f"predicted_{axis}_mm": 1e3 * v for axis, v in zip("xyz", found.position.T, strict=True)}
    axes = (*(f"{axis}_um" for axis in "xyz"), *(f"r{axis}_urad" for axis in "xyz"))
    if data.readings is not None:
        out |= sensed.to_measure(data.readings)
    out |= {f"residual_{name}": 1e6 * v for name, v in zip(axes, found.error.T, strict=True)}
    whitened = found.error / noise_of(found.problem, data)
    out |= {f"residual_{name.partition('_')[0]}_sigmas": v for name, v in zip(axes, whitened.T, strict=True)}
    seen = np.isfinite(whitened)
    mean = np.nansum(whitened**2, axis=1) / np.maximum(seen.sum(axis=1), 1)
    return out | {"times_noise": np.where(seen.any(axis=1), np.sqrt(mean), np.nan)}


def compare(
    model: Model, data: Measurements, own: Sequence[Effect] = (), n_worst: int = 5, n_draws: int = N_DRAWS
) -> Comparison:
    """Where a model and data differ.

    Args:
        data: all rows; those of ``set = check`` are judged apart.
        own: the user's own effects, which take part in judging the noise.
        n_worst: how many of the worst rows to name.
    """
    made = problem(model, data, own)
    error, p = linearisation.residuals(made.model, data)
    moved = linearisation.set_up_anew(made.model, data)
    anew = None
    if moved is not None:
        anew = float(np.sqrt(3 * np.nanmean(linearisation.residuals(moved, data)[0][:, :3] ** 2)))
    screen = made.screen(n_draws)
    test = adequacy.p_values(screen)
    null = adequacy.null_distribution(screen)
    sigma = noise_of(made, data)
    size = np.sqrt(np.nanmean((error / sigma) ** 2, axis=1))
    order = [int(i) for i in np.argsort(-np.nan_to_num(size))[:n_worst]]
    odd = set(made.rows[made.set_aside].tolist())

    def judged(rows: np.ndarray) -> tuple[Accuracy, float] | None:
        if not rows.any():
            return None
        found = accuracy(error[rows], Noise(data.mask[rows], sigma[rows]), 0.0)
        return found, float(np.sqrt(np.nanmean((error[rows] / sigma[rows]) ** 2)))

    fit, check = judged(~data.check), judged(data.check)
    assert fit is not None
    return Comparison(
        fit=fit[0],
        check=check[0] if check else None,
        noise=made.noise,
        misfit=misfit(screen),
        times_noise=(fit[1], check[1] if check else None),
        worst=tuple(
            FarRow(i, int(data.lines[i]), error[i], float(size[i]), bool(data.check[i]), i in odd) for i in order
        ),
        cells=cells(made.patterns, len(made.candidates), screen, test.p, null),
        error=error,
        position=p.position,
        problem=made,
        set_up_anew=anew,
    )


def points_of(found: Comparison, cell: str) -> Scatter:
    """The points of a cell of the map, by its name 'channel:variable'.

    Raises:
        InputError: the map has no such cell, or no reading tells that channel by itself.
    """
    names = [f"{c.channel}:{c.variable}" for c in found.cells]
    if cell not in names:
        raise InputError(unknown("cell of the map", cell, names), remedy="name one as 'channel:variable'")
    made = found.problem
    kept = np.delete(made.rows, made.set_aside)
    drawn = scatter(made, found.error[kept], *cell.split(":", 1))
    if drawn is None:
        raise InputError(f"{cell} cannot be drawn: no reading tells it from others by itself")
    return drawn


def noise_of(made: Problem, data: Measurements) -> np.ndarray:
    """(N, 6) [m, rad] 1σ of every reading at the noise level of a problem, with joints and lever on average."""
    level = made.noise
    sigma = data.sigma * np.repeat(level.ratio, 3)
    if level.joints or level.lever:
        mean = np.array([level.sigma_pos, level.sigma_rot]) ** 2
        plain = np.array([np.mean(sigma[:, :3] ** 2), np.mean(sigma[:, 3:] ** 2)])
        more = np.nan_to_num(np.maximum(mean - plain, 0.0))
        sigma = np.sqrt(sigma**2 + np.repeat(more, 3))
    return sigma
