"""Two sessions of one virtual robot: parts that are moved between them, or between two rows of the second.

The robot, its change and both sessions come from MuJoCo. Zeros of drives and gear ratios are faults of the bench; other
parts are moved by their parameters, each direction of a part by a random amount.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.faults import Fault
from bench.instrument import Instrument
from bench.plan import Plan
from bench.truth import Truth
from pcalib import robot as robots
from pcalib import rotation
from pcalib.changes.search import hypotheses
from pcalib.changes.session import LinearisedSession, session
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.screen import project_out, span
from pcalib.fitting import identification
from pcalib.model import Model
from pcalib.robot import MODELS, Robot

STREAM = 0xC4A6
KINDS = ("delta", "linear_delta", "hexapod")
SIZES = (12, 40)
"""Rows of the second session."""
FIRST = 40
"""Rows of the first session, of which the model is made."""
SETUPS = ("same", "aligned", "tracker")
"""The instrument was not touched; it was aligned to the base anew, with a small error; it stands somewhere else, in a
frame of its own."""
SIGMA_POS, SIGMA_ROT = 15e-6, 60e-6
LENGTH, ANGLE = 1e-4, float(np.radians(0.05))
"""1σ of the errors of the robot's parts [m, rad]."""
MOST = {"m": 2e-3, "rad": 1e-2, "1": 5e-3}
"""Largest change of one parameter [m, rad, 1]: what is worse is seen without a calibration."""
STATED = (1.0, 1.0, 1.0, 0.7, 1.4)
"""Stated σ over the true one, of both sessions alike: instruments' σ are stated to about a quarter."""
EFFECTS = {"delta": ("drive_compliance", "backlash", "gear_ratio"), "linear_delta": ("backlash",), "hexapod": ()}
"""Faults that are effects of pcalib's library, by kind of robot."""


@dataclass(frozen=True)
class Moved:
    """One thing that changes."""

    name: str
    """A part's or an effect's name, as pcalib's answers have it."""
    errors: np.ndarray
    """(nk,) change of the geometry at unit size [m, rad, 1]."""
    slip: np.ndarray | None = None
    """(nq,) [rad or m] by how much the zeros slip at unit size, where they do."""
    fault: str = ""
    """Name of a fault of usual size that is there at unit size."""

    def largest(self, robot: Robot) -> float:
        """The largest size that is worth asking about."""
        if self.fault:
            return 10.0
        if self.slip is not None:
            unit = "m" if robot.mechanism.actuator_dimension == "length" else "rad"
            return MOST[unit] / float(np.abs(self.slip).max())
        return 1.0 / float(np.max(np.abs(self.errors) / [MOST[unit] for unit in robot.mechanism.units]))

    def made(self, robot: Robot, size: float) -> Fault | None:
        """The fault at some size; None where the geometry changes."""
        if self.slip is not None:
            return faults.get("motor_slip")(robot, slip=self.slip * size, row=1)
        return faults.typical(robot, self.fault, size) if self.fault else None


def part(robot: Robot, name: str, rng: np.random.Generator) -> Moved:
    """A part that moves by a random amount in each of its directions, its errors' usual size over all."""
    mechanism = robot.mechanism
    slipping = [name == f"{called(robot, i)}.zero" for i in range(len(mechanism.actuators))]
    if any(slipping):
        usual = LENGTH if mechanism.actuator_dimension == "length" else ANGLE / 5
        return Moved(name, np.zeros(len(mechanism.nominal)), usual * rng.choice([-1.0, 1.0]) * np.array(slipping))
    basis = next(p.basis for p in mechanism.parts if p.name == name)
    scale = np.array([{"m": LENGTH, "rad": ANGLE, "1": 2e-4}[u] for u in mechanism.units])
    amount = rng.standard_normal(basis.shape[1])
    return Moved(name, scale * (basis @ (amount / np.linalg.norm(amount))))


def called(robot: Robot, i: int) -> str:
    """What the parts call actuator i: its coordinate, or its leg."""
    return f"leg{i + 1}" if robot.mechanism.actuation.drive == "leg" else robot.mechanism.actuators[i]


def effect(robot: Robot, name: str) -> Moved:
    """A listed effect of usual size that the first session did not have."""
    return Moved(name, np.zeros(len(robot.mechanism.nominal)), fault=name)


@dataclass(frozen=True, eq=False)
class Pair:
    """A robot, its first session and the plan of its second one."""

    robot: Robot
    errors: np.ndarray
    setup: str
    stated: float
    plan: Plan
    seed: int
    payloads: bool = False
    noise: int = 0
    """Number of the noise that the second session has."""

    @classmethod
    def draw(cls, kind: str | Robot, n: int, setup: str, rng: np.random.Generator, loaded: bool = False) -> Pair:
        """A random robot and a random plan.

        Args:
            loaded: poses with two payloads and directions of motion, where an effect is to be seen.
        """
        robot = kind if isinstance(kind, Robot) else robots.load(MODELS / f"{kind}.toml")
        seed = int(rng.integers(2**31))
        errors = truths.draw_errors(robot, LENGTH, ANGLE, seed)
        plan = plan_of(robot, n, seed + 1, loaded)
        return cls(robot, errors, setup, float(rng.choice(STATED)), plan, seed, loaded)

    @cached_property
    def first(self) -> Measurements:
        """The first session."""
        plan = plan_of(self.robot, FIRST, self.seed + 2, self.payloads)
        return self.measured((), 0.0, plan, self.seed + 3, again=False)

    @cached_property
    def model(self) -> Model:
        """The model of the first session."""
        return identification.fit(self.first, self.robot).model

    def truth(
        self, moved: Sequence[Moved], size: float | Sequence[float], noisy: bool = True, again: bool = True
    ) -> Truth:
        """The robot after a change of some size, and its instrument.

        Args:
            again: the instrument of the second session.
        """
        sizes = np.broadcast_to(size, len(moved))
        errors = self.errors + sum((s * m.errors for m, s in zip(moved, sizes, strict=True)), 0.0)
        made = [f for m, s in zip(moved, sizes, strict=True) if s and (f := m.made(self.robot, float(s))) is not None]
        instrument: dict = {"sigma_pos": SIGMA_POS * noisy, "sigma_rot": SIGMA_ROT * noisy}
        if self.setup == "tracker":
            instrument["frame"] = "tracker"
            if again:
                instrument["position"], instrument["rotation"] = np.array([-1.8, 1.5, 0.2]), np.array([-0.2, 0.4, -1.0])
        return Truth(self.robot, errors, Instrument(**instrument), tuple(_merged(self.robot, made)))

    def measured(
        self, moved: Sequence[Moved], size: float | Sequence[float], plan: Plan | None = None, seed: int = 0,
        *, again: bool = True, noisy: bool = True,
    ) -> Measurements:  # fmt: skip
        """A session, with σ as the instrument states it."""
        truth = self.truth(moved, size, noisy, again)
        data = simulate.run(truth, self.plan if plan is None else plan, seed).measurements
        each = np.repeat([SIGMA_POS, SIGMA_ROT], 3) * self.stated
        data = replace(data, sigma=np.broadcast_to(each, data.sigma.shape).copy(), stated=(True, True))
        if self.setup != "aligned" or not again:
            return data
        rng = np.random.default_rng([self.seed, self.noise])
        turn, shift = rotation.exp(3e-4 * rng.standard_normal(3)), 5e-4 * rng.standard_normal(3)
        return replace(data, position=data.position @ turn.T + shift, rotation=turn @ data.rotation)

    def later(self, plan: Plan, noise: int) -> Pair:
        """The same robot and model, measured at other poses with other noise."""
        out = replace(self, plan=plan, noise=noise)
        out.__dict__["model"] = self.model
        return out

    def second(self, moved: Sequence[Moved], size: float | Sequence[float], row: int = 0) -> Measurements:
        """The second session, with noise; the change acts from a row on, counted from 0."""
        seed = self.seed + 4 + 1000 * self.noise
        after = self.measured(moved, size, seed=seed)
        return joined(self.measured((), 0.0, seed=seed), after, row) if row else after

    def visible(
        self, moved: Sequence[Moved], size: float | Sequence[float], row: int = 0
    ) -> tuple[np.ndarray, LinearisedSession]:
        """(M,) signal of changed parts in the whitened readings, the measuring frame allowed for; and the session."""
        before = self.measured((), 0.0, noisy=False)
        after = joined(before, self.measured(moved, size, noisy=False), row)
        new = session(self.model, before, self.setup == "same")
        turned = rotation.log(after.rotation @ np.swapaxes(before.rotation, -1, -2))
        off = np.concatenate([after.position - before.position, turned], axis=1)
        return project_out(new.whitened(off[..., None])[:, 0], span(new.frame, 0.05)), new

    def sized(self, moved: Moved, wanted: float, row: int = 0) -> tuple[float, float]:
        """Size at which a change reaches the wanted noise units, within its limit; and the units that it reaches."""
        size, s = 1.0, 0.0
        for _ in range(3):
            signal, _ = self.visible([moved], size, row)
            s = float(np.linalg.norm(signal))
            if abs(s / wanted - 1) < 0.03 or s < 1e-3:
                break
            nearer = min(size * wanted / s, moved.largest(self.robot))
            if nearer == size:
                break
            size = nearer
        return size, s


def distance(pair: Pair, moved: Sequence[Moved], sizes: Sequence[float]) -> float:
    """s⊥ [noise units]: how far two changes at once are from the nearest single part's."""
    signal, new = pair.visible(moved, sizes)
    U = span(new.frame, 0.05)
    scale = [project_out(new.whitened(h.columns(new.point)) * h.scale(new.model), U) for h in hypotheses(new.model)]
    return min(float(np.linalg.norm(project_out(signal, span(columns, 0.05)))) for columns in scale)


def joined(before: Measurements, after: Measurements, row: int) -> Measurements:
    """Two sessions of one plan as one: the robot changes before a row, counted from 0."""
    first = np.arange(len(before)) < row
    return replace(
        after,
        position=np.where(first[:, None], before.position, after.position),
        rotation=np.where(first[:, None, None], before.rotation, after.rotation),
    )


def names(robot: Robot) -> list[str]:
    """Parts that a change is drawn from."""
    return [p.name for p in robot.mechanism.parts if not p.name.startswith("frame")]


def tools(robot: Robot) -> list[np.ndarray]:
    """(3,) [m] measured points on the plate: its centre, and one beside and beyond it."""
    lever = 0.35 * robot.workspace.radius
    return [np.zeros(3), np.array([lever / 2, 0.0, lever * robot.mechanism.tool_direction[2]])]


def plan_of(robot: Robot, n: int, seed: int, loaded: bool) -> Plan:
    """A random plan, a rich one where it is loaded."""
    return plans.make(robot, "rich" if loaded else "random", n, tools=tools(robot), seed=seed)


def _merged(robot: Robot, made: Sequence[Fault]) -> list[Fault]:
    """Faults of one name as one: two zeros that slip are one fault."""
    out: dict[str, Fault] = {}
    for fault in made:
        if fault.name in out:
            values = {k: v + out[fault.name].values[k] if k == "slip" else v for k, v in fault.values.items()}
            fault = faults.get(fault.name)(robot, **values)
        out[fault.name] = fault
    return list(out.values())
