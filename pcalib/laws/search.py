"""Which laws explain residuals: every law of the grammar, judged as the candidates of a diagnosis are.

A law's columns are the unit response of its places times its function, so only the responses cost kinematics. In the
complement of the nuisance (geometry, frame, effects of the model) the gain of a law is

    T = bᵀG⁺b,    G = E⊥ᵀE⊥,  b = E⊥ᵀy        ~ χ²(d) where nothing is missing

and the smallest p of the whole grammar is compared with its distribution under noise, so that the search is paid for.
Laws are ordered by BIC with searched constants counted. Those that gain most are refined and put to the adequacy test:
a law is adequate where no listed effect and no pattern improves on it. Where one law alone is not adequate, laws beside
a listed effect and pairs of laws are tried the same way. Laws whose fitted signals differ by less than `ALIKE` noise
units form one class, of which the simplest law stands first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib.diagnosis import adequacy
from pcalib.diagnosis.candidates import Candidate
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.screen import INVISIBLE, LARGE, NUISANCE, Group, Known, Screen, project_out, screen, span
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
BEHIND = 80.0
"""BIC behind the best explanation from which on another is not put to the test: odds of e^40 against it."""
ENOUGH = 8
"""Adequate explanations after which no further ones are tested: nobody would read more rivals."""
COMPANIONS = 4
"""Listed effects, and laws, beside which a further law is searched for: those that gain most on their own."""
BLOCK = 96
"""Functions that are evaluated at once: bounds memory at some 100 MB."""


@dataclass(frozen=True)
class Proposal:
    """One explanation that holds a law, and what the data say of it."""

    laws: tuple[Law, ...]
    """One law, or two where one is not enough."""
    beside: tuple[Candidate, ...]
    """The listed effect beside which the law stands, where there is one."""
    theta: tuple[np.ndarray, ...]
    sigma: tuple[np.ndarray, ...]
    """[SI] Amplitudes of each law and their 1σ."""
    s: float
    """Norm of the fitted signal, noise units."""
    p: float
    """Of the best law of the grammar, corrected for all laws that were tried."""
    bic: float
    adequate: bool
    """No listed effect and no pattern improves on it."""
    rest: float
    """Smallest p of what could still improve on it."""
    listed: tuple[str, ...]
    """Listed effects that fit this signal as well."""
    signal: np.ndarray
    """(M,) Fitted signal, whitened, outside the nuisance."""

    @property
    def complexity(self) -> int:
        """Number of amplitudes and searched constants."""
        return sum(law.complexity for law in self.laws) + sum(len(c.scale) for c in self.beside)

    def words(self) -> str:
        """Its laws without figures."""
        return " and ".join([*(law.words() for law in self.laws), *(f"{c.name} (listed)" for c in self.beside)])


@dataclass(frozen=True)
class Family:
    """Explanations that these data cannot tell apart, the simplest first."""

    members: tuple[Proposal, ...]

    @property
    def first(self) -> Proposal:
        """The one that stands for the class."""
        return self.members[0]

    @property
    def rivals(self) -> tuple[Proposal, ...]:
        """The others."""
        return self.members[1:]


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
        """Classes on which nothing improves."""
        return tuple(f for f in self.families if f.first.adequate)


@dataclass(frozen=True)
class _Tried:
    law: Law
    gain: float
    d: int
    p: float
    bic: float
    companion: int = -1
    """Which companion it stands beside; −1: none."""


def propose(
    made: Problem, alpha: float = adequacy.ALPHA, level: float = adequacy.AGAINST[0], seed: int = 0
) -> Proposals:
    """Laws that explain what a model leaves over, by classes.

    Args:
        alpha: chance at which the best law of the whole grammar may pass for one where nothing is missing.
        level: at which data speak against a law.
    """
    search = _Search.of(made, seed)
    listed = search.best_listed()
    tried, null = search.all([search.outside(made.whitened(c.columns)) for c in listed])
    if not tried:
        return Proposals((), 0, 1.0, made)
    p = float(adequacy.corrected(min(t.p for t in tried), null))
    if p > alpha:
        return Proposals((), len(tried), p, made)
    judge = _Judge.of(made, p, level, seed)
    alone = search.refined(_one_of_each([t for t in tried if t.companion < 0]))
    found = judge.all([((t.law,), (), t.bic) for t in alone])
    if not any(f.adequate for f in found):
        beside = _one_of_each([t for t in tried if t.companion >= 0])
        pairs = [((t.law,), (listed[t.companion],), t.bic) for t in search.refined(beside)]
        first = _one_of_each([t for t in alone if t.companion < 0])[:COMPANIONS]
        more, _ = search.all([search.outside(made.whitened(_columns(made, t.law))) for t in first], with_noise=False)
        second = search.refined(_one_of_each([t for t in more if t.companion >= 0]))
        pairs += [((first[t.companion].law, t.law), (), t.bic) for t in second]
        found += judge.all(pairs)
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
        base = screen(made.y, made.nuisance, [], Known(made.classes, made.noise.dof), n_draws=1)
        return cls(made, project_out(made.y, U), project_out(z, U.astype(np.float32)), U, base.p_value)

    def outside(self, columns: np.ndarray) -> np.ndarray:
        """(M, r) Orthonormal basis of whitened columns outside the nuisance."""
        part = project_out(columns, self.U)
        size = np.linalg.norm(part, axis=0)
        return span(part / np.where(size > 0, size, 1.0), 1e-4)

    def best_listed(self) -> list[Candidate]:
        """The listed effects that gain most on their own, one variant of each."""
        best: dict[str, tuple[float, Candidate]] = {}
        for c in self.made.candidates:
            if c.effect is None:
                continue
            Q = self.outside(self.made.whitened(c.columns))
            gain = float(np.sum((Q.T @ self.y) ** 2)) - Q.shape[1] * float(np.log(len(self.y)))
            if gain > best.get(c.name, (0.0, c))[0]:
                best[c.name] = gain, c
        return [c for _, c in sorted(best.values(), key=lambda pair: -pair[0])][:COMPANIONS]

    def response(self, channel: Channel, places: tuple[str, ...]) -> np.ndarray:
        """(M, P) Whitened readings per unit deviation of each place."""
        at = self.made.point.situation
        ones = [np.broadcast_to(row, (len(at), len(places))) for row in np.eye(len(places))]
        return self.made.whitened(self.made.point.columns([channel.contribution(at, one) for one in ones]))

    def all(self, companions: Sequence[np.ndarray], with_noise: bool = True) -> tuple[list[_Tried], np.ndarray]:
        """Every law with its gain, alone and beside each companion (M, r), and the smallest p of laws alone on each
        draw, ascending."""
        null, out = np.ones(DRAWS), []
        for channel, places, found in laws(self.made.point.situation):
            response = self.response(channel, places)
            if not np.any(response):
                continue
            for width in (1, 2):
                same = [term for term in found if len(term.shape.text) == width]
                for first in range(0, len(same), BLOCK):
                    some = same[first : first + BLOCK]
                    tried, smallest = self.block(channel, places, response, some, companions, with_noise)
                    out += tried
                    null = np.minimum(null, smallest)
        return out, np.sort(null)

    def block(
        self,
        channel: Channel,
        places: tuple[str, ...],
        response: np.ndarray,
        found: Sequence[Term],
        companions: Sequence[np.ndarray],
        with_noise: bool,
    ) -> tuple[list[_Tried], np.ndarray]:
        """Some functions in all sharings on one channel."""
        beside = [self.y[:, None], *companions]
        at = np.cumsum([0, *(c.shape[1] for c in beside)])
        G, b, noise = self.moments(channel, response, found, np.hstack(beside), with_noise)
        out, null = [], np.ones(DRAWS)
        for sharing in sharings(channel, places):
            g = _shared_square(sharing, places, G)
            mine, by_chance = _shared(sharing, places, b), _shared(sharing, places, noise)
            moves = np.all(np.diagonal(g, axis1=1, axis2=2) > 0, axis=1)  # every amplitude must move something
            for k in range(len(beside)):
                inside, seen_by, level = g, mine[..., :1], 0.0
                if k:
                    X = mine[..., at[k] : at[k + 1]]
                    inside = g - X @ X.transpose(0, 2, 1)
                    own = companions[k - 1].T @ self.y
                    seen_by, level = seen_by - (X @ own)[..., None], float(own @ own)
                T, d = _gain(inside, seen_by, channel.size, g)
                p = np.where(d > 0, self.p_value(T[:, 0], np.maximum(d, 1)), 1.0)
                if k == 0 and with_noise:
                    T_noise, _ = _gain(inside, by_chance, channel.size, g)
                    for columns in np.unique(d[d > 0]):  # the largest gain at each number of columns decides
                        largest = T_noise[d == columns].max(axis=0)
                        null = np.minimum(null, self.p_value(largest, np.full(DRAWS, columns)))
                extra = companions[k - 1].shape[1] if k else 0
                for i in np.flatnonzero(moves & (d > 0)).tolist():
                    law = Law(channel, sharing, found[i], places)
                    cost = (int(d[i]) + extra + law.term.shape.searched) * np.log(len(self.y))
                    gain = float(T[i, 0]) + level
                    out.append(_Tried(law, gain, int(d[i]), float(p[i]), float(cost - gain), k - 1))
        return out, null

    def moments(
        self, channel: Channel, response: np.ndarray, found: Sequence[Term], beside: np.ndarray, with_noise: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """G (T, K, P, K·P), products with `beside` (T, K, P, r) and with the draws (T, K, P, n), for K functions at P
        places."""
        at, row = self.made.point.situation, self.made.row
        P = response.shape[1]
        F = np.stack([np.stack([np.broadcast_to(f, (len(at), P)) for f in term.values(at)]) for term in found])
        E = (response * F[:, :, row]).astype(np.float32)  # (T, K, M, P)
        T, K, M, _ = E.shape
        flat = E.transpose(2, 0, 1, 3).reshape(M, -1)
        U = self.U.astype(np.float32)
        flat = flat - U @ (U.T @ flat)
        b = (flat.T @ beside.astype(np.float32)).astype(float).reshape(T, K, P, -1)
        each = flat.reshape(M, T, K * P).transpose(1, 0, 2)
        G = np.matmul(each.transpose(0, 2, 1), each).astype(float).reshape(T, K, P, K * P)
        noise = (flat.T @ self.draws).reshape(T, K, P, -1) if with_noise else np.zeros((T, K, P, 0))
        return G, b, noise

    def refined(self, chosen: Sequence[_Tried]) -> list[_Tried]:
        """The best `TESTED` laws, at the best constant near the one that the grid had where a law stands alone."""
        return [self._refined(t) if t.companion < 0 and t.law.term.shape.refined else t for t in chosen[:TESTED]]

    def _refined(self, tried: _Tried) -> _Tried:
        law = tried.law
        response = self.response(law.channel, law.places)
        best, width = tried, 0.2 if law.term.shape.name == "settling" else 0.5 / max(law.term.constant, 1e-9)
        for _ in range(2):
            c = best.law.term.constant
            near = [replace(law.term, constant=float(f"{c * (1 + d):.5g}")) for d in np.linspace(-width, width, 15)]
            G, b, _ = self.moments(law.channel, response, near, self.y[:, None], False)
            g = _shared_square(law.sharing, law.places, G)
            T, d = _gain(g, _shared(law.sharing, law.places, b), law.channel.size, g)
            i = int(np.argmax(T[:, 0]))
            if T[i, 0] > best.gain and d[i] == best.d:
                more = float(T[i, 0]) - best.gain
                best = replace(best, law=replace(law, term=near[i]), gain=float(T[i, 0]), bic=best.bic - more)
            width /= 6
        return best


def _shared(sharing: str, places: tuple[str, ...], moments: np.ndarray) -> np.ndarray:
    """Moments (T, K, P, n) of all places as those of one sharing, (T, d, n)."""
    T, K, P, n = moments.shape
    if sharing == EACH:
        return moments.reshape(T, K * P, n)
    return moments[:, :, places.index(sharing)] if sharing in places else moments.sum(axis=2)


def _shared_square(sharing: str, places: tuple[str, ...], G: np.ndarray) -> np.ndarray:
    """G (T, K, P, K·P) of all places as that of one sharing, (T, d, d)."""
    T, K, P, _ = G.shape
    rows = _shared(sharing, places, G)
    if sharing == EACH:
        return rows
    columns = rows.transpose(0, 2, 1).reshape(T, K, P, K)
    return _shared(sharing, places, columns)


def _gain(G: np.ndarray, b: np.ndarray, size: float, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T (n_laws, n) = bᵀG⁺b over the directions that the largest amplitude would show, and their number (n_laws,).

    Args:
        whole: (n_laws, d, d) the moments before a companion was allowed for: a direction that it leaves less than 1e-4
            of is its own.
    """
    values, vectors = np.linalg.eigh(G)
    largest = np.trace(whole, axis1=1, axis2=2)[:, None]
    seen = (values > (INVISIBLE / (LARGE * size)) ** 2) & (values > 1e-4 * largest)
    inverse = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    turned = np.matmul(vectors.transpose(0, 2, 1), b)
    return np.einsum("td,tdn->tn", inverse, turned**2), seen.sum(axis=1)


def _one_of_each(tried: Sequence[_Tried]) -> list[_Tried]:
    """The best constant of each companion, channel, sharing and function, by BIC."""
    out: dict[tuple, _Tried] = {}
    for t in sorted(tried, key=lambda t: t.bic):
        term = t.law.term
        function = (term.shape.name, tuple(s.variable.words for s in term.variables))
        out.setdefault((t.companion, t.law.channel.words, t.law.sharing, function), t)
    return list(out.values())


@dataclass(frozen=True)
class _Judge:
    """The adequacy test of the diagnosis, for laws beside what it lists."""

    made: Problem
    p: float
    level: float
    seed: int
    reference: float
    """Critical value with nothing chosen, of the listed effects and the patterns."""

    @classmethod
    def of(cls, made: Problem, p: float, level: float, seed: int) -> _Judge:
        null = adequacy.null_distribution(made.screen(seed=seed))
        return cls(made, p, level, seed, float(np.quantile(null, level)))

    def all(self, wanted: Sequence[tuple[tuple[Law, ...], tuple[Candidate, ...], float]]) -> list[Proposal]:
        """Explanations (laws, listed effects beside them, BIC) with what the data say of them, the best BIC first."""
        made, n = self.made, len(self.made.groups)
        wanted = sorted(wanted, key=lambda w: w[2])[:TESTED]
        wanted = [w for w in wanted if w[2] < wanted[0][2] + BEHIND]
        every = list(dict.fromkeys(law for some, _, _ in wanted for law in some))
        groups = [
            Group(law.words(), made.whitened(_columns(made, law)), np.full(law.columns, law.channel.size))
            for law in every
        ]
        noise = Known(made.classes, made.noise.dof)
        from_rest = made.noise.source == "residuals" or made.noise.pooled
        whole = screen(made.y, made.nuisance, [*made.groups, *groups], noise, from_rest=from_rest, seed=self.seed)
        named = {id(c): i for i, c in enumerate(made.candidates)}
        out = []
        for chosen_laws, beside, bic in wanted:
            if sum(f.adequate for f in out) >= ENOUGH:
                break
            mine = [n + every.index(law) for law in chosen_laws]
            chosen = [*mine, *(named[id(c)] for c in beside)]
            tested = _keeping(whole, [*range(n), *mine])
            places = [*range(n, n + len(mine)), *chosen[len(mine) :]]
            theta, sigma = whole.estimate(chosen)
            Q = whole.joint(chosen)
            signal = Q @ (Q.T @ whole.y)
            out.append(
                Proposal(
                    laws=chosen_laws,
                    beside=beside,
                    theta=tuple(theta[: len(chosen_laws)]),
                    sigma=tuple(sigma[: len(chosen_laws)]),
                    s=float(np.linalg.norm(signal)),
                    p=self.p,
                    bic=bic,
                    adequate=adequacy.is_adequate(tested, places, self.level, self.reference),
                    rest=float(adequacy.p_values(tested, places).smallest),
                    listed=_as_listed(made, whole, signal),
                    signal=whole.basis @ signal,
                )
            )
        return out


def _as_listed(made: Problem, whole: Screen, signal: np.ndarray) -> tuple[str, ...]:
    """Names of the listed effects that can make a signal (D,) within what the data can tell."""
    blocks = whole.blocks[: len(made.candidates)]
    near = [np.linalg.norm(signal - block @ (block.T @ signal)) < ALIKE for block in blocks]
    return tuple(dict.fromkeys(c.name for c, close in zip(made.candidates, near, strict=True) if close))


def _keeping(whole: Screen, keep: Sequence[int]) -> Screen:
    """A screen with some of its groups, in the same coordinates."""

    def some(values: tuple) -> tuple:
        return tuple(values[g] for g in keep)

    return replace(
        whole, names=some(whole.names), blocks=some(whole.blocks), parts=some(whole.parts),
        trials=whole.trials[list(keep)], full=some(whole.full), scale=some(whole.scale), limit=some(whole.limit),
    )  # fmt: skip


def _columns(made: Problem, law: Law) -> np.ndarray:
    at = made.point.situation
    return made.point.columns([law.contribution(at, row) for row in np.eye(law.columns)])


def _families(found: Sequence[Proposal]) -> list[Family]:
    """Classes of explanations with nearly one signal: adequate ones first, the simplest of each class in front."""
    left = sorted(found, key=lambda p: (not p.adequate, p.bic))
    out = []
    while left:
        head, *others = left
        mine = [p for p in others if np.linalg.norm(p.signal - head.signal) < ALIKE and p.adequate == head.adequate]
        members = sorted([head, *mine], key=lambda p: (p.complexity, p.bic))
        out.append(Family(tuple(members)))
        left = [p for p in others if all(p is not m for m in mine)]
    return out
