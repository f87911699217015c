"""Which laws explain residuals: every law of the grammar, judged as the candidates of a diagnosis are.

A law's columns are the unit response of its places times its function, so only the responses cost kinematics. In the
complement of the nuisance (geometry, frame, effects of the model) the gain of a law is

    T = bᵀG⁺b,    G = E⊥ᵀE⊥,  b = E⊥ᵀy        ~ χ²(d) where nothing is missing

and the smallest p of the whole grammar is compared with its distribution under noise, so that the search is paid for.
Laws are ordered by BIC with searched constants counted. Those that gain most are refined and put to the adequacy test:
a law is adequate where no listed effect and no pattern improves on it. Laws whose fitted signals differ by less than
`ALIKE` noise units form one class, of which the simplest law stands first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib.diagnosis import adequacy
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.screen import INVISIBLE, LARGE, NUISANCE, Group, Noise, Screen, project_out, screen, span
from pcalib.laws.channels import Channel
from pcalib.laws.functions import Term
from pcalib.laws.grammar import EACH, Law, laws, sharings

DRAWS = 256
"""Draws of pure noise on which the whole search is repeated: they resolve corrected p values down to 0.004."""
TESTED = 32
"""Laws that are put to the adequacy test, one per channel, sharing and function: the true one is nearly always among
the first ten by BIC."""
ALIKE = 3.0
"""Noise units between the fitted signals of two laws below which the data cannot tell one from the other: a difference
of 3 would be found with a power of 60 % if nothing else were in question."""
BLOCK = 96
"""Functions that are evaluated at once: bounds memory at some 100 MB."""


@dataclass(frozen=True)
class Proposal:
    """One law and what the data say of it."""

    law: Law
    theta: np.ndarray
    sigma: np.ndarray
    """(columns,) [SI] Amplitudes and their 1σ."""
    s: float
    """Norm of its fitted signal, noise units."""
    p: float
    """Corrected for the whole grammar."""
    bic: float
    adequate: bool
    """No listed effect and no pattern improves on it."""
    rest: float
    """Smallest p of what could still improve on it, corrected for all that is tested there."""
    signal: np.ndarray
    """(D,) Fitted signal in the coordinates of the screen."""


@dataclass(frozen=True)
class Family:
    """Laws that these data cannot tell apart, the simplest first."""

    laws: tuple[Proposal, ...]

    @property
    def first(self) -> Proposal:
        """The one that stands for the class."""
        return self.laws[0]

    @property
    def rivals(self) -> tuple[Proposal, ...]:
        """The others."""
        return self.laws[1:]


@dataclass(frozen=True)
class Proposals:
    """What a search of the grammar found."""

    families: tuple[Family, ...]
    """Adequate classes first, then by BIC; empty where no law gains more than chance."""
    tried: int
    """Laws that were tried."""
    p: float
    """Of the best law, corrected for the whole grammar."""
    problem: Problem

    @property
    def adequate(self) -> tuple[Family, ...]:
        """Classes of laws on which nothing improves."""
        return tuple(f for f in self.families if f.first.adequate)


@dataclass(frozen=True)
class _Tried:
    law: Law
    gain: float
    d: int
    p: float
    bic: float


def propose(
    made: Problem, alpha: float = adequacy.ALPHA, level: float = adequacy.AGAINST[0], seed: int = 0
) -> Proposals:
    """Laws that explain what a model leaves over, by classes.

    Args:
        alpha: chance at which the best law of the whole grammar may pass for one where nothing is missing.
        level: at which data speak against a law.
    """
    search = _Search.of(made, seed)
    tried, null = search.all()
    if not tried:
        return Proposals((), 0, 1.0, made)
    best = min(t.p for t in tried)
    p = float(adequacy.corrected(best, null))
    if p > alpha:
        return Proposals((), len(tried), p, made)
    chosen = search.refined(_one_of_each(tried)[:TESTED])
    found = _judged(made, chosen, null, level, seed)
    return Proposals(tuple(_families(found)), len(tried), p, made)


@dataclass(frozen=True)
class _Search:
    """The arrays of a search."""

    made: Problem
    y: np.ndarray
    """(M,) Residuals outside the nuisance."""
    draws: np.ndarray
    """(M, n) float32, the same of pure noise."""
    U: np.ndarray
    """(M, r) Orthonormal basis of the nuisance."""
    p_value: Callable[[np.ndarray, np.ndarray], np.ndarray]

    @classmethod
    def of(cls, made: Problem, seed: int) -> _Search:
        U = span(made.nuisance, NUISANCE)
        rng = np.random.default_rng(seed)
        z = rng.standard_normal((len(made.y), DRAWS), dtype=np.float32)
        for c, dof in enumerate(made.noise.dof):  # the doubt about the noise level belongs to the noise
            if np.isfinite(dof):
                z[made.classes == c] *= np.sqrt(dof / rng.chisquare(dof, DRAWS)).astype(np.float32)
        base = screen(made.y, made.nuisance, [], Noise(made.classes, made.noise.dof), n_draws=1)
        return cls(made, project_out(made.y, U), project_out(z, U.astype(np.float32)), U, base.p_value)

    def response(self, channel: Channel, places: tuple[str, ...]) -> np.ndarray:
        """(M, P) Whitened readings per unit deviation of each place."""
        at = self.made.point.situation
        ones = [np.broadcast_to(row, (len(at), len(places))) for row in np.eye(len(places))]
        return self.made.whitened(self.made.point.columns([channel.contribution(at, one) for one in ones]))

    def all(self) -> tuple[list[_Tried], np.ndarray]:
        """Every law with its gain, and the smallest p of the grammar on each draw, ascending."""
        null, out = np.ones(DRAWS), []
        for channel, places, found in laws(self.made.point.situation):
            response = self.response(channel, places)
            if not np.any(response):
                continue
            for width in (1, 2):
                same = [term for term in found if len(term.shape.text) == width]
                for first in range(0, len(same), BLOCK):
                    tried, smallest = self.block(channel, places, response, same[first : first + BLOCK])
                    out += tried
                    null = np.minimum(null, smallest)
        return out, np.sort(null)

    def block(
        self, channel: Channel, places: tuple[str, ...], response: np.ndarray, found: Sequence[Term]
    ) -> tuple[list[_Tried], np.ndarray]:
        """Some functions in all sharings on one channel."""
        G, b, noise = self.moments(channel, response, found, True)
        out, null = [], np.ones(DRAWS)
        for sharing in sharings(channel, places):
            g, mine, by_chance = _shared(sharing, places, G, b, noise)
            T, d = _gain(g, mine[..., None], channel.size)
            T_noise, _ = _gain(g, by_chance, channel.size)
            seen = d > 0
            p = np.where(seen, self.p_value(T[:, 0], np.maximum(d, 1)), 1.0)
            if seen.any():
                # The most that a draw gains at each number of columns decides the smallest p.
                for k in np.unique(d[seen]):
                    null = np.minimum(null, self.p_value(T_noise[d == k].max(axis=0), np.full(DRAWS, k)))
            for i in np.flatnonzero(seen):
                law = Law(channel, sharing, found[i], places)
                cost = (int(d[i]) + law.term.shape.searched) * np.log(len(self.y))
                out.append(_Tried(law, float(T[i, 0]), int(d[i]), float(p[i]), float(cost - T[i, 0])))
        return out, null

    def moments(
        self, channel: Channel, response: np.ndarray, found: Sequence[Term], with_noise: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """G (T, K, P, K, P), b (T, K, P) and those of the draws (T, K, P, n), for K functions at P places."""
        at, row = self.made.point.situation, self.made.row
        P = response.shape[1]
        F = np.stack([np.stack([np.broadcast_to(f, (len(at), P)) for f in term.values(at)]) for term in found])
        E = (response * F[:, :, row]).astype(np.float32)  # (T, K, M, P)
        T, K, M, _ = E.shape
        flat = E.transpose(2, 0, 1, 3).reshape(M, -1)
        U = self.U.astype(np.float32)
        flat = flat - U @ (U.T @ flat)
        b = (flat.T.astype(float) @ self.y).reshape(T, K, P)
        each = flat.reshape(M, T, K * P).transpose(1, 0, 2)
        G = np.matmul(each.transpose(0, 2, 1), each).astype(float).reshape(T, K, P, K, P)
        noise = (flat.T @ self.draws).reshape(T, K, P, -1) if with_noise else np.zeros((T, K, P, 0))
        return G, b, noise

    def refined(self, chosen: Sequence[_Tried]) -> list[_Tried]:
        """The same laws at the best constant near the one that the grid had."""
        return [self._refined(t) if t.law.term.shape.name in ("sine", "settling", "waves") else t for t in chosen]

    def _refined(self, tried: _Tried) -> _Tried:
        law = tried.law
        response = self.response(law.channel, law.places)
        best, width = tried, 0.2 if law.term.shape.name == "settling" else 0.5 / max(law.term.constant, 1e-9)
        for _ in range(2):
            c = best.law.term.constant
            near = [replace(law.term, constant=float(f"{c * (1 + d):.5g}")) for d in np.linspace(-width, width, 15)]
            G, b, noise = self.moments(law.channel, response, near, False)
            g, mine, _ = _shared(law.sharing, law.places, G, b, noise)
            T, d = _gain(g, mine[..., None], law.channel.size)
            i = int(np.argmax(T[:, 0]))
            if T[i, 0] > best.gain and d[i] == best.d:
                more = float(T[i, 0]) - best.gain
                best = replace(best, law=replace(law, term=near[i]), gain=float(T[i, 0]), bic=best.bic - more)
            width /= 6
        return best


def _shared(
    sharing: str, places: tuple[str, ...], G: np.ndarray, b: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Moments of one sharing: (T, d, d), (T, d), (T, d, n)."""
    T, K, P = b.shape
    if sharing == EACH:
        return G.reshape(T, K * P, K * P), b.reshape(T, K * P), noise.reshape(T, K * P, -1)
    if sharing in places:
        i = places.index(sharing)
        return G[:, :, i, :, i], b[:, :, i], noise[:, :, i]
    return G.sum(axis=(2, 4)), b.sum(axis=2), noise.sum(axis=2)


def _gain(G: np.ndarray, b: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """T (n_laws, n) = bᵀG⁺b over the directions that the largest amplitude would show, and their number (n_laws,)."""
    values, vectors = np.linalg.eigh(G)
    # A direction is seen where the largest possible amplitude moves it by INVISIBLE, and rounding does not make it.
    seen = (values > (INVISIBLE / (LARGE * size)) ** 2) & (values > 1e-4 * values[:, -1:])
    inverse = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    turned = np.matmul(vectors.transpose(0, 2, 1), b)
    return np.einsum("td,tdn->tn", inverse, turned**2), seen.sum(axis=1)


def _one_of_each(tried: Sequence[_Tried]) -> list[_Tried]:
    """The best constant of each channel, sharing and function, by BIC."""
    out: dict[tuple, _Tried] = {}
    for t in sorted(tried, key=lambda t: t.bic):
        term = t.law.term
        key = (t.law.channel.words, t.law.sharing, term.shape.name, tuple(s.variable.words for s in term.variables))
        out.setdefault(key, t)
    return list(out.values())


def _judged(
    made: Problem, chosen: Sequence[_Tried], null: np.ndarray, level: float, seed: int
) -> list[Proposal]:
    """The adequacy of each law against all listed effects and patterns, in the order of `chosen`."""
    groups = [
        Group(t.law.words(), made.whitened(_columns(made, t.law)), np.full(t.law.columns, t.law.channel.size))
        for t in chosen
    ]
    listed = made.groups
    noise = Noise(made.classes, made.noise.dof)
    from_rest = made.noise.source == "residuals" or made.noise.pooled
    whole = screen(made.y, made.nuisance, [*listed, *groups], noise, from_rest=from_rest, seed=seed)
    n = len(listed)
    tested = _without(whole, range(n, n + len(groups)))
    reference = float(np.quantile(adequacy.null_distribution(tested), level))
    out = []
    for i, t in enumerate(chosen):
        g = n + i
        mine = _without(whole, [j for j in range(n, n + len(groups)) if j != g])
        theta, sigma = (a[0] for a in whole.estimate([g]))
        Q = whole.joint([g])
        rest = adequacy.p_values(mine, [n])
        out.append(
            Proposal(
                law=t.law,
                theta=theta,
                sigma=sigma,
                s=float(np.sqrt(max(t.gain, 0.0))),
                p=float(adequacy.corrected(t.p, null)),
                bic=t.bic,
                adequate=adequacy.is_adequate(mine, [n], level, reference),
                rest=float(rest.smallest),
                signal=Q @ (Q.T @ whole.y),
            )
        )
    return out


def _without(whole: Screen, gone: Sequence[int] | range) -> Screen:
    """A screen without some groups, in the same coordinates."""
    keep = [g for g in range(len(whole.blocks)) if g not in set(gone)]

    def some(values: tuple) -> tuple:
        return tuple(values[g] for g in keep)

    return replace(
        whole, names=some(whole.names), blocks=some(whole.blocks), parts=some(whole.parts), trials=whole.trials[keep],
        full=some(whole.full), scale=some(whole.scale), limit=some(whole.limit),
    )  # fmt: skip


def _columns(made: Problem, law: Law) -> np.ndarray:
    at = made.point.situation
    return made.point.columns([law.contribution(at, row) for row in np.eye(law.columns)])


def _families(found: Sequence[Proposal]) -> list[Family]:
    """Classes of laws with nearly one signal: adequate ones first, the simplest law of each class in front."""
    left = sorted(found, key=lambda p: (not p.adequate, p.bic))
    out = []
    while left:
        head, *others = left
        mine = [p for p in others if np.linalg.norm(p.signal - head.signal) < ALIKE and p.adequate == head.adequate]
        members = sorted([head, *mine], key=lambda p: (p.law.complexity, p.bic))
        out.append(Family(tuple(members)))
        left = [p for p in others if all(p is not m for m in mine)]
    return out
