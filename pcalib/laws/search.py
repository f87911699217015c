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
from itertools import pairwise

import numpy as np

from pcalib.diagnosis import adequacy
from pcalib.diagnosis.candidates import Candidate
from pcalib.diagnosis.problem import Problem
from pcalib.diagnosis.screen import INVISIBLE, LARGE, NUISANCE, project_out, screen, span
from pcalib.laws.channels import Channel
from pcalib.laws.functions import Term
from pcalib.laws.grammar import EACH, Law, at_places, laws, repeated, sharings
from pcalib.laws.judge import TESTED, Judge, columns
from pcalib.laws.proposal import Proposals, families

DRAWS = 256
"""Draws of pure noise on which the whole search is repeated: they resolve corrected p values down to 0.04, below which
these are continued in proportion."""
COMPANIONS = 4
"""Listed effects, and laws, beside which a further law is searched for: those that gain most on their own."""
BLOCK = 96
"""Functions that are evaluated at once: bounds memory at some 100 MB."""


@dataclass(frozen=True)
class _Tried:
    law: Law
    gain: float
    d: int
    bic: float
    companion: int = -1
    """Index of the companion beside which the law stands; −1: none."""


@dataclass(frozen=True)
class _Scan:
    """The results of trying many laws."""

    tried: list[_Tried]
    """The best constant of every function, in each sharing and beside each companion."""
    count: int
    """Laws that were tried."""
    p: float
    """Smallest p of a law alone, or of one beside a companion times the number of companions (Bonferroni); not
    corrected for the laws that were tried."""
    null: np.ndarray
    """(DRAWS,) the smallest p of laws alone on each draw of noise."""


def propose(made: Problem, seed: int = 0, companions: int = COMPANIONS) -> Proposals:
    """Laws that explain what a model leaves over, by classes; none where their search finds as much in pure noise.

    Args:
        companions: listed effects beside which laws are tried too.
    """
    search = _Search.of(made, seed)
    listed = search.best_listed(companions)
    scan = search.all([search.outside(made.whitened(c.columns)) for c in listed])
    if not scan.count:
        return Proposals((), 0, 1.0, made)
    p = adequacy.corrected_far(scan.p, scan.null)
    if p > adequacy.ALPHA:
        return Proposals((), scan.count, p, made)
    tried = scan.tried
    judge = Judge.of(made, p, adequacy.AGAINST[0], seed)
    alone = search.refined(_one_of_each([t for t in tried if t.companion < 0]))
    found = judge.all([((t.law,), (), t.bic) for t in alone])
    if not any(f.adequate for f in found):
        beside = _one_of_each([t for t in tried if t.companion >= 0])
        pairs = [((t.law,), (listed[t.companion],), t.bic) for t in search.refined(beside)]
        first = _one_of_each([t for t in alone if t.companion < 0])[:COMPANIONS]
        more = search.all([search.outside(made.whitened(columns(made, t.law))) for t in first], with_noise=False)
        second = search.refined(_one_of_each([t for t in more.tried if t.companion >= 0]))
        pairs += [((first[t.companion].law, t.law), (), t.bic) for t in second]
        found += judge.all(pairs)
    return Proposals(tuple(families(found)), scan.count, p, made)


@dataclass(frozen=True)
class _Search:
    """The arrays of a search."""

    made: Problem
    y: np.ndarray
    """(M,) Residuals outside the nuisance."""
    draws: np.ndarray
    """(M, n) float32, draws of pure noise outside the nuisance."""
    U: np.ndarray
    """(M, r) Orthonormal basis of the nuisance."""
    p_value: Callable[[np.ndarray, np.ndarray], np.ndarray]

    @classmethod
    def of(cls, made: Problem, seed: int) -> _Search:
        U = span(made.nuisance, NUISANCE)
        rng = np.random.default_rng(seed)
        z = rng.standard_normal((len(made.y), DRAWS), dtype=np.float32)
        for c, dof in enumerate(made.known.dof):  # the doubt about the noise level belongs to the noise
            if np.isfinite(dof):
                z[made.classes == c] *= np.sqrt(dof / rng.chisquare(dof, DRAWS)).astype(np.float32)
        base = screen(made.y, made.nuisance, [], made.known, n_draws=1)
        return cls(made, project_out(made.y, U), project_out(z, U.astype(np.float32)), U, base.p_value)

    def outside(self, columns: np.ndarray) -> np.ndarray:
        """(M, r) Orthonormal basis of whitened columns outside the nuisance."""
        part = project_out(columns, self.U)
        size = np.linalg.norm(part, axis=0)
        return span(part / np.where(size > 0, size, 1.0), 1e-4)

    def best_listed(self, most: int) -> list[Candidate]:
        """The listed effects that gain most on their own, one variant of each."""
        best: dict[str, tuple[float, Candidate]] = {}
        for c in self.made.candidates:
            if c.effect is None:
                continue
            Q = self.outside(self.made.whitened(c.columns))
            gain = float(np.sum((Q.T @ self.y) ** 2)) - Q.shape[1] * float(np.log(len(self.y)))
            if gain > best.get(c.name, (0.0, c))[0]:
                best[c.name] = gain, c
        return [c for _, c in sorted(best.values(), key=lambda pair: -pair[0])][:most]

    def response(self, channel: Channel, places: tuple[str, ...]) -> np.ndarray:
        """(M, P) Whitened readings per unit deviation of each place."""
        at = self.made.point.situation
        ones = [np.broadcast_to(row, (len(at), len(places))) for row in np.eye(len(places))]
        return self.made.whitened(self.made.point.columns([channel.contribution(at, one) for one in ones]))

    def all(self, companions: Sequence[np.ndarray], with_noise: bool = True) -> _Scan:
        """Every law, alone and beside each companion (M, r); `null` ascending."""
        out = _Scan([], 0, 1.0, np.ones(DRAWS))
        for channel, places, found in laws(self.made.point.situation):
            response = self.response(channel, places)
            if not np.any(response):
                continue
            for width in (1, 2):
                same = [term for term in found if len(term.shape.text) == width]
                for first in range(0, len(same), BLOCK):
                    some = same[first : first + BLOCK]
                    more = self.block(channel, places, response, some, companions, with_noise)
                    out = _Scan(
                        out.tried + more.tried, out.count + more.count, min(out.p, more.p),
                        np.minimum(out.null, more.null),
                    )  # fmt: skip
        return replace(out, null=np.sort(out.null))

    def block(
        self,
        channel: Channel,
        places: tuple[str, ...],
        response: np.ndarray,
        found: Sequence[Term],
        companions: Sequence[np.ndarray],
        with_noise: bool,
    ) -> _Scan:
        """Some functions in all sharings on one channel; those that differ by a constant follow each other."""
        beside = [self.y[:, None], *companions]
        at = np.cumsum([0, *(c.shape[1] for c in beside)])
        G, b, noise = self.moments(channel, response, found, np.hstack(beside), with_noise)
        searched = np.array([term.shape.searched for term in found])
        run = np.cumsum([0, *(_function(a) != _function(b) for a, b in pairwise(found))])
        out, count, smallest, null = [], 0, 1.0, np.ones(DRAWS)
        for sharing in sharings(channel, places):
            g = _shared_square(sharing, places, G)
            mine, by_chance = _shared(sharing, places, b), _shared(sharing, places, noise)
            moves = np.all(np.diagonal(g, axis1=1, axis2=2) > 0, axis=1)  # every amplitude must move something
            if sharing in places:
                moves &= [not repeated(term, channel) for term in found]
            for k in range(len(beside)):
                inside, seen_by, level = g, mine[..., :1], 0.0
                if k:
                    X = mine[..., at[k] : at[k + 1]]
                    inside = g - X @ X.transpose(0, 2, 1)
                    own = companions[k - 1].T @ self.y
                    seen_by, level = seen_by - (X @ own)[..., None], float(own @ own)
                T, d = _gain(inside, seen_by, channel.size, g)
                p = np.where(d > 0, self.p_value(T[:, 0], np.maximum(d, 1)), 1.0)
                tries = len(companions) if k else 1
                if k == 0 and with_noise:
                    T_noise, _ = _gain(inside, by_chance, channel.size, g)
                    for columns in np.unique(d[d > 0]):  # the largest gain at each number of columns decides
                        largest = T_noise[d == columns].max(axis=0)
                        null = np.minimum(null, self.p_value(largest, np.full(DRAWS, columns)))
                extra = companions[k - 1].shape[1] if k else 0
                counted = moves & (d > 0)
                gain = T[:, 0] + level
                bic = np.where(counted, (d + extra + searched) * np.log(len(self.y)) - gain, np.inf)
                count += int(counted.sum())
                smallest = min(smallest, tries * float(p[counted].min(initial=1.0)))
                for i in _first_of_each(run, bic):
                    law = Law(channel, sharing, found[i], places)
                    out.append(_Tried(law, float(gain[i]), int(d[i]), float(bic[i]), k - 1))
        return _Scan(out, count, smallest, null)

    def moments(
        self, channel: Channel, response: np.ndarray, found: Sequence[Term], beside: np.ndarray, with_noise: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """G (T, K, P, K·P), products with `beside` (T, K, P, r) and with the draws (T, K, P, n), for K functions at P
        places."""
        at, row = self.made.point.situation, self.made.row
        P = response.shape[1]
        functions = [at_places(term, channel, at) for term in found]
        F = np.stack([np.stack([np.broadcast_to(f, (len(at), P)) for f in some]) for some in functions])
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


def _function(term: Term) -> tuple[str, ...]:
    """Shape and variables of a function: functions that are equal in these differ by a constant."""
    return (term.shape.name, *(s.variable.words for s in term.variables))


def _first_of_each(run: np.ndarray, bic: np.ndarray) -> list[int]:
    """Indices of the lowest finite bic (n,) in each run of equal numbers (n,)."""
    order = np.lexsort((bic, run))
    first = order[np.r_[True, np.diff(run[order]) > 0]]
    return first[np.isfinite(bic[first])].tolist()


def _one_of_each(tried: Sequence[_Tried]) -> list[_Tried]:
    """The best constant of each companion, channel, sharing and function, by BIC."""
    out: dict[tuple, _Tried] = {}
    for t in sorted(tried, key=lambda t: t.bic):
        out.setdefault((t.companion, t.law.channel.words, t.law.sharing, _function(t.law.term)), t)
    return list(out.values())
