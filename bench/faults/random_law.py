"""Something deviates by a law that no one has listed and that a seed draws (`bench/random_laws.py`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from bench.commands import REFERENCE_TEMPERATURE, Commands, Row
from bench.faults import Fault, counts, rods
from bench.random_laws import CHANNELS, LOADS, RECORDED, draw
from bench.rig import Rig
from pcalib import rotation
from pcalib.errors import InputError
from pcalib.robot import Robot
from pcalib.settings import Setting

STILL = 1e-13
"""[rad or m] A smaller change of a deviation counts as none."""
PLAY, FADING = "random_law.play", "random_law.fading"
"""Columns that hold what a row remembers."""


class RandomLaw(Fault):
    """Motors, rods, joints, tool or base deviate by the law of a seed, `scale` times as much as is usual."""

    MJCF = "held joints `q1.law`, `rod11.law`, coordinates of joints, the tool vector, the base body"
    SETTINGS = (
        Setting("scale", "number", low=-1e3, high=1e3, typical=1.0, about="times the usual size"),
        Setting("seed", "whole", 0, 0.0, about="which law"),
        Setting("plain", "flag", False, about="one factor of few shapes, and one law alone"),
    )

    def __init__(self, robot: Robot, **values: Any):
        super().__init__(robot, **values)
        if robot.kind != "delta":
            raise InputError(
                f"fault '{self.name}' is written for Deltas, and this robot is of kind '{robot.kind}'",
                remedy="leave this fault out for this robot",
            )
        self.laws = draw(counts(robot) | {"axis": 3}, int(values["seed"]), bool(values["plain"]))
        self._rods = rods(robot)
        self._arms = np.array([int(rod[0]) - 1 for rod in self._rods])

    @property
    def NEEDS(self) -> tuple[str, ...]:  # type: ignore[override]
        used = {term.variable for law in self.laws for term in law.terms}
        columns = [c for c in RECORDED if c in used and c not in ("payload", "tool")]
        directions = [f"dir{i + 1}" for i in range(len(self.robot.mechanism.actuators))]
        return tuple(columns + (directions if "direction" in used else []))

    @property
    def loaded(self) -> bool:  # type: ignore[override]
        return any(term.variable == "load" for law in self.laws for term in law.terms)

    @property
    def words(self) -> str:
        """The law, as a table has it."""
        return " + ".join(law.words for law in self.laws)

    def build(self, spec: mujoco.MjSpec) -> None:
        used = {law.channel for law in self.laws}
        self._motors: list[str] = []
        self._tips: list[str] = []
        if "motor" in used:
            self._motors = [self.beside(spec, name, "law").name for name in self.robot.mechanism.actuators]
        if used & {"rod", "pair"}:
            for rod in self._rods:
                name = f"rod{rod}.law"
                self.joint(self.body(spec, f"tip{rod}"), name, "slide", (0, 0, -1))
                self._tips.append(name)

    def history(self, commands: Commands) -> Mapping[str, np.ndarray]:
        """Return what is remembered of the rows before: the play of every motor's angle, and a load that fades."""
        q = commands.q
        width = 0.15 * np.ptp(self.robot.joint_range)
        lag = np.empty_like(q)
        at = q[0].copy()
        for n, now in enumerate(q):
            at = np.clip(at, now - width, now + width)
            lag[n] = (now - at) / width
        fading, level = np.empty(len(q)), 0.0
        for n, payload in enumerate(commands.payload):
            level = 0.8 * level + 0.2 * payload
            fading[n] = level
        return {f"{PLAY}{i + 1}": lag[:, i] for i in range(q.shape[1])} | {FADING: fading}

    def _known(self, row: Row, places: str, rig: Rig | None = None, joints: list[str] | None = None) -> dict[str, Any]:
        """Return every variable that is known, in usual changes."""
        q = _centred(row.q, *self.robot.joint_range)
        arms = self._arms if places == "rod" else np.arange(len(q))
        columns = row.columns
        known: dict[str, Any] = {
            name: np.float64((columns[name] - (0.0 if name == "time" else REFERENCE_TEMPERATURE)) / size)
            for name, size in RECORDED.items()
            if name in columns
        }  # fmt: skip
        known |= {
            "payload": np.float64(row.payload / RECORDED["payload"]),
            "tool": np.float64(np.linalg.norm(row.tool) / RECORDED["tool"]),
            "fading": np.float64(columns[FADING]),
            "direction": np.float64(row.direction(0)),
        }
        if places != "axis":
            direction = np.array([row.direction(i) for i in range(len(q))])
            play = np.array([columns[f"{PLAY}{i + 1}"] for i in range(len(q))])
            known |= {"q": q[arms], "neighbour": np.roll(q, 1)[arms], "direction": direction[arms], "play": play[arms]}
        if rig is not None and joints is not None:
            space = self.robot.workspace
            x, y, z = rig.data.xpos[rig.model.body("plate").id]
            known |= {"x": x / space.radius, "y": y / space.radius, "z": _centred(z, space.z_min, space.z_max)}
            if self.loaded:
                known["load"] = np.array([rig.load(joint) for joint in joints]) / LOADS[places]
        return known

    def _early(self, row: Row, channel: str) -> np.ndarray:
        """Return (places,) [m or rad] deviation of a channel by what is known before the row is solved."""
        places = CHANNELS[channel][0]
        found = [law.deviation(self._known(row, places)) for law in self.laws if law.channel == channel]
        return self.values["scale"] * np.sum(found, axis=0) if found else np.zeros(0)

    def geometry(self, k: np.ndarray, row: Row) -> np.ndarray:
        for channel, letter, axis in (("elbow", "a", "x"), ("plate_anchor", "b", "z")):
            moved = self._early(row, channel)
            if len(moved):
                k = k.copy()
                k[[self.robot.mechanism.parameters.index(f"{letter}{rod}.{axis}") for rod in self._rods]] += moved
        return k

    def prepare(self, rig: Rig, row: Row) -> None:
        shift, turn = self._early(row, "base_shift"), self._early(row, "base_turn")
        if len(shift) or len(turn):
            rig.move_base(shift if len(shift) else np.zeros(3), turn if len(turn) else np.zeros(3))

    def settle(self, rig: Rig, row: Row) -> bool:
        moved, scale = False, self.values["scale"]
        tips = np.zeros(len(self._rods))
        motors = np.zeros(len(self.robot.mechanism.actuators))
        for law in self.laws:
            if law.channel == "motor":
                motors += scale * law.deviation(self._known(row, "actuator", rig, self._motors))
            elif law.channel == "rod":
                tips += scale * law.deviation(self._known(row, "rod", rig, self._tips))
            elif law.channel == "pair":
                loads = self._known(row, "actuator", rig, list(self.robot.mechanism.actuators))
                side = np.where(np.array([rod[-1] for rod in self._rods]) == "1", 1.0, -1.0)
                tips += scale * side * law.deviation(loads)[self._arms]
        for joints, values in ((self._motors, motors), (self._tips, tips)):
            for joint, value in zip(joints, values, strict=False):
                moved |= rig.hold(joint, float(value), STILL)
        return moved

    def mount(self, tcp: np.ndarray, row: Row) -> np.ndarray:
        shift, turn = self._early(row, "tool_point"), self._early(row, "tool_turn")
        if len(turn):
            tcp = rotation.exp(turn) @ tcp
        return tcp + shift if len(shift) else tcp


def _centred(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return −1 at the lower end of a range, 1 at the upper one."""
    return (values - 0.5 * (low + high)) / (0.5 * (high - low))


FAULT = RandomLaw
