"""How noisy the readings are: from replicates, else from what no effect or pattern can explain, else as stated.

Every verdict hangs on it: with a noise level that is off by a third, 5 % of false alarms become 10–90 %. Per pose

    Σ = a_pos·Σ_pos + a_rot·Σ_rot + σ_q²·G·Gᵀ + σ_l²·L·Lᵀ

with G = ∂(reading)/∂q, how joint repeatability shows at the plate, and L = ∂(reading)/∂ω, how an error ω of the seen
rotation moves a point that is computed from reflectors or markers on the plate. The variance components are estimated
from residuals projected on directions that hold nothing but noise:
by REML from replicates (Patterson & Thompson 1971), by MINQUE from what is left over (Rao 1971).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pcalib.data import replicates
from pcalib.data.measurement import Measurements
from pcalib.fitting.memory import Memory, time_of
from pcalib.wording import figure, small

ENOUGH_REPLICATES = 10
"""Degrees of freedom of replicates, per class of readings, from which on their scatter is the noise."""
ENOUGH_REST = 60
"""Degrees of freedom outside all groups from which on their scatter may stand in for replicates."""
ENOUGH_BESIDE = 20
"""Degrees of freedom outside all groups from which on their scatter is pooled with replicates."""
CONTRASTS = 200
"""Differences between replicates that are taken of each component at most: they give σ of positions to 3 %."""
_NOTHING = 1e-6
"""Share of the largest variance below which one is taken for zero: a thousandth of its σ."""
COPIED = 1e-6
"""RMS scatter of replicates, in stated σ, below which they are copies of one reading and say nothing of the noise."""
_CLEAR = (1.0, 4.0)
"""Joint repeatability, and turns at a lever, are taken into account where their variance is this many of its σ above
zero. Most joints repeat worse than not at all; most instruments state how position and rotation are correlated."""

_CLASSES = ("positions", "rotations")


@dataclass(frozen=True)
class NoiseLevel:
    """The noise level that tests use."""

    source: str
    """'replicates', 'residuals' or 'stated'."""
    ratio: np.ndarray
    """(2,) σ of positions and rotations over the stated ones, without joint repeatability."""
    dof: np.ndarray
    """(2,) degrees of freedom of the whole noise of each class; inf where the stated σ is taken as it is."""
    sigma_q: float
    """[rad or m] 1σ joint repeatability; 0 where it is not seen."""
    sigma_pos: float
    """[m] RMS noise of a component of position over the rows, from all causes; NaN where no positions are measured."""
    sigma_rot: float
    """[rad] RMS noise of a component of rotation, in the same way."""
    stated: tuple[bool, bool]
    """Whether the file states σ of positions and of rotations."""
    lever: float = 0.0
    """[rad] 1σ of the error of the seen rotation that also moves the measured point about the plate's origin; 0 where
    the data show none."""
    steps: float = 0.0
    """[rad or m] 1σ of the errors left by the steps of encoders. They repeat, and are counted as noise all the same."""
    repeatable: float = 0.0
    """[rad or m] 1σ of joint errors that residuals show and replicates do not: they repeat, so they are no noise."""
    memory: Memory | None = None
    """Correlation of the noise in time; None where the noise is white."""
    close: bool = False
    """Whether replicates lie too close in time to show correlated noise."""
    excess: float = 0.0
    """By how many standard errors residuals outside every effect and pattern scatter more than replicates."""
    rest_share: float = 0.0
    """Share of the degrees of freedom that comes from these residuals, where they are pooled with replicates."""
    pooled: bool = False
    """Whether these residuals agree with the replicates and are pooled with them."""

    @property
    def total(self) -> tuple[float, float]:
        """[m, rad] RMS noise per component of positions and of rotations; NaN where a class is not measured."""
        return self.sigma_pos, self.sigma_rot

    @property
    def joints(self) -> float:
        """[rad or m] 1σ of all errors of the drives that are counted with the noise."""
        return float(np.hypot(self.sigma_q, self.steps))

    @property
    def verified(self) -> bool:
        """Whether replicates confirm the level."""
        return self.source == "replicates" and not self.close

    def sentence(self, joint_unit: str = "µrad") -> str:
        """Where the figure comes from, and what that means; joints are said in millionths of their unit."""
        said = " and ".join(
            small(value, unit) for value, unit in ((self.sigma_pos, "m"), (self.sigma_rot, "rad")) if np.isfinite(value)
        )
        if self.sigma_q:
            said += f" (part of it from joints that repeat to {self.sigma_q * 1e6:.2g} {joint_unit})"
        if self.lever:
            said += " (positions and rotations are correlated through the lever of the tool: state the reflectors)"
        if self.memory is not None:
            said += f", correlated over some {figure(self.memory.rows, 1)} rows"
        if self.close:
            return (
                f"Noise {said} per component is the scatter that no effect and no pattern explains. Replicates lie too "
                "close in time to verify it: repeat poses after a while."
            )
        if self.source == "replicates":
            few = [
                f"; of {what} too few are repeated, so that theirs is {'as stated' if stated else 'assumed'}"
                for what, value, nu, stated in zip(_CLASSES, self.total, self.dof, self.stated, strict=True)
                if np.isfinite(value) and not np.isfinite(nu)
            ]
            return f"Noise {said} per component, from replicates{''.join(few)}."
        if self.source == "residuals":
            return (
                f"Noise not verified by replicates: {said} per component is the scatter that nothing tested explains. "
                "Measure ten poses twice to be sure."
            )
        stated = [own for own, value in zip(self.stated, self.total, strict=True) if np.isfinite(value)]
        origin = "as the file states" if all(stated) else "assumed, as the file states none"
        if len(set(stated)) == 2:
            origin = f"as the file states, that of {_CLASSES[stated.index(False)]} assumed"
        return (
            f"Noise not verified: {said} per component {origin}. Take what follows as a ranking; "
            "measure ten poses twice to get a verdict."
        )


@dataclass(frozen=True)
class Blocks:
    """Readings in stated noise units, padded to six components per pose; unmeasured ones are zero."""

    measured: np.ndarray
    """(N, 6) bool."""
    y: np.ndarray
    """(N, 6) residuals."""
    joint: np.ndarray
    """(N, 6, nq) readings per rad or m of every actuator."""
    turn: np.ndarray | None = None
    """(N, 6, 3) readings per rad of a turn about the plate's origin; None where no lever can be told."""

    def scaled(self) -> tuple[list[np.ndarray], np.ndarray]:
        """Joints and turn, each in a unit [rad or m] that causes noise of about one unit, and these units."""
        out, units = [], []
        for columns in (self.joint, self.turn):
            if columns is None:
                continue
            columns = columns * self.measured[..., None]
            size = np.sqrt(np.sum(columns**2) / max(self.measured.sum(), 1))
            units.append(float(1.0 / size) if size > 0 else 1.0)
            out.append(units[-1] * columns)
        return out, np.array(units)

    def per_joint(self) -> np.ndarray:
        """(2,) noise variance of positions and rotations, on average over the readings, per rad² or m² of joints."""
        square = np.sum(self.joint**2, axis=-1) * self.measured
        return np.array([square[:, p].sum() / max(self.measured[:, p].sum(), 1) for p in (slice(0, 3), slice(3, 6))])

    def components(self) -> np.ndarray:
        """(3 or 4, N, 6, 6) S_pos, S_rot, G·Gᵀ and L·Lᵀ: derivative of each pose's covariance by the variances."""
        part = np.repeat(np.eye(2), 3, axis=1)
        plain = [np.einsum("ni,ij->nij", self.measured * part[c], np.eye(6)) for c in range(2)]
        return np.stack([*plain, *(G @ np.swapaxes(G, -1, -2) for G in self.scaled()[0])])


def as_stated(data: Measurements) -> NoiseLevel:
    """The σ of the file, taken as known."""
    return _level("stated", data, np.ones(2), np.full(2, np.inf), np.zeros(2), None)


def contrasts(data: Measurements, measured: np.ndarray, drift: np.ndarray) -> np.ndarray:
    """(N, 6, ν) orthonormal differences between replicates, which hold nothing but noise: CONTRASTS of each component.

    Args:
        measured: (N, 6) bool.
        drift: (N, 6, p) columns of what may change between replicates (time), in stated noise units.
    """
    group = replicates.groups(data)
    found, count = [], int(group.max(initial=-1)) + 1
    chosen = np.unique(np.linspace(0, max(count - 1, 0), min(count, CONTRASTS)).astype(int))
    each = 1 + CONTRASTS // max(len(chosen), 1)
    for g in chosen:
        rows = np.flatnonzero(group == g)
        for c in range(6):
            seen = rows[measured[rows, c]][:each]
            for n in range(1, len(seen)):  # Helmert contrasts: orthonormal differences within the group
                v = np.zeros(measured.shape)
                v[seen[:n], c], v[seen[n], c] = -1.0 / n, 1.0
                found.append(v / np.linalg.norm(v))
    if not found:
        return np.zeros((*measured.shape, 0))
    V = np.stack(found, axis=-1)
    if drift.shape[-1]:
        inside = V.reshape(-1, V.shape[-1]).T @ drift.reshape(-1, drift.shape[-1])
        size = np.linalg.norm(inside, axis=0)
        inside = inside[:, size > 1e-6 * np.linalg.norm(drift, axis=(0, 1)) + 1e-12]
        if inside.shape[1]:
            U, s, _ = np.linalg.svd(inside)
            V = V @ U[:, int(np.sum(s > 1e-9 * s[0])) :]
    return V


def from_replicates(data: Measurements, blocks: Blocks, V: np.ndarray) -> NoiseLevel | None:
    """The scatter of replicates about their own mean; None where there are too few, or where they are copies.

    Args:
        V: (N, 6, ν) their :func:`contrasts`.
    """
    if not V.shape[-1]:
        return None
    S = blocks.components()
    flat = V.reshape(-1, V.shape[-1])
    inner = np.stack([flat.T @ (part @ V).reshape(flat.shape) for part in S])
    y = flat.T @ blocks.y.ravel()
    if np.sqrt(np.mean(y**2)) < COPIED:
        return None
    dof = np.array([np.trace(inner[0]), np.trace(inner[1])])

    def normal(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations of REML at given variances: scoring steps are their solutions."""
        inverse = np.linalg.inv(np.einsum("k,kcd->cd", theta, inner))
        parts, seen = inverse @ inner, inverse @ y
        return np.einsum("kcd,mdc->km", parts, parts), np.einsum("c,kcd,d->k", seen, inner, seen)

    # Angles alone hardly answer to joints, and would blame a little noise on joints that miss by millimetres.
    joints = dof[0] >= ENOUGH_REPLICATES or not blocks.measured[:, :3].any()
    return _solve("replicates", data, blocks, normal, dof, ENOUGH_REPLICATES, joints)


@dataclass(frozen=True)
class LeftOver:
    """Normal equations B·θ = b of MINQUE for the variance components θ, of what lies outside some directions."""

    B: np.ndarray
    """(components, components)."""
    b: np.ndarray
    """(components,)."""
    dof: np.ndarray
    """(2,) degrees of freedom of positions and of rotations there."""


def left_over(blocks: Blocks, Q: np.ndarray, luck: float = 0.0) -> LeftOver:
    """The equations of what lies outside Q.

    Args:
        Q: (N, 6, d) orthonormal basis of nuisance and all groups, and of replicates that are judged by themselves.
        luck: square sum, noise units, that Q takes beyond its dimensions because it was chosen to suit the noise.
    """
    S = blocks.components()
    flat = Q.reshape(Q.shape[0] * Q.shape[1], Q.shape[-1])  # a level that frees nothing has no columns
    rest = blocks.y - (flat @ (flat.T @ blocks.y.ravel())).reshape(blocks.y.shape)
    SQ = [part @ Q for part in S]
    QSQ = [flat.T @ s.reshape(flat.shape) for s in SQ]
    B = np.empty((len(S), len(S)))
    for k in range(len(S)):
        for m in range(k + 1):
            B[k, m] = B[m, k] = np.vdot(S[k], S[m]) - 2 * np.vdot(SQ[k], SQ[m]) + np.vdot(QSQ[k], QSQ[m])
    b = np.array([np.einsum("ni,nij,nj->", rest, part, rest) for part in S])
    dof = np.array([np.sum(np.trace(S[k], axis1=1, axis2=2)) - np.trace(QSQ[k]) for k in range(2)])
    return LeftOver(B, b * (1 + luck / max(dof.sum() - luck, 1.0)), dof)


def from_rest(
    data: Measurements, blocks: Blocks, rest: LeftOver, enough: int = ENOUGH_REST, joints: bool = True
) -> NoiseLevel | None:
    """The level outside geometry and every group; None where too little is left over.

    Args:
        enough: degrees of freedom, per class of readings, below which nothing is said.
        joints: whether joint repeatability may be part of it. Where replicates show none, errors of the joints repeat
            and are no noise.
    """
    return _solve("residuals", data, blocks, lambda theta: (rest.B, rest.b), rest.dof, enough, joints)


STEPS = {"angle": 2 * np.pi / 2**18 / np.sqrt(12), "length": 5e-6 / np.sqrt(12)}
"""[rad, m] 1σ of the errors that the steps of usual encoders leave: 18 bits, and scales of 5 µm. Replicates do not show
them, and 120 rows of a tracker know them to about as much."""
FINEST = 1.5
"""Largest share of the usual steps that is counted with the noise. What repeats and is larger is missing physics."""


def with_steps(level: NoiseLevel, blocks: Blocks, rest: LeftOver, usual: float) -> NoiseLevel:
    """The level with what the steps of encoders add where they are as the data and usual encoders have them.

    The variance is the mean of what is left over, as MINQUE has it, and of the usual one, each weighed by its doubt;
    that of the usual one is as large as itself. Where replicates show that joints repeat worse, steps are part of that.

    Args:
        usual: [rad or m] 1σ of usual steps, of :data:`STEPS`.
    """
    if level.sigma_q or level.source == "stated":
        return level
    known = np.array([*np.flatnonzero(rest.dof >= ENOUGH_BESIDE), 2])
    value, weight = usual**2, 0.0
    share = blocks.per_joint()
    if len(known) > 1:
        theta = np.linalg.lstsq(rest.B[np.ix_(known, known)], rest.b[known], rcond=None)[0]
        doubt = np.linalg.pinv(rest.B)
        unit = blocks.scaled()[1][0] ** 2
        sigma = np.sqrt(2 * doubt[2, 2]) * unit * float(np.mean(level.ratio**2))
        weight = usual**4 / (usual**4 + sigma**2)
        value = weight * theta[-1] * unit + (1 - weight) * usual**2
    steps2 = float(np.clip(value, 0.0, (FINEST * usual) ** 2))
    # What is left over holds them already; replicates and stated σ do not.
    held = (1.0 if level.source == "residuals" else level.rest_share) * np.isfinite(level.dof)
    ratio = np.sqrt(np.maximum(level.ratio**2 - held * steps2 * share, 0.25 * level.ratio**2))
    return replace(level, ratio=ratio, steps=float(np.sqrt(steps2)))


def reshaped(
    level: NoiseLevel,
    data: Measurements,
    ratio: np.ndarray,
    rest: NoiseLevel | None,
    memory: Memory,
) -> NoiseLevel:
    """A level whose σ is multiplied by `ratio` (2,), because correlation in time was allowed for.

    Args:
        rest: what is left over then, whose degrees of freedom count; None where too little is.
    """
    out = replace(
        level, ratio=level.ratio * ratio, sigma_q=level.sigma_q * float(np.mean(ratio)), memory=memory,
        steps=level.steps * float(np.mean(ratio)),
        lever=level.lever * float(np.mean(ratio)),
        sigma_pos=level.sigma_pos * ratio[0], sigma_rot=level.sigma_rot * ratio[1], pooled=True,
        dof=level.dof if rest is None else rest.dof,
    )  # fmt: skip
    group, time = replicates.groups(data), time_of(data)
    apart = [np.ptp(time[group == g]) for g in range(int(group.max(initial=-1)) + 1)]
    return replace(out, close=bool(apart) and float(np.median(apart)) < 2 * memory.tau)


def excess(repeated: NoiseLevel, rest: NoiseLevel | None) -> float:
    """By how much what is left over scatters more than replicates, in standard errors: ln F has the variance
    2/ν₁ + 2/ν₂, and positions and rotations count alike."""
    if rest is None:
        return 0.0
    classes = zip(repeated.total, rest.total, repeated.dof, rest.dof, strict=True)
    z = [2 * np.log(b / a) / np.sqrt(2 / m + 2 / n) for a, b, m, n in classes if np.isfinite(m) and np.isfinite(n)]
    return float(np.sum(z) / np.sqrt(max(len(z), 1)))


AGREE = 0.01
"""p of a two-sided F test from which on replicates and what is left over are two samples of one noise."""


def pooled(repeated: NoiseLevel, rest: NoiseLevel | None) -> NoiseLevel:
    """The level of replicates and of the other residuals together, where both agree: few replicates determine it badly.

    The two must share no directions, else what they share would count twice.
    """
    from scipy.special import fdtr, fdtrc

    if rest is None:
        return repeated
    for a, b, nu_a, nu_b in zip(repeated.total, rest.total, repeated.dof, rest.dof, strict=True):
        if np.isfinite(nu_a) and np.isfinite(nu_b):
            F = (b / a) ** 2
            if 2 * min(fdtr(nu_b, nu_a, F), fdtrc(nu_b, nu_a, F)) < AGREE:
                return repeated
    # Of a class that one of them does not know the other decides.
    weights = np.where(np.isfinite([repeated.dof, rest.dof]), [repeated.dof, rest.dof], 0.0)
    known = weights.any(axis=0)
    dof = np.where(known, weights.sum(axis=0), np.inf)
    lever = repeated.lever
    if (repeated.lever > 0) != (rest.lever > 0):  # it belongs to the instrument, so that either sample may show it
        seen = repeated if repeated.lever else rest
        ratio, sigma_q, lever = seen.ratio, seen.sigma_q, seen.lever
    elif (repeated.sigma_q > 0) == (rest.sigma_q > 0):
        share = np.where(known, weights[0] / np.where(known, dof, 1.0), 1.0)
        ratio = np.sqrt(share * repeated.ratio**2 + (1 - share) * rest.ratio**2)
        both = share[known].mean()
        sigma_q = float(np.sqrt(both * repeated.sigma_q**2 + (1 - both) * rest.sigma_q**2))
        lever = float(np.sqrt(both * repeated.lever**2 + (1 - both) * rest.lever**2))
    else:  # joints are noise only where both say so: what the rest alone shows repeats
        plain = repeated if rest.sigma_q else rest
        ratio, sigma_q = plain.ratio, 0.0
    pos, rot = (
        float(np.sqrt((a * x**2 + b * y**2) / (a + b))) if a + b else x
        for x, y, a, b in zip(repeated.total, rest.total, *weights, strict=True)
    )
    return replace(
        repeated, ratio=ratio, dof=dof, sigma_q=sigma_q, lever=lever, sigma_pos=pos, sigma_rot=rot, pooled=True,
        rest_share=float(weights[1].sum() / max(weights.sum(), 1.0)),
    )  # fmt: skip


def _solve(
    source: str,
    data: Measurements,
    blocks: Blocks,
    normal: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    dof: np.ndarray,
    enough: int,
    joints: bool = True,
) -> NoiseLevel | None:
    """Variances θ from their normal equations; joint repeatability and a lever only where they are clearly there.

    A class of which too little is known keeps its stated σ; None where that is so of all.
    """
    seen = np.array([blocks.measured[:, :3].any(), blocks.measured[:, 3:].any()])
    plain, held = np.flatnonzero(seen & (dof >= enough)), np.flatnonzero(seen & (dof < enough))
    if not len(plain):
        return None
    S = blocks.components()
    part = [slice(0, 3), slice(3, 6)]
    # (2, components) noise variance of each class, on average over its readings, per unit of each component
    share = np.array([
        [np.trace(component[:, p, p], axis1=1, axis2=2).sum() for component in S] for p in part
    ]) / np.maximum([[blocks.measured[:, p].sum()] for p in part], 1)  # fmt: skip
    # Equations that do not depend on θ (MINQUE) state its doubt for noise of size 1.
    stated_for_one = source == "residuals"
    found, chosen, most = _scored(normal, plain, held, share), plain, 0.0
    optional = [k for k in range(2, len(S)) if k > 2 or joints]
    for more in ([k] for k in optional) if len(optional) < 2 else ([2], [3], [2, 3]):
        tried = _scored(normal, np.r_[plain, more], held, share)
        if tried is None:
            continue
        theta, doubt = tried
        size = theta[:2].max() + theta[2:].sum() if stated_for_one else 1.0
        sigmas = theta[more] / (size * np.sqrt(2 * np.diag(doubt)[-len(more) :]))
        if np.all(sigmas > np.array(_CLEAR)[np.array(more) - 2]) and (len(more) > 1 or sigmas[0] > most):
            found, chosen, most = tried, np.r_[plain, more], float(sigmas[0])
    if found is None:
        return None
    theta, doubt = found
    free = np.full(2, np.inf)
    for c in plain:
        # The variance of a class is mean·θ, known to 2·mean·A⁻¹·mean; as a multiple of χ²(ν)/ν that makes ν:
        mean = share[c, chosen]
        total = 1.0 if stated_for_one else float(mean @ theta[chosen])
        free[c] = total**2 / float(mean @ doubt @ mean)
    further = np.zeros(2)
    further[: len(S) - 2] = np.sqrt(theta[2:]) * blocks.scaled()[1]
    return _level(source, data, np.where(seen, np.sqrt(theta[:2]), 1.0), free, further, blocks)


def _scored(
    normal: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    chosen: np.ndarray,
    held: np.ndarray,
    share: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:
    """(components,) variances after a few scoring steps, and half their covariance; None where they have no solution.

    Args:
        chosen, held: components that are estimated, and those that stay 1; the rest is 0.
        share: (2, components) noise variance of each class per unit of each component.
    """
    theta = np.zeros(share.shape[1])
    theta[chosen] = theta[held] = 1.0
    classes = chosen[chosen < 2]
    A = np.eye(len(chosen))
    for _ in range(40):
        before = theta.copy()
        try:
            full, b = normal(theta)
            A = full[np.ix_(chosen, chosen)]
            theta[chosen] = np.linalg.solve(A, b[chosen] - full[np.ix_(chosen, held)].sum(axis=1))
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(theta).all():
            return None
        # A share that is not there tends to zero and never below; each class has a scale of its own. Where joints make
        # nearly all the noise of a class the instrument's share is small, not nothing.
        theta[chosen] = np.maximum(theta[chosen], 0.02 * before[chosen])
        theta[classes] = np.maximum(theta[classes], 0.02 * share[classes, 2:] @ theta[2:])
        if not theta.max() > 0:
            return None
        if np.all(np.abs(theta - before) < 1e-3 * theta + _NOTHING * theta.max()):
            break
    return theta, np.linalg.inv(A)


def _level(
    source: str, data: Measurements, ratio: np.ndarray, dof: np.ndarray, further: np.ndarray, blocks: Blocks | None
) -> NoiseLevel:
    """The level of given variances.

    Args:
        further: (2,) 1σ of joints [rad or m] and of turns at a lever [rad].
    """
    typical = []
    for c, part in enumerate((slice(0, 3), slice(3, 6))):
        seen = data.mask[:, part]
        if not seen.any():
            typical.append(np.nan)
            continue
        variance = (data.sigma[:, part] * ratio[c]) ** 2
        for sigma, columns in zip(further, (blocks.joint, blocks.turn) if blocks is not None else (), strict=False):
            if sigma and columns is not None:
                variance = variance + (sigma * data.sigma[:, part]) ** 2 * np.sum(columns[:, part] ** 2, axis=-1)
        typical.append(float(np.sqrt(np.mean(variance[seen]))))
    sigma_q, lever = (float(value) for value in further)
    return NoiseLevel(source, ratio, dof, sigma_q, typical[0], typical[1], data.stated, lever=lever)


def covariance(level: NoiseLevel, blocks: Blocks) -> np.ndarray:
    """(N, 6, 6) covariance of every pose's measured readings, in stated noise units; 0 where nothing is measured."""
    S, units = blocks.components(), blocks.scaled()[1]
    further = np.array([level.joints, level.lever])[: len(units)]
    return np.einsum("k,knij->nij", np.r_[level.ratio**2, (further / units) ** 2], S)


def whitener(level: NoiseLevel, blocks: Blocks) -> np.ndarray:
    """(N, 6, 6) inverse Cholesky factor of every pose's covariance, from stated noise units to the level's."""
    total = covariance(level, blocks) + np.einsum("ni,ij->nij", ~blocks.measured, np.eye(6))
    return np.linalg.inv(np.linalg.cholesky(total))
