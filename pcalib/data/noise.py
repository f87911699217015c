"""The noise of the readings: its covariance at every row, and the whitening that fits and diagnoses begin with.

A row reads up to six scalars, x y z [m] and rx ry rz [rad], with covariance Σ (6, 6). Whitening multiplies by W with
W·Σ·Wᵀ = I, the inverse Cholesky factor of the measured part of Σ, so that least squares on whitened residuals is the
maximum-likelihood estimate. Where a row's readings are independent, W divides by their σ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcalib.data.measurement import Measurements


@dataclass(frozen=True, eq=False)
class Noise:
    """Covariance of the readings of N rows; rows are independent of each other."""

    measured: np.ndarray
    """(N, 6) bool, which readings there are."""
    sigma: np.ndarray
    """(N, 6) [m, rad] 1σ of every reading, joint repeatability included."""
    covariance: np.ndarray | None = None
    """(N, 6, 6) [m, rad]; None where the readings of a row are independent."""

    @classmethod
    def of(cls, data: Measurements) -> Noise:
        """The noise that a file states, or the default where it states none."""
        return cls(data.mask, data.sigma, data.covariance)

    def __len__(self) -> int:
        return len(self.sigma)

    def take(self, rows: np.ndarray | slice) -> Noise:
        """The noise of some rows: a mask, indices or a slice."""
        whole = self.covariance
        return Noise(self.measured[rows], self.sigma[rows], None if whole is None else whole[rows])

    def at(self, rows: np.ndarray, other: Noise) -> Noise:
        """The noise with that of some rows, a mask (N,), replaced by `other`, which is of these rows."""
        sigma, measured = self.sigma.copy(), self.measured.copy()
        sigma[rows], measured[rows] = other.sigma, other.measured
        if self.covariance is None and other.covariance is None:
            return Noise(measured, sigma)
        whole = self._full().copy()
        whole[rows] = other._full()
        return Noise(measured, sigma, whole)

    def _full(self) -> np.ndarray:
        return self.sigma[:, :, None] ** 2 * np.eye(6) if self.covariance is None else self.covariance

    def scaled(self, ratio: np.ndarray) -> Noise:
        """The noise with σ of positions and of rotations multiplied by `ratio` (2,); correlations stay."""
        each = np.repeat(ratio, 3)
        whole = None if self.covariance is None else self.covariance * np.outer(each, each)
        return replace(self, sigma=self.sigma * each, covariance=whole)

    def with_joints(self, response: np.ndarray, sigma_q: float) -> Noise:
        """The noise with that of joints which repeat to `sigma_q` [rad or m] added: σ_q²·G·Gᵀ.

        Args:
            response: G (N, 6, nq), derivative of the readings by the position of every actuator.
        """
        whole = self._full() + sigma_q**2 * response @ np.swapaxes(response, -1, -2)
        return replace(self, sigma=np.sqrt(np.diagonal(whole, axis1=1, axis2=2)), covariance=whole)

    @cached_property
    def _index(self) -> tuple[np.ndarray, np.ndarray]:
        row, component = np.nonzero(self.measured)
        return row, component

    @property
    def row(self) -> np.ndarray:
        """(M,) row of each whitened scalar."""
        return self._index[0]

    @property
    def component(self) -> np.ndarray:
        """(M,) 0…5 for x y z rx ry rz; a whitened scalar also holds readings before it where these are correlated."""
        return self._index[1]

    @cached_property
    def whitener(self) -> np.ndarray:
        """(N, 6, 6) W, the identity in rows and columns of readings that are not measured."""
        both = self.measured[:, :, None] & self.measured[:, None, :]
        if self.covariance is None:
            return np.where(self.measured, 1.0 / self.sigma, 1.0)[:, :, None] * np.eye(6)
        size = np.where(self.measured, self.sigma, 1.0)
        R = np.where(both, self.covariance / (size[:, :, None] * size[:, None, :]), np.eye(6))
        return np.linalg.inv(np.linalg.cholesky(R)) / size[:, None, :]

    def padded(self, values: np.ndarray) -> np.ndarray:
        """Values (N, 6, …) [m, rad] in units of the noise, of the same shape; 0 where nothing is measured."""
        seen = self.measured.reshape(*self.measured.shape, *(1,) * (values.ndim - 2))
        if self.covariance is None:
            size = np.where(self.measured, self.sigma, 1.0).reshape(seen.shape)
            return np.where(seen, values / size, 0.0)
        flat = np.where(seen, values, 0.0).reshape(*self.measured.shape, int(np.prod(values.shape[2:])))
        return np.where(seen, (self.whitener @ flat).reshape(values.shape), 0.0)

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Values (N, 6, …) [m, rad] as (M, …) in units of the noise, measured readings only."""
        row, component = self._index
        if self.covariance is not None:
            return self.padded(values)[row, component]
        flat = values.reshape(6 * len(self), *values.shape[2:])
        if len(row) < len(flat):
            flat = flat.take(6 * row + component, axis=0)
        return flat / self.sigma[row, component].reshape(-1, *(1,) * (values.ndim - 2))
