"""One robot of known geometry before one measurement plan: what hidden faults do there, in units of noise.

The visible size of a fault is what it changes in the noise-free readings of MuJoCo, divided by the instrument's σ, with
all that refitted geometry could take up projected out:

    s = |(I − UUᵀ)·(y_with − y_without)|        U: the identified geometry's columns at the true geometry

Faults are nearly linear, so a wanted size is met by one simulation at typical size and one or two corrections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.commands import Commands, Landing
from bench.faults import Fault
from bench.jobs.hidden import catalogue
from bench.jobs.hidden.catalogue import Hidden
from bench.jobs.hidden.design import QUIET, Design
from bench.simulate import DataSet
from bench.truth import Truth
from pcalib import effects
from pcalib.data.measurement import Measurements
from pcalib.diagnosis import candidates
from pcalib.diagnosis.point import Point
from pcalib.effects.gear_ripple import SCANNED
from pcalib.fitting import identification, linearisation
from pcalib.fitting.unknowns import unknowns_of
from pcalib.model import FittedEffect, Model
from pcalib.robot import Robot

SIGMA_LENGTH, SIGMA_ANGLE = 1e-4, np.radians(0.05)
"""1σ of a robot's geometric errors [m, rad]."""
HELD = 1e-3
"""Noise units per prior below which priors hold a geometric direction, so that nothing is taken up along it."""
SEEN = 1e-3
"""Noise units per usual size below which a direction of an effect counts as none."""
RIPPLE = 2e-4
"""[rad] usual amplitude of a gear ripple."""
CLOSE = 0.03
"""Relative difference from the wanted size at which the search for it ends."""
MOVED = 1e-3
"""[m] RMS change of the measured point that a hidden fault may cause."""
OF_A_TRACKER = ("tracker_drift", "tracker_scale", "tracker_bump")
"""Faults of an instrument that sensors do not have."""
RANGE = 0.7
"""Share of an effect's physical range that a hidden fault may take."""


@dataclass(frozen=True)
class Sized:
    """A fault scaled to a visible size."""

    fault: Fault
    size: float
    """s it has."""
    factor: float
    """Times its size before."""
    capped: bool
    """Whether it had to stay smaller than wanted, so as to remain physical."""


class Replay:
    """Stands in for a machine whose landing is known, so that new noise costs no simulation."""

    def __init__(self, landing: Landing):
        self.landing = landing

    def run(self, commands: Commands, miss: np.ndarray | None = None) -> Landing:
        """Return the landing, whatever the commands."""
        return self.landing


@dataclass(frozen=True, eq=False)
class Stage:
    """A robot and a plan."""

    design: Design
    robot: Robot
    errors: np.ndarray
    """(nk,) true minus nominal geometry."""
    plan: plans.Plan
    known: tuple[Fault, ...] = ()
    """Faults that the robot always has, and that the user's model knows: drive compliance or nothing."""

    @classmethod
    def draw(cls, design: Design, robot: Robot, seed: int, companion: bool = False) -> Stage:
        """Return a random robot and random poses; the same seed gives the same.

        Args:
            companion: whether its drives give way, to the user's knowledge.
        """
        plan = plans.make(robot, design.plan, design.rows, check=design.check, tools=design.tools, seed=seed)
        if design.interleaved:
            plan = _interleaved(plan, seed)
        if design.apart:
            plan = _shuffled(plan, seed)
        errors = truths.draw_errors(robot, SIGMA_LENGTH, SIGMA_ANGLE, seed)
        known = (faults.make(robot, "drive_compliance", catalogue.BELTS),) if companion else ()
        return cls(design, robot, errors, plan, known)

    def truth(self, hidden: Sequence[Fault] = (), noisy: bool = True) -> Truth:
        """Return the robot with these faults beside those that are known."""
        faults = (*self.known, *hidden)
        return Truth(self.robot, self.errors, self.design.instrument(noisy), faults, self.design.measuring(noisy))

    def land(self, hidden: Sequence[Fault] = ()) -> Landing:
        """Return where MuJoCo puts the robot for every row of the plan."""
        return self.truth(hidden).machine().run(self.plan.commands)

    def measured(self, hidden: Sequence[Fault], landing: Landing, seed: int) -> DataSet:
        """Return the data set of a landing: noise drawn afresh, σ stated as the instrument states it."""
        return simulate.run(self.truth(hidden), self.plan, seed, machine=Replay(landing))

    def measure(self, hidden: Sequence[Fault], landing: Landing, seed: int) -> Measurements:
        """Return the data file of a landing: noise drawn afresh, σ stated as the design says."""
        data = self.measured(hidden, landing, seed).measurements
        return replace(data, sigma=data.sigma * self.design.stated)

    # -- sizes ---------------------------------------------------------------------------------------------------

    @cached_property
    def reference(self) -> Landing:
        """Where the robot stands without anything hidden."""
        return self.land()

    @cached_property
    def model(self) -> Model:
        """The true geometry, with the effects that the user's model knows."""
        model = Model.nominal(self.robot)
        return replace(model, k=model.k + self.errors, level="complete", effects=self.effects)

    @property
    def effects(self) -> tuple[FittedEffect, ...]:
        """What the user's model knows, at its true size."""
        return tuple(
            FittedEffect(effects.get(f.name, None, self.robot), np.atleast_1d(np.mean(f.values["compliance"])), f.name)
            for f in self.known
        )

    @property
    def start(self) -> Model:
        """What the user's fit starts from: the nominal geometry, with the effects that are known."""
        return replace(Model.nominal(self.robot), effects=self.effects)

    def _exact(self, hidden: Sequence[Fault], landing: Landing) -> tuple[Measurements, np.ndarray]:
        """Return noise-free readings, and (N,) which row of the plan each is of, sensor by sensor."""
        made = simulate.run(self.truth(hidden, noisy=False), self.plan, machine=Replay(landing))
        data = made.measurements
        plain = np.where([True] * 3 + [False] * 3, self.design.sigma_pos, self.design.sigma_rot)
        sigma, which = np.broadcast_to(plain, data.sigma.shape).copy(), made.kept
        if data.readings is not None:
            sensed = data.readings.sensor != ""
            sigma[sensed] = data.sigma[sensed] / QUIET
            which = which + len(self.plan) * np.unique(data.readings.sensor.astype(str), return_inverse=True)[1]
        return replace(data, sigma=sigma), which

    @cached_property
    def _clean(self) -> Measurements:
        """Noise-free readings without anything hidden, rows to fit only."""
        return self._fitted((), self.reference)[0]

    def _fitted(self, hidden: Sequence[Fault], landing: Landing) -> tuple[Measurements, np.ndarray]:
        data, which = self._exact(hidden, landing)
        return data.take(~data.check), which[~data.check]

    @cached_property
    def _linear(self) -> tuple[np.ndarray, Point, np.ndarray, np.ndarray]:
        """Basis U (M, r) of the geometry's columns, the point behind them, row and component of each reading."""
        data = self._clean
        model = linearisation.seen_from(self.model, data)
        unknowns = unknowns_of(model, model.level, model.effects)
        found = identification.linearise(model, data, unknowns)
        U, s, _ = np.linalg.svd(found.jacobian * unknowns.scale, full_matrices=False)
        point = Point.of(model, found.prediction, identification.conditions_of(data))
        return U[:, s > HELD], point, found.row, found.component

    def _refitted(self, columns: np.ndarray) -> np.ndarray:
        """Return whitened readings (M, …) without what geometry takes up."""
        U = self._linear[0]
        return columns - U @ (U.T @ columns)

    def change(self, hidden: Sequence[Fault], landing: Landing | None = None) -> np.ndarray:
        """Return (N, 6) [m, rad] what faults change in the noise-free readings of the rows to fit; zero where not
        measured."""
        landing = self.land(hidden) if landing is None else landing
        (data, there), (clean, before) = self._fitted(hidden, landing), self._fitted((), self.reference)
        _, new, old = np.intersect1d(there, before, return_indices=True)
        out = np.zeros((len(clean), 6))
        out[old] = np.nan_to_num(data.take(new).beside(clean.take(old)))
        return out

    def visible(self, change: np.ndarray) -> np.ndarray:
        """Return (M,) what is left of a change (N, 6) once the geometry is refitted, in noise units; its norm is s."""
        _, _, row, component = self._linear
        return self._refitted(change[row, component] / self._clean.sigma[row, component])

    def signal(self, hidden: Sequence[Fault]) -> np.ndarray:
        """Return the part (M,) of the faults' signal that the geometry cannot take up."""
        return self.visible(self.change(hidden))

    def room(self, fault: Fault, change: np.ndarray, effect: str | None = None) -> float:
        """Return how many times larger a fault may become and stay physical.

        Its settings and the parameters of the effect that describes it keep to their ranges, and the measured point
        moves by no more than MOVED: what is worse than that is seen without calibration.
        """
        moved = float(np.sqrt(np.mean(np.sum(change[:, :3] ** 2, axis=1))))
        most = min(catalogue.largest(fault), MOVED / max(moved, 1e-12))
        if effect is not None and effect in self._columns:
            theta = np.linalg.lstsq(self._columns[effect], self.visible(change), rcond=1e-3)[0]
            theta = theta * self.library[effect].scale
            bound = np.where(theta > 0, self.library[effect].high, self.library[effect].low)
            large = np.abs(theta) > 0.05 * np.abs(theta).max(initial=0.0)
            ratio = bound[large] / theta[large]
            most = min(most, RANGE * float(np.min(ratio[ratio > 0], initial=np.inf)))
        return most

    def scaled(self, fault: Fault, wanted: float, effect: str | None = None) -> Sized:
        """Return a fault made as large as `wanted`, or as its physical range allows.

        Args:
            effect: the library's name for it, whose parameter range is kept to as well.
        """
        change = self.change([fault])
        size, factor, out = float(np.linalg.norm(self.visible(change))), 1.0, fault
        if size < 1e-6:
            return Sized(fault, size, 1.0, True)
        most = self.room(fault, change, effect)
        for _ in range(3):
            # Few digits: no rounding of linear algebra may show in a truth file.
            factor = float(f"{min(factor * wanted / size, most):.4g}")
            out = catalogue.scaled(fault, factor)
            size = float(np.linalg.norm(self.signal([out])))
            if abs(size / wanted - 1) < CLOSE or factor >= 0.999 * most:
                break
        return Sized(out, size, factor, bool(size < (1 - CLOSE) * wanted))

    # -- distances from what the library knows -------------------------------------------------------------------

    @cached_property
    def library(self) -> dict[str, candidates.Candidate]:
        """Each effect in its widest variant, columns (N, 6, p)."""
        found, _ = candidates.candidates(self._linear[1])
        widest: dict[str, candidates.Candidate] = {}
        for candidate in found:
            best = widest.get(candidate.name)
            if best is None or candidate.columns.shape[-1] > best.columns.shape[-1]:
                widest[candidate.name] = candidate
        return widest

    @cached_property
    def _columns(self) -> dict[str, np.ndarray]:
        """(M, p) visible whitened columns of each effect, per usual size."""
        _, _, row, component = self._linear
        sigma = self._clean.sigma[row, component]
        whitened = {name: c.columns[row, component] / sigma[:, None] * c.scale for name, c in self.library.items()}
        return {name: self._refitted(columns) for name, columns in whitened.items()}

    @cached_property
    def _ripples(self) -> dict[int, np.ndarray]:
        """(M, r) orthonormal basis of the visible part of a gear ripple of n cycles per turn, arm by arm."""
        _, point, row, component = self._linear
        response, q = point.response().actuator, point.situation.q
        sigma = self._clean.sigma[row, component]
        out = {}
        for n in SCANNED:
            waves = np.concatenate([response * np.sin(n * q)[:, None], response * np.cos(n * q)[:, None]], axis=-1)
            out[n] = _span(self._refitted(RIPPLE * waves[row, component] / sigma[:, None]))
        return out

    def _bases(self, signal: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return an orthonormal basis (M, D) of what all effects together could explain, and of each effect alone in it
        (D, r).

        Gear ripple is there with the number of cycles that suits the signal best, as a diagnosis would find it.
        """
        columns = dict(self._columns)
        if "gear_ripple" in columns:
            best = max(self._ripples.values(), key=lambda Q: float(np.sum((Q.T @ signal) ** 2)))
            columns["gear_ripple"] = best
        W = _span(np.hstack(list(columns.values())))
        return W, {name: _span(W.T @ each) for name, each in columns.items()}

    def nearest(
        self, signal: np.ndarray, together: int = 1, without: str | None = None
    ) -> tuple[float, tuple[str, ...]]:
        """Return s⊥: the smallest distance of a signal from the library's effects, up to `together` at a time; and
        which."""
        W, bases = self._bases(signal)
        inside = W.T @ signal
        beyond = signal @ signal - inside @ inside
        names = [name for name in sorted(bases) if name != without]
        best: tuple[float, tuple[str, ...]] = (float(np.linalg.norm(signal)), ())
        for chosen in (c for size in range(1, together + 1) for c in combinations(names, size)):
            Q = bases[chosen[0]] if len(chosen) == 1 else _span(np.hstack([bases[name] for name in chosen]))
            rest = inside - Q @ (Q.T @ inside)
            far = float(np.sqrt(max(beyond + rest @ rest, 0.0)))
            if far < best[0] * (1 - 1e-9):
                best = far, chosen
        return best


def _span(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the directions that can be seen at usual sizes."""
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return U[:, s > SEEN]


def _interleaved(plan: plans.Plan, seed: int) -> plans.Plan:
    """Return the plan with as many rows held out, drawn from all of it; replicates stay together."""
    q = plan.commands.q
    pose = np.cumsum(np.r_[False, (q[1:] != q[:-1]).any(axis=1)])
    share = np.random.default_rng(seed).permutation(pose[-1] + 1) / (pose[-1] + 1)
    return replace(plan, check=share[pose] < plan.check.mean())


def _shuffled(plan: plans.Plan, seed: int) -> plans.Plan:
    """Return the plan in random order, held-out rows last as before; rows keep their conditions and take the times
    in turn."""
    order = np.random.default_rng(seed).permutation(len(plan))
    order = order[np.argsort(plan.check[order], kind="stable")]
    commands = plan.commands.take(order)
    columns = dict(commands.columns)
    if "time" in columns:
        columns["time"] = plan.commands.columns["time"]
    commands = Commands(commands.q, commands.tool, commands.payload, columns)
    return replace(plan, commands=commands, pose_id=plan.pose_id[order], check=plan.check[order])


def suits(hidden: Hidden, design: Design, robot: Robot) -> bool:
    """Return whether a design records the columns by which a fault acts."""
    return set(hidden.needs(robot)) <= set(design.columns) and not (design.sensors and hidden.name in OF_A_TRACKER)
