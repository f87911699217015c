"""The next measurement: poses, payloads, directions and temperatures that tell rival explanations apart.

T-optimal design (Atkinson & Fedorov 1975). If explanation A is true at its fitted size, a fit with B in its place
leaves, over all readings old and new,

    Δ(A|B) = min_{k, θ_B, frame} |E_A·θ_A − J·k − E_B·θ_B|²

noise units squared. Rows are added one by one so that the smaller of Δ(A|B) and Δ(B|A) grows most; the fit is free
to bend its geometry all the while, which is what makes many poses useless.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcalib import planning, prediction
from pcalib.data import readings as sensed
from pcalib.data.measurement import Measurements
from pcalib.data.readings import Readings
from pcalib.diagnosis.hypothesis import Hypothesis, Kind, resolve
from pcalib.diagnosis.point import Point
from pcalib.diagnosis.problem import Problem, problem, spread, unknowns_for
from pcalib.effects.base import Effect
from pcalib.errors import EffectError, InputError
from pcalib.fitting import linearisation
from pcalib.fitting.unknowns import Unknowns
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.robot import Robot
from pcalib.workspace import reachable

ENOUGH = 5.0
"""s, noise units: from about here on rivals are told apart nine times out of ten."""
TEMPERATURE_SWING = 8.0
"""[K] about 22 °C that a plan may ask for where a rival answers to temperature."""
SENSIBLE = 500
"""Rows beyond which nobody measures to tell two explanations apart."""
LATER = 3600.0
"""[s] a plan may ask for rows that much later where a rival answers to time."""


Rival = Sequence[Hypothesis]
"""One explanation; an empty one is 'nothing is missing'."""


@dataclass(frozen=True)
class Options:
    """Conditions that a plan may choose from."""

    payloads: Sequence[float] | None = None
    """[kg] payloads to measure with; None: those of the data, or 0, 1 and 2 kg where the data have but one."""
    tools: np.ndarray | None = None
    """(T, 3) [m] tools to measure with; None: those of the data."""
    candidates: int = 1200
    seed: int = 0


@dataclass(frozen=True)
class NextRows:
    """Rows to measure, the most telling first."""

    q: np.ndarray
    """(n, nq) [rad or m]."""
    conditions: Conditions
    position: np.ndarray
    """(n, 3) [m] where the model expects the measured point, measuring frame."""
    between: tuple[str, str]
    before: float
    """s between the rivals as the data stand."""
    after: np.ndarray
    """(n,) s after each further row."""
    more_of_the_same: float
    """s after n further rows under conditions like those of the data."""
    readings: Readings | None = None
    """What each row is read with; None where all rows read poses."""

    @property
    def enough(self) -> int | None:
        """How many rows suffice; None where all of them do not."""
        good = np.flatnonzero(self.after >= ENOUGH)
        return int(good[0]) + 1 if len(good) else None

    @property
    def needed(self) -> float:
        """How many rows it would take if further ones brought as much as these do on average."""
        growth = (self.after[-1] ** 2 - self.before**2) / len(self.after)
        short = max(ENOUGH**2 - self.before**2, 0.0)
        return short / growth if growth > 1e-12 else np.inf if short else 0.0

    @property
    def hopeless(self) -> bool:
        """Whether no sensible number of such rows tells the two apart."""
        return self.before < ENOUGH and self.enough is None and self.needed > SENSIBLE

    def sentence(self) -> str:
        """What the rows bring, in words."""
        a, b = self.between
        n = len(self.q)
        text = (
            f"Between {a} and {b} the data have {self.before:.1f} noise units; "
            f"with these {n} rows {self.after[-1]:.1f}, with {n} more like those you have {self.more_of_the_same:.1f}"
        )
        if self.more_of_the_same < min(ENOUGH, 0.7 * self.after[-1]):
            text += ": more of the same will not tell"
        if self.before >= ENOUGH:
            return text + f". {ENOUGH:.0f} are needed, so these data should tell them apart already."
        text += f". {ENOUGH:.0f} are needed"
        if self.enough is not None:
            return f"{text}: the first {self.enough} should do."
        if not self.hopeless:
            rows = f"{float(f'{self.needed:.2g}'):.0f}"
            return f"{text}: about {rows} such rows, or fewer with a larger payload or a longer tool."
        alone = next((name for name in self.between if "nothing" in self.between and name != "nothing"), "")
        same = f"Leave {alone} out" if alone else "Treat the two as one"
        return (
            f"{text}, and no sensible number of such rows brings them. "
            f"{same}: for poses and loads like these both lead to the same commands."
        )


def next_rows(
    model: Model,
    data: Measurements,
    between: Sequence[str],
    n: int = 6,
    own: Sequence[Effect] = (),
    options: Options | None = None,
) -> NextRows:
    """Rows to measure that tell two explanations apart, the most telling first.

    Args:
        model: a model that has neither explanation.
        data: the measurements so far.
        between: two explanations: names of effects, geometry levels or parts of the robot, several joined by +, or
            'nothing'. Of parts one is asked which of them changed since the model's session: the rest of the geometry
            is held by what its fit knew.
        n: how many rows.
        own: the user's own effects.

    Raises:
        EffectError: a name that is unknown or that the model has already.
        InputError: not two different explanations, or no rows.
    """
    rivals = [
        [resolve(name, model, own, parts=True) for name in side.split("+") if name != "nothing"] for side in between
    ]
    if held(rivals):
        if model.posterior is None:
            raise InputError(
                "the model keeps no uncertainty of its fit, which a plan for parts needs",
                remedy="fit it again from the data of its session: pcalib fit DATA.csv --robot R.toml -o MODEL.toml",
            )
        if data.frame == "tracker":  # the tracker was set up anew for the session
            model = replace(model, frame=None)
    return plan(problem(model, data, own), rivals, n, options)


def held(rivals: Sequence[Rival]) -> bool:
    """Whether parts are asked about, so that the geometry is held by the model's posterior and not fitted anew."""
    return any(h.kind is Kind.PART for rival in rivals for h in rival)


def plan(made: Problem, rivals: Sequence[Rival], n: int, options: Options | None = None) -> NextRows:
    """Rows that tell two explanations apart.

    Args:
        made: the model, which has neither explanation, on its data.
        rivals: two sets of hypotheses.
        n: how many rows.

    Raises:
        InputError: not two different rivals, or no rows.
    """
    options = options or Options()
    names = ["+".join(e.name for e in rival) or "nothing" for rival in rivals]
    if len(rivals) != 2 or names[0] == names[1]:
        raise InputError(
            "--between takes two different explanations", remedy="e.g. drive_compliance,encoder_eccentricity"
        )
    if not 1 <= n <= options.candidates:
        raise InputError(f"-n {n} rows make no plan", remedy=f"ask for at least 1, at most {options.candidates}")
    rng = np.random.default_rng(options.seed)
    unknowns = unknowns_for(made.model, made.data)
    measure = _Instrument.of(made)
    data = made.data
    needs = {need for rival in rivals for e in rival for need in e.needs}
    known = _neutral(linearisation.conditions_of(data), needs)
    old = _rows(made, rivals, unknowns, data.q, known, lambda _, columns: made.in_noise_units(columns), data.readings)
    theta = [_size(made, old, side, held(rivals)) for side in range(2)]
    start = [_Discrepancy.start(old, theta[side], side) for side in range(2) if rivals[side]]

    q, conditions, like = _candidates(made, rivals, options, rng)
    read = None if data.readings is None else data.readings.take(like)
    new = _rows(made, rivals, unknowns, q, conditions, measure.like(data, like).whitened, read)
    usable = new.ok.copy()
    states, chosen, after = start, [], []
    for _ in range(min(n, int(usable.sum()))):
        totals = np.stack([d.value + d.gains(new) for d in states])
        score = np.where(usable, totals.min(axis=0) + 1e-3 * totals.sum(axis=0), -np.inf)
        pick = int(np.argmax(score))
        usable[pick] = False
        chosen.append(pick)
        states = [d.added(new, pick) for d in states]
        after.append(min(d.value for d in states))

    q_same, known_same, like = _similar(made, known, n, rng)
    again = None if data.readings is None else data.readings.take(like)
    similar = _rows(made, rivals, unknowns, q_same, known_same, measure.like(data, like).whitened, again)
    same = start
    for row in np.flatnonzero(similar.ok):
        same = [d.added(similar, int(row)) for d in same]
    return NextRows(
        q=q[chosen],
        conditions=conditions.take(np.array(chosen)),
        position=new.position[chosen],
        between=(names[0], names[1]),
        before=float(np.sqrt(min(d.value for d in start))),
        after=np.sqrt(np.array(after)),
        more_of_the_same=float(np.sqrt(min(d.value for d in same))),
        readings=None if read is None else read.take(np.array(chosen)),
    )


@dataclass(frozen=True)
class _Rows:
    """Columns of some rows in noise units, padded to six readings each."""

    nuisance: np.ndarray
    """(N, 6, n) scaled by priors."""
    rivals: tuple[np.ndarray, np.ndarray]
    """(N, 6, p) each, scaled by priors."""
    position: np.ndarray
    ok: np.ndarray


@dataclass(frozen=True)
class _Instrument:
    """What further rows would measure, and how well."""

    sigma: np.ndarray
    """(1, 6) for all rows or (N, 6) [m, rad] 1σ; inf where a component is not measured."""
    sigma_q: float
    """[rad or m] joint repeatability."""
    lever: float
    """[rad] turns of the measured body that move the measured point too."""

    @classmethod
    def of(cls, made: Problem) -> _Instrument:
        data = made.data
        ratio = np.repeat(made.noise.ratio, 3)
        share = np.mean(data.mask, axis=0)
        usual = share > min(0.5, 0.9 * share.max())
        typical = [float(np.median(data.sigma[data.mask[:, c], c])) if usual[c] else np.inf for c in range(6)]
        return cls((np.array(typical) * ratio)[None], made.noise.joints, made.noise.lever)

    def like(self, data: Measurements, rows: np.ndarray) -> _Instrument:
        """The instrument of rows that are read as some rows (n,) of the data are, where sensors read them."""
        if data.readings is None:
            return self
        typical = np.where(np.isfinite(self.sigma), self.sigma, np.nan)
        stated = np.where(data.mask[rows], data.sigma[rows], np.inf)
        return replace(self, sigma=np.where(np.isfinite(stated), np.where(np.isnan(typical), stated, typical), np.inf))

    def whitened(self, point: Point, columns: np.ndarray) -> np.ndarray:
        """Columns (N, 6, p) [m, rad] in noise units; zero where nothing is measured."""
        seen = np.isfinite(self.sigma)
        per = np.where(seen, 1.0 / self.sigma, 0.0)[..., None]
        further = []
        if self.sigma_q:
            further.append(self.sigma_q * per * point.response().actuator)
        if self.lever:
            further.append(self.lever * per * point.turn())
        if not further:
            return columns * per
        noise = np.concatenate(further, axis=-1)
        return np.linalg.inv(np.linalg.cholesky(np.eye(6) + noise @ np.swapaxes(noise, -1, -2))) @ (columns * per)


def _rows(
    made: Problem,
    rivals: Sequence[Rival],
    unknowns: Unknowns,
    q: np.ndarray,
    conditions: Conditions,
    whitened: Callable[[Point, np.ndarray], np.ndarray],
    readings: Readings | None,
) -> _Rows:
    """Rows at commands q (N, nq), in units of the noise that `whitened` counts with, read as `readings` are."""
    model = made.model
    p = linearisation.viewed(model, prediction.predict(model, q, conditions), readings)
    point = Point.of(model, p, conditions)
    known = held(rivals)
    basis = model.robot.mechanism.levels[model.level].basis if known else unknowns.basis
    parts = [prediction.geometry_columns(model, p, point.closure, point.JX, basis)]
    parts.append(point.columns(prediction.unit_contributions(model, point.situation)))
    scale = unknowns.scale * spread(model, unknowns)
    if known:
        assert model.posterior is not None
        parts, scale = [np.concatenate(parts, axis=-1) @ model.posterior.factor], np.ones(len(model.posterior.names))
    if unknowns.n_frame:
        frame = prediction.frame_columns(model, p)
        parts.append(frame)
        scale = np.r_[scale, np.ones(frame.shape[-1])] if known else scale
    if unknowns.n_setup:
        parts.append(prediction.setup_columns(p, unknowns.n_setup))
        scale = np.r_[scale, unknowns.scale[-unknowns.n_setup :]] if known else scale
    parts = [np.concatenate(parts, axis=-1) * scale]
    for rival in rivals:
        columns = [h.columns(point) * h.scale(model) for h in rival]
        parts.append(np.concatenate([*columns, np.zeros((len(q), 6, 0))], axis=-1))
    nuisance, first, second = (np.nan_to_num(whitened(point, np.nan_to_num(columns))) for columns in parts)
    return _Rows(nuisance, (first, second), p.position, p.status == "ok")


def _size(made: Problem, old: _Rows, side: int, parts: bool) -> np.ndarray:
    """Fitted parameters of a rival in units of their usual size; that size itself where the data cannot tell."""
    E = old.rivals[side][made.row, made.component]
    if E.shape[1] == 0:
        return np.zeros(0)
    N = old.nuisance[made.row, made.component] if parts else made.nuisance
    outside = E - N @ np.linalg.solve(N.T @ N + np.eye(N.shape[1]), N.T @ E)
    theta = np.linalg.lstsq(outside, made.y, rcond=1e-6)[0]
    return theta if np.linalg.norm(outside @ theta) > 3.0 else np.ones(E.shape[1])


@dataclass(frozen=True)
class _Discrepancy:
    """Δ, the χ² left when one rival is true and the other is fitted: a quadratic form to which rows can be added."""

    side: int
    theta: np.ndarray
    M: np.ndarray
    b: np.ndarray
    c: float

    @classmethod
    def start(cls, rows: _Rows, theta: np.ndarray, side: int) -> _Discrepancy:
        """Δ over the rows that are measured already."""
        fit = np.concatenate([rows.nuisance, rows.rivals[1 - side]], axis=-1)
        hold = np.r_[np.ones(rows.nuisance.shape[-1]), np.full(rows.rivals[1 - side].shape[-1], 1e-6)]
        fit, truth = fit[rows.ok].reshape(-1, fit.shape[-1]), (rows.rivals[side] @ theta)[rows.ok].ravel()
        return cls(side, theta, fit.T @ fit + np.diag(hold), fit.T @ truth, float(truth @ truth))

    @property
    def value(self) -> float:
        """Δ, noise units squared."""
        return max(self.c - float(self.b @ np.linalg.solve(self.M, self.b)), 0.0)

    def _blocks(self, rows: _Rows) -> tuple[np.ndarray, np.ndarray]:
        return np.concatenate([rows.nuisance, rows.rivals[1 - self.side]], axis=-1), rows.rivals[self.side] @ self.theta

    def gains(self, rows: _Rows) -> np.ndarray:
        """(N,) by how much each row alone would raise Δ."""
        fit, truth = self._blocks(rows)
        surprise = truth - fit @ np.linalg.solve(self.M, self.b)
        spread = np.eye(6) + fit @ np.linalg.inv(self.M) @ np.swapaxes(fit, -1, -2)
        return np.sum(surprise * np.linalg.solve(spread, surprise[..., None])[..., 0], axis=-1)

    def added(self, rows: _Rows, row: int) -> _Discrepancy:
        """Δ with one row more."""
        fit, truth = (a[row] for a in self._blocks(rows))
        return replace(self, M=self.M + fit.T @ fit, b=self.b + fit.T @ truth, c=self.c + float(truth @ truth))


def _candidates(
    made: Problem, rivals: Sequence[Rival], options: Options, rng: np.random.Generator
) -> tuple[np.ndarray, Conditions, np.ndarray]:
    """Reachable poses under all sorts of conditions that the rivals answer to, and the rows of the data that each is
    like otherwise."""
    data, n = made.data, options.candidates
    wants = {want for rival in rivals for e in rival for want in e.wants}
    needs = {need for rival in rivals for e in rival for need in e.needs}
    q = reachable(made.model.robot, n, rng).q
    nq = q.shape[1]
    like = rng.integers(0, len(data), n)
    columns = {name: values[like] for name, values in data.columns.items()}
    payloads = options.payloads
    if payloads is None:
        there = np.unique(data.payload)
        payloads = there if len(there) > 1 else (0.0, 1.0, 2.0)
    tools = np.unique(np.round(data.tool, 9), axis=0) if options.tools is None else np.atleast_2d(options.tools)
    if "direction of motion" in wants or any(f"dir{i + 1}" in data.columns for i in range(nq)):
        columns |= {f"dir{i + 1}": rng.choice([-1.0, 1.0], n) for i in range(nq)}
    if any(need.startswith("temp") for need in needs):
        one = "temp" in columns  # the thermometer stands in for those of parts that have none
        for name in sorted(c for c in {*columns, *(() if one else needs)} if c.startswith("temp")):
            columns[name] = rng.choice([22.0 - TEMPERATURE_SWING, 22.0 + TEMPERATURE_SWING], n)
    if "time" in columns or "time" in needs:
        last = float(np.max(data.columns["time"])) if "time" in data.columns else 0.0
        columns["time"] = last + (rng.choice([0.0, LATER, 2 * LATER], n) if "time" in needs else np.zeros(n))
    made_up = Conditions(tools[rng.integers(0, len(tools), n)], rng.choice(np.asarray(payloads, float), n), columns)
    return q, made_up, like


def _similar(
    made: Problem, known: Conditions, n: int, rng: np.random.Generator
) -> tuple[np.ndarray, Conditions, np.ndarray]:
    """Random commands (n, nq), each under the conditions of a row that is drawn from the data, and those rows (n,)."""
    q = reachable(made.model.robot, n, rng).q
    like = rng.integers(0, len(made.data), n)
    return q, known.take(like), like


def _neutral(conditions: Conditions, needs: set[str]) -> Conditions:
    """Conditions with needed columns that were not recorded at a value at which nothing happens.

    Raises:
        EffectError: a column of the user's own is needed and absent; nobody knows its neutral value.
    """
    columns = dict(conditions.columns)
    for name in sorted(needs - columns.keys()):
        if name.startswith("temp"):
            columns[name] = columns.get("temp", np.full(len(conditions.payload), 20.0))
        elif name == "time" or name.startswith("dir"):
            columns[name] = np.zeros(len(conditions.payload))
        else:
            raise EffectError(
                f"a plan for these rivals needs column '{name}', which the data do not have\n"
                "  add it to the file, with a value in every row"
            )
    return replace(conditions, columns=columns)


def table(robot: Robot, found: NextRows) -> dict[str, np.ndarray | list[str]]:
    """The columns of a plan as a file names them, with the place where the model expects the measured point."""
    out: dict[str, np.ndarray | list[str]] = dict(planning.table(robot, found.q, found.conditions, found.position))
    if found.readings is not None:
        out |= sensed.to_measure(found.readings)
    return out
