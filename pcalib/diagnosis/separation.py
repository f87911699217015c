"""Rows that can tell effects apart, chosen before anything is measured.

If effect A acts at its usual size and a fit uses effect B in its place, the fit leaves

    Δ(A|B) = min_{k, θ_B} |E_A·θ_A − J·k − E_B·θ_B|²

noise units squared (T-optimality, Atkinson & Fedorov 1975). The geometry k is free, as it is in a diagnosis; only
directions that the rows see with less than ε = 0.05 noise units per tolerance are held at the drawing.
Rows are taken one by one from a pool of reachable poses under all conditions at hand; each is the one that raises the
poorly separated pairs most. With the geometry eliminated, all of it follows from one small matrix,

    S = EᵀE − EᵀJ·(JᵀJ + ε²·I)⁻¹·JᵀE,    Δ(A|B) = θ_Aᵀ(S_AA − S_AB·S_BB⁻¹·S_BA)θ_A

in which ε² is a prior of 1/ε tolerances: while rows are chosen it stands in for the exact elimination, with which the
separations of the chosen rows are computed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pcalib import effects, planning, prediction
from pcalib.diagnosis.hypothesis import Hypothesis
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.screen import NUISANCE, project_out, span
from pcalib.errors import EffectError, InputError, unknown
from pcalib.fitting.identifiability import priors
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot

TOLD = 5.0
"""Noise units from which on two effects are told apart nine times out of ten (power of the test, docs/diagnosis.md)."""
ALIAS = 0.02
"""Share of an effect's visible size below which what another effect leaves of it counts as nothing: an exact alias."""
REPEATED = 1 / 6
"""Share of rows that repeat an earlier one, so that the noise is verified: 10 of 60, as the noise estimate asks."""
POOL = 900
"""Poses that rows are chosen from."""
PACE = 60.0
"""[s] from one row to the next."""


@dataclass(frozen=True)
class AtHand:
    """Conditions that rows may be measured under."""

    payloads: Sequence[float] = (0.0, 1.0, 2.0)
    """[kg]"""
    tools: np.ndarray | None = None
    """(T, 3) [m], plate frame; the plate's centre where absent."""
    temperatures: Sequence[float] = ()
    """[°C] that arms, rods and base can be brought to; none: 20 °C, and no effect of temperature shows."""
    directions: bool = True
    """Whether joints can be approached from either side."""


@dataclass(frozen=True)
class Separation:
    """Rows to measure and how far they tell effects apart."""

    names: tuple[str, ...]
    """Effects that were asked for and that the conditions can show."""
    hidden: dict[str, str]
    """Effects that no row under these conditions shows, and why."""
    matrix: np.ndarray
    """(K, K) [noise units] what a fit with effect j leaves where effect i acts at its usual size; on the diagonal the
    size of effect i that the geometry leaves visible."""
    alias: np.ndarray
    """(K, K) bool, j makes good all that i does: no row tells them apart."""
    q: np.ndarray
    """(n, nq) [rad or m], in the order of time."""
    conditions: Conditions
    pose_id: np.ndarray
    """(n,) replicates share one; −1: no replicate."""
    position: np.ndarray
    """(n, 3) [m] nominal position of the measured point."""

    @property
    def faint(self) -> list[tuple[str, float]]:
        """Effects that stay below `TOLD` noise units at their usual size, whatever is compared with them."""
        own = np.diag(self.matrix)
        return sorted(((n, float(s)) for n, s in zip(self.names, own, strict=True) if s < TOLD), key=lambda e: e[1])

    @property
    def poorest(self) -> list[tuple[str, str, float]]:
        """Pairs (a, b) of which a visible effect a leaves less than `TOLD` to a fit with b, aliases apart, the poorest
        first."""
        own, both = np.diag(self.matrix), self.alias | self.alias.T
        weak = (own[:, None] >= TOLD) & (self.matrix < TOLD) & ~both & ~np.eye(len(own), dtype=bool)
        found = {}
        for i, j in np.argwhere(weak):
            pair = (self.names[i], self.names[j])
            if self.matrix[i, j] < found.get(pair[::-1], (np.inf,))[0]:
                found.pop(pair[::-1], None)
                found[pair] = (float(self.matrix[i, j]),)
        return sorted(((a, b, least) for (a, b), (least,) in found.items()), key=lambda pair: pair[2])

    @property
    def aliases(self) -> list[tuple[str, str]]:
        """Pairs that no row tells apart."""
        K = len(self.names)
        both = self.alias | self.alias.T
        return [(self.names[j], self.names[i]) for i in range(K) for j in range(i) if both[i, j]]


def plan(
    robot: Robot,
    n: int,
    sigma: np.ndarray,
    wanted: Sequence[str] = (),
    at_hand: AtHand | None = None,
    level: str = "complete",
    seed: int = 0,
) -> Separation:
    """Rows that make every pair of effects as distinguishable as n rows can.

    Args:
        sigma: (6,) [m, rad] 1σ of the instrument; inf where a component is not measured.
        wanted: names of effects; all that the robot can have when empty.

    Raises:
        EffectError: an effect is unknown or makes no sense on the robot.
        InputError: too few rows, or fewer than two effects that the conditions can show.
    """
    if n < 6:
        raise InputError(f"{n} rows cannot tell effects apart", remedy="ask for 6 rows at least; 60 are usual")
    at_hand = at_hand or AtHand()
    rng = np.random.default_rng(seed)
    found, hidden = _hypotheses(robot, wanted, at_hand)
    distinct = n - int(n * REPEATED)
    q, conditions = _pool(robot, at_hand, distinct, rng)
    pool = _Columns.of(robot, found, q, conditions, sigma, level)
    shown = [bool(np.any(pool.of_effect(k))) for k in range(len(found))]
    hidden |= {h.name: "these conditions do not show it" for h, seen in zip(found, shown, strict=True) if not seen}
    if sum(shown) < 2:
        raise InputError(
            "fewer than two effects can be seen under these conditions",
            remedy="name more conditions: --payload 0,2kg, --temperature 18,26degC, a second --tool",
        )
    pool = pool.keeping(shown)
    rows = np.array(_chosen(pool, distinct))
    rows = rows[np.argsort(conditions.columns["time"][rows], kind="stable")]
    rows, pose_id = _with_replicates(rows, n - distinct)
    columns = dict(conditions.take(rows).columns) | {"time": PACE * np.arange(n)}
    final = Conditions(conditions.tool[rows], conditions.payload[rows], columns)
    kept = [h for h, seen in zip(found, shown, strict=True) if seen]
    measured = _Columns.of(robot, kept, q[rows], final, sigma, level)
    S = measured.reduced(np.arange(n))
    matrix, alias = _matrix(S, measured)
    names = tuple(h.name for h in kept)
    return Separation(names, hidden, matrix, alias, q[rows], final, pose_id, measured.position)


@dataclass(frozen=True)
class _Columns:
    """Whitened columns of rows: geometry per prior, then effects per usual size."""

    geometry: np.ndarray
    """(N, 6, n)."""
    effects: np.ndarray
    """(N, 6, p)."""
    slices: tuple[slice, ...]
    """Columns of each effect."""
    position: np.ndarray
    """(N, 3) [m]."""

    @classmethod
    def of(
        cls,
        robot: Robot,
        found: Sequence[Hypothesis],
        q: np.ndarray,
        conditions: Conditions,
        sigma: np.ndarray,
        level: str,
    ) -> _Columns:
        model = Model.nominal(robot)
        p = prediction.predict(model, q, conditions)
        point = Point.of(model, p, conditions)
        chosen = robot.mechanism.levels[level]
        J = prediction.geometry_columns(model, p, point.closure, point.JX, chosen.basis) * priors(chosen.units)
        parts = [h.columns(point) * h.scale(model) for h in found]
        per = np.where(np.isfinite(sigma), 1.0 / sigma, 0.0)[:, None]
        whole = np.concatenate([*parts, np.zeros((len(q), 6, 0))], axis=-1)
        return cls(np.nan_to_num(J) * per, np.nan_to_num(whole) * per, _slices(parts), p.position)

    def of_effect(self, k: int) -> np.ndarray:
        """(N, 6, p_k)."""
        return self.effects[:, :, self.slices[k]]

    def keeping(self, shown: Sequence[bool]) -> _Columns:
        """The columns of the geometry and of the effects that the rows show, (n_effects,) each."""
        parts = [self.of_effect(k) for k, seen in enumerate(shown) if seen]
        return _Columns(self.geometry, np.concatenate(parts, axis=-1), _slices(parts), self.position)

    def reduced(self, rows: np.ndarray) -> np.ndarray:
        """S (p, p) of some rows, with the geometry that they see projected out."""
        J = self.geometry[rows].reshape(-1, self.geometry.shape[-1])
        E = self.effects[rows].reshape(-1, self.effects.shape[-1])
        left = project_out(E, span(J, NUISANCE))
        return left.T @ left


def _slices(parts: Sequence[np.ndarray]) -> tuple[slice, ...]:
    """Where the columns of each part stand when all are side by side."""
    ends = [0, *np.cumsum([part.shape[-1] for part in parts]).tolist()]
    return tuple(slice(a, b) for a, b in pairwise(ends))


def _matrix(S: np.ndarray, columns: _Columns) -> tuple[np.ndarray, np.ndarray]:
    """What each effect leaves of each other (K, K) [noise units], and which are exact aliases."""
    K = len(columns.slices)
    out = np.zeros((K, K))
    for i in range(K):
        for j in range(K):
            out[i, j] = np.sqrt(_left(S, columns.slices[i], columns.slices[j])[0] if i != j else _own(S, columns, i))
    return out, (out < ALIAS * np.diag(out)[:, None]) & ~np.eye(K, dtype=bool)


def _own(S: np.ndarray, columns: _Columns, i: int) -> float:
    return float(np.sum(S[columns.slices[i], columns.slices[i]]))


def _left(S: np.ndarray, a: slice, b: slice) -> tuple[float, np.ndarray]:
    """Δ(A|B) at usual size, and B's parameters in the fit."""
    theta = np.ones(a.stop - a.start)
    fitted, *_ = np.linalg.lstsq(S[b, b], S[b, a] @ theta, rcond=1e-9)
    return max(float(theta @ S[a, a] @ theta - fitted @ S[b, a] @ theta), 0.0), fitted


def _chosen(pool: _Columns, n: int) -> list[int]:
    """n rows of the pool, greedily: each raises the poorly separated pairs most."""
    p = pool.effects.shape[-1]
    pairs = [(i, j) for i in range(len(pool.slices)) for j in range(len(pool.slices)) if i != j]
    J, E = pool.geometry, pool.effects
    G = NUISANCE**2 * np.eye(J.shape[-1] + p)
    G[J.shape[-1] :, J.shape[-1] :] = 1e-9 * np.eye(p)
    both = np.concatenate([J, E], axis=-1)
    m = J.shape[-1]
    taken: list[int] = []
    for _ in range(n):
        taken_up = np.linalg.solve(G[:m, :m], G[:m, m:])
        S = G[m:, m:] - G[m:, :m] @ taken_up
        left = E - J @ taken_up
        V, delta = np.zeros((p, len(pairs))), np.zeros(len(pairs))
        for c, (i, j) in enumerate(pairs):
            a, b = pool.slices[i], pool.slices[j]
            delta[c], fitted = _left(S, a, b)
            V[a, c] = 1.0
            V[b, c] -= fitted
        gain = np.sum((left @ V) ** 2, axis=1)  # (N, pairs)
        # What a pair gains counts the more the further it is from being told apart, and nothing beyond that.
        worth = (np.minimum(np.sqrt(delta + gain), TOLD) - np.minimum(np.sqrt(delta), TOLD)) / (1 + delta)
        total = worth.sum(axis=1) + 1e-6 * gain.sum(axis=1)
        total[taken] = -1.0
        pick = int(np.argmax(total))
        taken.append(pick)
        G += both[pick].T @ both[pick]
    return taken


def _hypotheses(robot: Robot, wanted: Sequence[str], at_hand: AtHand) -> tuple[list[Hypothesis], dict[str, str]]:
    """The effects that are asked about, in their simplest form, and those that this robot or plan cannot show."""
    found, hidden = [], {}
    for name in wanted:
        if name not in effects.names():
            raise EffectError(unknown("effect", name, effects.names()))
    for name in wanted or effects.names():
        effect = effects.get(name)
        why = effect.unsuited(robot.mechanism)
        if why and wanted:
            raise EffectError(f"effect {name} makes no sense on robot '{robot.name}': {why}")
        if not why and effect.indirect:
            why = "it acts only through other effects"
        if not why and not at_hand.temperatures and any(need.startswith("temp") for need in effect.needs):
            why = "no temperatures are at hand (--temperature 18,26degC)"
        if why:
            hidden[name] = why
            continue
        found.append(Hypothesis.of(effects.get(name, None, robot)))
    return found, hidden


def _pool(robot: Robot, at_hand: AtHand, slots: int, rng: np.random.Generator) -> tuple[np.ndarray, Conditions]:
    """Reachable poses under conditions drawn from those at hand."""
    q = planning.reachable(robot, POOL, rng).q
    N, nq = q.shape
    tools = np.zeros((1, 3)) if at_hand.tools is None else np.atleast_2d(at_hand.tools)
    columns: dict[str, np.ndarray] = {"time": PACE * rng.integers(0, slots, N)}
    if at_hand.temperatures:
        columns |= {f"temp_{part}": rng.choice(np.asarray(at_hand.temperatures, float), N) for part in _PARTS}
    if at_hand.directions:
        columns |= {f"dir{i + 1}": rng.choice([-1.0, 1.0], N) for i in range(nq)}
    payload = rng.choice(np.asarray(at_hand.payloads, float), N)
    return q, Conditions(tools[rng.integers(0, len(tools), N)], payload, columns)


_PARTS = ("arms", "rods", "base")


def _with_replicates(rows: np.ndarray, more: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows with `more` of them repeated a third of the session later, and their pose_id (n,).

    Replicates back to back would share what drifts slowly, and so not stand for the noise.
    """
    repeated = np.unique(np.linspace(0, len(rows) - 1, more).astype(int)) if more else np.zeros(0, int)
    apart = max(len(rows) // 3, 1)
    order: list[tuple[float, int, int]] = [(float(i), int(row), -1) for i, row in enumerate(rows)]
    for number, i in enumerate(repeated):
        order[i] = (float(i), int(rows[i]), number)
        order.append(((i + apart) % len(rows) + 0.5, int(rows[i]), number))
    order.sort()
    return np.array([row for _, row, _ in order]), np.array([number for _, _, number in order])
