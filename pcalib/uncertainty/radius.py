"""The sphere that contains a given share of a normal deviate in space.

The squared length of a normal deviate with covariance C is Σ λ_j·z_j², with λ the eigenvalues of C and z standard
normal. Its distribution is matched in mean, variance and skewness by a shifted χ² with ν degrees of freedom (Hall 1983,
Buckley and Eagleson 1988):

    Σ λ_j·z_j² ≈ (χ²_ν − ν)·√(c₂/ν) + c₁        c_k = tr Cᵏ        ν = c₂³/c₃²

It is exact where the eigenvalues that are not zero are equal.
"""

from __future__ import annotations

import numpy as np

COVERAGE = 0.95
"""Share of landings that u95 contains."""
HALVINGS = 30
"""Bisections of the interval between the smallest and the largest radius: a billionth of it is left."""


def _matched(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean c₁, scale √(c₂/ν) and degrees of freedom ν of |e|², (N,) each; of a zero covariance 0, 0 and 1."""
    square = covariance @ covariance
    c1, c2 = np.trace(covariance, axis1=-2, axis2=-1), np.trace(square, axis1=-2, axis2=-1)
    c3 = np.einsum("...ij,...ji->...", square, covariance)
    some = c3 > 0
    nu = np.where(some, c2**3 / np.where(some, c3, 1.0) ** 2, 1.0)
    return c1, np.sqrt(c2 / nu), nu


def containing(covariance: np.ndarray, share: float = COVERAGE) -> np.ndarray:
    """(…) [m] radius about zero that contains the share of deviates with covariances (…, 3, 3) [m²]."""
    from scipy.special import gammaincinv

    # Scaled to unit trace: powers of covariances of micrometres would underflow.
    size = np.trace(covariance, axis1=-2, axis2=-1)
    unit = covariance / np.where(size > 0, size, 1.0)[..., None, None]
    c1, scale, nu = _matched(unit)
    return np.sqrt(size * np.maximum((2 * gammaincinv(nu / 2, share) - nu) * scale + c1, 0.0))


def within(covariance: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
    """(…) probability that deviates with covariances (…, 3, 3) [m²] are shorter than radius [m]."""
    from scipy.special import gammainc

    size = np.trace(covariance, axis1=-2, axis2=-1)
    some = size > 0
    unit = covariance / np.where(some, size, 1.0)[..., None, None]
    c1, scale, nu = _matched(unit)
    x = (np.square(radius) / np.where(some, size, 1.0) - c1) / np.where(scale > 0, scale, 1.0) + nu
    return np.where(some, gammainc(nu / 2, np.maximum(x, 0.0) / 2), 1.0)


def pooled(covariance: np.ndarray, share: float = COVERAGE) -> float:
    """[m] radius that contains the share of deviates drawn from all covariances (N, 3, 3) [m²] alike."""
    each = containing(covariance, share)
    low, high = float(each.min()), float(each.max())
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if within(covariance, middle).mean() < share else (low, middle)
    return high
