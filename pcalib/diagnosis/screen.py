"""The statistics of a diagnosis, on plain arrays: what is left of residuals when groups of columns are allowed for.

With whitened residuals y, whitened nuisance columns J (geometry, frame, effects already in the model) and groups of
columns E_g (effects of the library, smooth patterns), everything happens in the complement of J:

    y⊥ = (I − UUᵀ)·y        E⊥ = (I − UUᵀ)·E        T_g = |proj(y⊥ on E⊥_g)|²  ~  χ²(d_g) where nothing is missing

The joint span W of all groups holds all that is ever tested, so y, groups and Monte-Carlo draws are kept in its
coordinates. Where the noise level is an estimate with ν degrees of freedom per class of readings, draws are scaled
by it too and single p values come from F(d_g, ν); critical values of the smallest p are always by Monte Carlo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcalib.fitting.identifiability import project_out as project_out
from pcalib.fitting.identifiability import span as span

ALIAS = 1e-4
"""Sine of the angle below which a direction counts as contained in what is already allowed for."""
INVISIBLE = 0.5
"""Noise units: directions that the largest possible effect moves by less than this cannot be seen."""
LARGE = 10.0
"""Largest possible size of a parameter in usual sizes, where no physical range is stated."""
NUISANCE = 0.05
"""Noise units per prior σ: weaker directions of what the model has are held by the priors and not projected out. To
project them too would hide effects behind lengths that are wrong by many times their tolerance."""
REST = 10
"""Directions outside every group that are enough to be tested as one."""
KNOWN = 1e6
"""Degrees of freedom from which on a noise level counts as known."""
RARE = 0.9
"""Quantile of the best of each draw of noise at which independent tries are counted: neighbouring places of a step, and
neighbouring frequencies, are nearly one."""
POWER = 0.9
"""Power at which detection limits are stated, as metrology states them."""


@dataclass(frozen=True)
class Search:
    """What it costs that a group was found by trying many of its kind: the look-elsewhere effect."""

    trials: float = 1.0
    """Independent tries that would reach as far by chance."""
    luck: float = 0.0
    """Square sum, noise units, that the best of them takes of pure noise beyond its number of columns."""

    @classmethod
    def of(cls, best: np.ndarray, d: int) -> Search:
        """The cost of a group of d columns, from the best χ²(d) of the same search in every draw of noise (n,)."""
        from scipy.special import chdtr

        tries = np.log(RARE) / np.log(chdtr(d, np.quantile(best, RARE)))
        return cls(float(max(tries, 1.0)), float(max(np.mean(best) - d, 0.0)))


NOT_SEARCHED = Search()


@dataclass(frozen=True)
class Group:
    """Some columns that may explain residuals."""

    name: str
    columns: np.ndarray
    """(M, p) whitened derivative of the readings by each parameter."""
    scale: np.ndarray
    """(p,) usual size of each parameter."""
    search: Search = NOT_SEARCHED
    """How it was found, where it was searched for."""
    limit: np.ndarray | None = None
    """(p,) largest possible size of each parameter; None: ten times the usual one."""

    @property
    def furthest(self) -> np.ndarray:
        """(p,) largest possible size of each parameter."""
        return LARGE * self.scale if self.limit is None else self.limit


@dataclass(frozen=True)
class Known:
    """How well the noise level is known, per class of readings (positions, rotations)."""

    classes: np.ndarray
    """(M,) int, class of each reading."""
    dof: np.ndarray
    """(n_classes,) degrees of freedom of the level of each class; inf where it is taken as known."""
    pooled: bool = True
    """Whether a test relies on the levels of all classes together; False: it may rely on that of one class alone."""

    @property
    def nu(self) -> float:
        """Degrees of freedom of the noise level in a test; inf where the level of a class is taken as known."""
        used = self.dof[np.unique(self.classes)]
        return float(np.sum(used) if self.pooled else np.min(used)) if np.isfinite(used).all() else np.inf


@dataclass(frozen=True)
class Screen:
    """Everything that is tested, in the D coordinates of the groups' joint span."""

    names: tuple[str, ...]
    blocks: tuple[np.ndarray, ...]
    """G arrays (D, d_g): orthonormal basis of each group's visible part; d_g = 0 where there is none."""
    parts: tuple[np.ndarray, ...]
    """G arrays (D, p_g): visible columns per unit parameter."""
    trials: np.ndarray
    """(G,) independent tries that each group is the best of."""
    full: tuple[np.ndarray, ...]
    """G arrays (p_g,): norm of each column before the nuisance was projected out, noise units per unit parameter."""
    scale: tuple[np.ndarray, ...]
    limit: tuple[np.ndarray, ...]
    """G arrays (p_g,) each: usual and largest possible size of the parameters."""
    basis: np.ndarray
    """(M, D) the span in the space of readings."""
    residual: np.ndarray
    """(M,) readings less what the nuisance takes up."""
    free: int
    """Degrees of freedom of `residual`."""
    y: np.ndarray
    """(D,) residuals."""
    draws: np.ndarray
    """(n, D) float32, residuals of nothing but noise."""
    left: tuple[float, int] | None
    """Square sum and degrees of freedom outside every group; None where the noise level was taken from it."""
    left_draws: np.ndarray
    """(n,) square sum of each draw outside every group."""
    nu: float
    """Degrees of freedom of the noise level over all classes."""

    def p_value(self, T: np.ndarray | float, d: np.ndarray | float) -> np.ndarray:
        """Probability of a larger T (…) in d dimensions."""
        from scipy.special import chdtrc, fdtrc

        d = np.asarray(d, float)
        if self.nu >= KNOWN:
            return chdtrc(d, T)
        return fdtrc(d, self.nu, np.asarray(T) / np.maximum(d, 1))

    def p_of_draws(self, T: np.ndarray, d: np.ndarray) -> np.ndarray:
        """p values (n, G) of many draws, interpolated in log p (to 1e-3 of p) between exact ones."""
        out = np.empty(T.shape)
        for dim in np.unique(d):
            mine = d == dim
            grid = np.linspace(0.0, np.sqrt(T[:, mine].max(initial=1.0)), 512) ** 2
            exact = np.log(np.maximum(self.p_value(grid, int(dim)), 1e-300))
            out[:, mine] = np.exp(np.interp(T[:, mine], grid, exact))
        return out

    @cached_property
    def visible(self) -> np.ndarray:
        """(G,) dimensions of each group that can be seen."""
        return np.array([b.shape[1] for b in self.blocks])

    def allowing(self, chosen: Sequence[int]) -> tuple[np.ndarray, ...]:
        """Orthonormal bases (D, d) of every group's part outside the chosen groups."""
        if not chosen:
            return self.blocks
        Q = self.joint(chosen)
        return tuple(outside(block, Q) for block in self.blocks)

    def joint(self, chosen: Sequence[int]) -> np.ndarray:
        """(D, r) orthonormal basis of the chosen groups together."""
        if len(chosen) == 1:
            return self.blocks[chosen[0]]
        return span(np.hstack([self.blocks[g] for g in chosen]), ALIAS)

    def kappa(self, g: int) -> float:
        """Share of a group's signal, at its usual size, that the nuisance does not absorb."""
        before = np.sum((self.full[g] * self.scale[g]) ** 2)
        after = np.sum((self.parts[g] * self.scale[g]) ** 2)
        return float(np.sqrt(after / before)) if before > 0 else 0.0

    def estimate(self, chosen: Sequence[int]) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Least-squares parameters of the chosen groups together and their 1σ, one array (p_g,) per group."""
        F = np.hstack([self.parts[g] * self.limit[g] for g in chosen])
        F = np.vstack([F, np.zeros((max(0, F.shape[1] - len(F)), F.shape[1]))])  # or V lacks what no row sees
        U, s, Vt = np.linalg.svd(F, full_matrices=False)
        seen = s > INVISIBLE
        inverse = np.where(seen, 1.0 / np.where(seen, s, 1.0), 0.0)
        theta = Vt.T @ (inverse * (U[: len(self.y)].T @ self.y))
        # Directions that cannot be seen keep all their doubt.
        doubt = np.where(seen, inverse, np.inf)
        with np.errstate(invalid="ignore"):
            spread = np.sqrt(np.nansum(np.where(Vt.T**2 > 1e-12, (Vt.T * doubt) ** 2, 0.0), axis=1))
        cut = np.cumsum([self.parts[g].shape[1] for g in chosen])[:-1]
        limits = np.concatenate([self.limit[g] for g in chosen])
        return np.split(theta * limits, cut), np.split(spread * limits, cut)


def outside(block: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Orthonormal basis (D, d) of the part of span(block) that is orthogonal to span(Q); both orthonormal."""
    if block.shape[1] == 0:
        return block
    rest = block - Q @ (Q.T @ block)
    sine2, V = np.linalg.eigh(rest.T @ rest)
    keep = sine2 > ALIAS**2
    return rest @ (V[:, keep] / np.sqrt(sine2[keep]))


def screen(
    y: np.ndarray,
    nuisance: np.ndarray,
    groups: Sequence[Group],
    noise: Known,
    *,
    from_rest: bool = False,
    n_draws: int = 4096,
    seed: int = 0,
) -> Screen:
    """Reduce residuals, groups and noise draws to the groups' joint span.

    Args:
        y: (M,) whitened residuals.
        nuisance: (M, n) whitened columns scaled by their priors.
        from_rest: the noise level was estimated from what lies outside every group, which is then not tested.
    """
    U = span(nuisance, NUISANCE)
    y = project_out(y, U)
    visible, bases = [], []
    for group in groups:
        part = project_out(group.columns, U)
        visible.append(part)
        bases.append(span(part * group.furthest, INVISIBLE))
    stacked = np.hstack([*bases, np.zeros((len(y), 0))])
    square, V = np.linalg.eigh(stacked.T @ stacked)
    keep = square > 1e-8
    W = stacked @ (V[:, keep] / np.sqrt(square[keep]))
    W, _ = np.linalg.qr(W)  # the division above loses digits where groups nearly coincide

    z = np.random.default_rng(seed).standard_normal((n_draws, len(y)), dtype=np.float32)
    rng = np.random.default_rng(seed + 1)
    for c, dof in enumerate(noise.dof):
        if np.isfinite(dof) and dof < KNOWN:
            level = np.sqrt(dof / rng.chisquare(dof, n_draws))
            z[:, noise.classes == c] *= level[:, None].astype(np.float32)
    draws = z @ W.astype(np.float32)
    inside = z @ U.astype(np.float32)
    left_draws = (
        np.einsum("ij,ij->i", z, z) - np.einsum("ij,ij->i", draws, draws) - np.einsum("ij,ij->i", inside, inside)
    )
    at = W.T @ y
    left = max(float(y @ y - at @ at), 0.0), len(y) - U.shape[1] - W.shape[1]
    return Screen(
        names=tuple(group.name for group in groups),
        blocks=tuple(W.T @ basis for basis in bases),
        parts=tuple(W.T @ part for part in visible),
        trials=np.array([group.search.trials for group in groups], float),
        full=tuple(np.linalg.norm(group.columns, axis=0) for group in groups),
        scale=tuple(np.asarray(group.scale, float) for group in groups),
        limit=tuple(np.asarray(group.furthest, float) for group in groups),
        basis=W,
        residual=y,
        free=len(y) - U.shape[1],
        y=at,
        draws=draws,
        left=None if from_rest or left[1] < REST else left,
        left_draws=np.maximum(left_draws, 0.0).astype(float),
        nu=noise.nu,
    )


def joint_span(nuisance: np.ndarray, groups: Sequence[Group]) -> np.ndarray:
    """(M, d) orthonormal basis of nuisance columns and all groups together."""
    columns = [span(nuisance, NUISANCE)] + [group.columns for group in groups]
    return span(np.hstack([_unit(c) for c in columns]), 1e-6)


def _unit(columns: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(columns, axis=0)
    return columns / np.where(size > 0, size, 1.0)


@dataclass(frozen=True)
class Misfit:
    """Residuals of the fit rows against the noise."""

    chi2_dof: float
    """Per degree of freedom left after geometry, frame and effects of the model."""
    dof: int
    p: float
    """Probability of a larger misfit from noise alone; with replicates the lack-of-fit F test."""

    @property
    def times_noise(self) -> float:
        """Residuals in units of the noise."""
        return float(np.sqrt(self.chi2_dof))


def misfit(screen: Screen) -> Misfit:
    """The misfit of a model against the noise level of its problem.

    Where the noise level was estimated from residuals outside all groups, only the residuals inside the groups are
    tested, so that no residual is compared with itself.
    """
    total, dof = float(screen.residual @ screen.residual), screen.free
    if dof < 1:
        return Misfit(float("nan"), 0, 1.0)
    T, d = (float(screen.y @ screen.y), len(screen.y)) if screen.left is None else (total, dof)
    return Misfit(total / dof, dof, float(screen.p_value(T, d)) if d else 1.0)


def visible_size(screen: Screen, d: int, critical: float) -> float:
    """s, in noise units, that d columns must have to be found with 90 % power at a critical p."""
    from scipy.special import chdtri, chndtrinc, fdtri, ncfdtrinc

    if screen.nu >= KNOWN:
        return float(np.sqrt(chndtrinc(chdtri(d, critical), d, 1 - POWER)))
    return float(np.sqrt(ncfdtrinc(d, screen.nu, 1 - POWER, fdtri(d, screen.nu, 1 - critical))))


def smallest_seen(screen: Screen, g: int, critical: float) -> np.ndarray:
    """(p,) [SI] size of each parameter of a group, acting alone, that would have been found; inf where invisible."""
    if screen.visible[g] == 0:
        return np.full(screen.parts[g].shape[1], np.inf)
    seen = screen.blocks[g].T @ screen.parts[g]
    size = np.linalg.norm(seen, axis=0)
    # The best of several tried must beat them all.
    needed = visible_size(screen, int(screen.visible[g]), critical / float(screen.trials[g]))
    with np.errstate(divide="ignore"):
        return np.where(size > 0, needed / np.where(size > 0, size, 1.0), np.inf)
