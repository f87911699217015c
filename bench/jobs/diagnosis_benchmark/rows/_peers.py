"""Other ways to find what is missing, on the columns of the same grammar: what `pcalib propose` is compared with.

    stepwise     forward selection, one column after the other until BIC rises
    lasso        least squares with an L1 penalty, whose weight BIC chooses
    thresholded  sequentially thresholded least squares, as SINDy does
    process      a Gaussian process on the residuals: it predicts, and names nothing
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pcalib.data.measurement import Measurements
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.screen import NUISANCE, project_out, span
from pcalib.fitting.linearisation import residuals
from pcalib.laws.grammar import at_places, laws
from pcalib.model import Model

MOST = 12
"""Columns that a forward selection takes at most."""
START = 200
"""Columns, those most correlated with the residuals, with which thresholding begins: more than readings have no fit."""
THRESHOLD = 3.0
"""Noise units below which thresholding drops a column."""


@dataclass(frozen=True)
class Columns:
    """Every function of the grammar at every single place."""

    values: np.ndarray
    """(M, C) float32 of norm one, outside of what geometry takes up."""
    y: np.ndarray
    """(M,) residuals, noise units."""
    channel: np.ndarray
    """(C,) names."""
    variables: tuple[frozenset[str], ...]
    """(C,)."""

    @classmethod
    def of(cls, made: Problem) -> Columns:
        """Return the columns of a problem."""
        U, at = span(made.nuisance, NUISANCE).astype(np.float32), made.point.situation
        values, channels, variables = [], [], []
        for channel, places, terms in laws(at):
            ones = [np.broadcast_to(row, (len(at), len(places))) for row in np.eye(len(places))]
            response = made.whitened(made.point.columns([channel.contribution(at, one) for one in ones]))
            for term in terms:
                for f in at_places(term, channel, at):
                    values.append((response * np.broadcast_to(f, (len(at), len(places)))[made.row]).astype(np.float32))
                    channels += [channel.name] * len(places)
                    variables += [frozenset(s.variable.name for s in term.variables)] * len(places)
        flat = np.hstack(values)
        flat -= U @ (U.T @ flat)
        size = np.linalg.norm(flat, axis=0)
        seen = np.flatnonzero(size > 1e-3 * size.max())
        kept = tuple(variables[i] for i in seen)
        return cls(flat[:, seen] / size[seen], project_out(made.y, U.astype(float)), np.array(channels)[seen], kept)


def stepwise(X: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return columns in the order in which they were taken."""
    chosen: list[int] = []
    rest, best = y, float(y @ y)
    while len(chosen) < MOST:
        column = int(np.argmax(np.abs(X.T @ rest)))
        some = [*chosen, column]
        rest = y - X[:, some] @ np.linalg.lstsq(X[:, some], y, rcond=1e-8)[0]
        score = float(rest @ rest) + len(some) * np.log(len(y))
        if score >= best or column in chosen:
            break
        chosen, best = some, score
    return np.array(chosen, int)


def lasso(X: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return columns with a coefficient, the largest first, at the weight of smallest BIC."""
    largest = float(np.abs(X.T @ y).max())
    active, theta = np.zeros(0, int), np.zeros(0)
    best, chosen = float(y @ y), np.zeros(0, int)
    for weight in largest * 0.8 ** np.arange(1, 12):
        for _ in range(4):
            rest = y - X[:, active] @ theta
            new = np.setdiff1d(np.flatnonzero(np.abs(X.T @ rest) > weight * (1 + 1e-6)), active)
            if not len(new):
                break
            new = new[np.argsort(-np.abs(X[:, new].T @ rest))[:50]]
            active, theta = np.concatenate([active, new]), np.concatenate([theta, np.zeros(len(new))])
            A = X[:, active].astype(float)
            G, b = A.T @ A, A.T @ y
            for _ in range(30):  # coordinate descent
                for i in range(len(theta)):
                    pull = b[i] - G[i] @ theta + theta[i]
                    theta[i] = np.sign(pull) * max(abs(pull) - weight, 0.0)
        used = theta != 0
        active, theta = active[used], theta[used]
        fit = y - X[:, active] @ np.linalg.lstsq(X[:, active], y, rcond=1e-6)[0]
        score = float(fit @ fit) + len(active) * np.log(len(y))
        if score < best:
            best, chosen = score, active[np.argsort(-np.abs(theta))]
        if len(active) > START:
            break
    return chosen


def thresholded(X: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return columns that stay, the largest coefficient first."""
    chosen = np.argsort(-np.abs(X.T @ y))[:START]
    theta = np.zeros(0)
    for _ in range(20):
        A = X[:, chosen].astype(float)
        theta = np.linalg.solve(A.T @ A + 0.05 * np.eye(len(chosen)), A.T @ y)
        large = np.abs(theta) > THRESHOLD
        if large.all():
            break
        chosen, theta = chosen[large], theta[large]
        if not len(chosen):
            break
    return chosen[np.argsort(-np.abs(theta))]


NAMING: Mapping[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "stepwise": stepwise, "lasso": lasso, "thresholded": thresholded,
}  # fmt: skip
"""Those that name columns."""


def process(model: Model, data: Measurements, sigma_pos: float) -> float:
    """Return the held-out RMS position error over the noise, once a Gaussian process has predicted the residuals.

    Its kernel is a squared exponential in all that was recorded, scaled to unit variance; length and amplitude are
    those of largest likelihood on a grid.
    """
    error = residuals(model, data)[0][:, :3]
    inputs = np.column_stack([data.q, data.payload, data.tool, *data.columns.values()])
    inputs = inputs[:, np.ptp(inputs, axis=0) > 0]
    inputs = (inputs - inputs.mean(axis=0)) / inputs.std(axis=0)
    square = np.sum((inputs[:, None] - inputs) ** 2, axis=-1)
    fit, held = np.flatnonzero(~data.check), np.flatnonzero(data.check)
    e = error[fit] / sigma_pos
    best, mean = np.inf, np.zeros((len(held), 3))
    for length in (1.0, 2.0, 4.0, 8.0):
        for amplitude in (0.3, 1.0, 3.0, 10.0):
            K = amplitude**2 * np.exp(-0.5 * square / length**2)
            root = np.linalg.cholesky(K[np.ix_(fit, fit)] + np.eye(len(fit)))
            z = np.linalg.solve(root, e)
            score = float(np.sum(z**2)) + 6 * float(np.sum(np.log(np.diagonal(root))))
            if score < best:
                best, mean = score, K[np.ix_(held, fit)] @ np.linalg.solve(root.T, z)
    return float(np.sqrt(np.nanmean((error[held] / sigma_pos - mean) ** 2)))
