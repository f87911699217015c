"""What data can say about parameters: scaled spectrum, identifiable base, null directions in words, indices.

Everything is measured in units of prior σ / posterior σ (from the data alone): a direction with ratio 1 is known by
the data as well as by the drawing. The threshold 1e-2 has a physical meaning; machine epsilon has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
import scipy.linalg

from pcalib.wording import figure

THRESHOLD = 1e-2
"""prior σ / posterior σ above which a direction counts as identified."""

_TRACE = 1e-3
"""Shares, in prior-scaled units, below which a parameter is no part of a combination."""
_TERMS = 12
"""Terms of a combination that are spelled out."""

PRIOR = {"m": 1e-4, "rad": np.radians(0.05), "1": 1e-3}
"""Nominal manufacturing tolerances, 1σ, by unit: 0.1 mm, 0.05°, 0.1 %."""


def priors(units: Sequence[str]) -> np.ndarray:
    """1σ manufacturing prior of each parameter, by its unit."""
    return np.array([PRIOR[u] for u in units])


@dataclass(frozen=True)
class Identifiability:
    """The spectrum of a design, as seen through prior and noise."""

    names: tuple[str, ...]
    ratio: np.ndarray
    """(nz,) prior σ / posterior σ of each singular direction, descending."""
    factor: np.ndarray
    """(·, nz) triangular factor of the prior-scaled Jacobian, columns in the order of `pivot`."""
    pivot: np.ndarray
    """(nz,) order in which QR takes the parameters: what adds most to those before comes first."""
    prior: np.ndarray
    """(nz,) 1σ of the parameters."""
    units: tuple[str, ...] = ()
    """'m', 'rad' or '1' of each, where they are known: factors between unlike ones are said with theirs."""

    @property
    def n_identified(self) -> int:
        """Directions above the threshold."""
        return int(np.sum(self.ratio > THRESHOLD))

    @cached_property
    def directions(self) -> np.ndarray:
        """(nz, nz) unit directions in prior-scaled parameters, one per column, in the order of `ratio`."""
        out = np.empty((len(self.names),) * 2)
        out[self.pivot] = np.linalg.svd(self.factor)[2].T
        return out

    @cached_property
    def base(self) -> tuple[str, ...]:
        """The identifiable base δk_b: parameters that pivoted QR keeps (paper after eq. 24)."""
        return tuple(self.names[i] for i in self.pivot[: self.n_identified].tolist())

    @cached_property
    def dependent(self) -> dict[str, dict[str, float]]:
        """Each parameter outside the base, and the base parameters whose change by these factors per unit does the
        same."""
        n, order, prior = self.n_identified, self.pivot.tolist(), self.prior
        R = self.factor
        mix = scipy.linalg.solve_triangular(R[:n, :n], R[:n, n:]) if n else np.zeros((0, len(order)))
        out: dict[str, dict[str, float]] = {}
        for column, share in zip(order[n:], mix.T, strict=True):  # in prior-scaled units
            heavy = [i for i in np.argsort(-np.abs(share)).tolist() if abs(share[i]) > _TRACE]
            out[self.names[column]] = {
                self.names[order[i]]: float(share[i] * prior[order[i]] / prior[column]) for i in heavy
            }
        return out

    def companions(self, least: float = 0.1) -> dict[str, tuple[dict[str, float], int]]:
        """For each parameter outside the base, the main part of what it cannot be told from, and how many terms are
        left out: those that come to less than `least` of the largest, each counted in its manufacturing tolerance."""
        prior = dict(zip(self.names, self.prior.tolist(), strict=True))
        out = {}
        for name, mix in self.dependent.items():
            size = {other: abs(value) * prior[name] / prior[other] for other, value in mix.items()}
            main = {o: v for o, v in mix.items() if size[o] >= least * max(size.values())}
            out[name] = (main, len(mix) - len(main))
        return out

    def sentences(self) -> list[str]:
        """The null directions in words."""
        out = []
        for name, mix in self.dependent.items():
            if not mix:
                out.append(f"{name} leaves no trace in these data")
                continue
            terms = [f"{figure(value, 3, '+')}{self._per(other, name)}·{other}" for other, value in mix.items()]
            rest = f" and {len(terms) - _TERMS} lesser terms" if len(terms) > _TERMS else ""
            out.append(f"{name} cannot be told from {' '.join(terms[:_TERMS])}{rest}")
        return out

    def _per(self, other: str, name: str) -> str:
        """Unit of a change of one parameter per change of another; empty between like ones."""
        unit = dict(zip(self.names, self.units, strict=False))
        a, b = unit.get(other), unit.get(name)
        return "" if a == b else f" {a}" if b == "1" else f" {a}/{b}"


def project_out(A: np.ndarray, U: np.ndarray) -> np.ndarray:
    """A (M, …) minus its projection on the span of the orthonormal columns U (M, r)."""
    return A - U @ (U.T @ A)


def span(columns: np.ndarray, threshold: float) -> np.ndarray:
    """Orthonormal basis of the directions with singular value above `threshold`, (M, r)."""
    if columns.shape[1] == 0:
        return columns
    try:
        U, s, _ = np.linalg.svd(columns, full_matrices=False)
    except np.linalg.LinAlgError:  # LAPACK's fast driver fails on a rare matrix that its slow one can do
        from scipy.linalg import svd

        U, s, _ = svd(columns, full_matrices=False, lapack_driver="gesvd")
    return U[:, s > threshold]


def without(J: np.ndarray, nuisance: np.ndarray | None) -> np.ndarray:
    """J (M, n) minus its projection on the column space of the nuisance unknowns (frame, target)."""
    if nuisance is None or nuisance.shape[1] == 0:
        return J
    scale = np.linalg.norm(nuisance, axis=0)
    return project_out(J, span(nuisance / np.where(scale > 0, scale, 1.0), 1e-9))


def analyse(
    J: np.ndarray,
    prior: np.ndarray,
    names: Sequence[str],
    nuisance: np.ndarray | None = None,
    units: Sequence[str] = (),
) -> Identifiability:
    """Spectrum and base of a whitened Jacobian J (M, nz) with 1σ priors (nz,).

    Args:
        J: rows in units of measurement σ.
        nuisance: (M, n) whitened columns of unknowns without prior, projected out first.
        units: 'm', 'rad' or '1' of each parameter, for sentences.
    """
    scaled = without(J, nuisance) * prior
    R, pivot = cast(tuple[np.ndarray, np.ndarray], scipy.linalg.qr(scaled, mode="r", pivoting=True, check_finite=False))
    R = R[: scaled.shape[1]]
    ratio = np.zeros(scaled.shape[1])
    ratio[: len(R)] = np.linalg.svd(R, compute_uv=False)  # those of `scaled` itself
    return Identifiability(tuple(names), ratio, R, pivot, np.asarray(prior, float), tuple(units))
