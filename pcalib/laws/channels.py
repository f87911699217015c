"""Where a law may act on the robot: one line of `CHANNELS` per channel.

A channel has places (the motors, the rods, or the robot as a whole) and turns a deviation at its places into a
:class:`~pcalib.effects.base.Contribution`. The same line says how a law file writes that contribution, so that the
written file and the search cannot differ; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcalib.effects.base import Contribution, Situation
from pcalib.mechanics.mechanism import Mechanism


@dataclass(frozen=True)
class Channel:
    """One place of the robot where a deviation may arise."""

    name: str
    """Key in JSON: actuator, arm, rod, pair, elbow, plate, tool, base or sensor."""
    words: str
    """How a sentence calls it."""
    unit: str
    """Unit in which a deviation is shown, a spelling of `pcalib.units`."""
    size: float
    """[SI] Usual deviation: the prior of a law's amplitude."""
    places: str
    """'arm' or 'rod': one deviation per motor or rod; 'x y z' and the like: the components of one vector."""
    contribution: Callable[[Situation, np.ndarray], Contribution]
    """Contribution of deviations (N, places) in SI."""
    text: str
    """Python text of the same computation, in which `{v}` stands for the deviations."""
    suits: Callable[[Mechanism], bool] = lambda mechanism: True

    def names(self, mechanism: Mechanism) -> tuple[str, ...]:
        """Names of the places on a robot."""
        if self.places == "arm":
            return mechanism.actuators
        return mechanism.rods if self.places == "rod" else tuple(self.places.split())

    @property
    def vector(self) -> bool:
        """Whether the places are the components of one vector, so that a law has one amplitude per component."""
        return self.places not in ("arm", "rod")


def _arm(at: Situation) -> np.ndarray:
    return at.robot.mechanism.actuator


def _signs(at: Situation) -> np.ndarray:
    """(m,) +1 for the first rod of each arm and −1 for its second."""
    arm = _arm(at)
    return np.where(np.r_[True, arm[1:] != arm[:-1]], 1.0, -1.0)


def _paired(mechanism: Mechanism) -> bool:
    return bool(np.all(np.bincount(mechanism.actuator) == 2))


def _rotary(mechanism: Mechanism) -> bool:
    return mechanism.actuator_dimension == "angle"


def _turns_arms(mechanism: Mechanism) -> bool:
    from pcalib.effects.library import motor_axes as axes

    return axes(mechanism, mechanism.nominal) is not None


def along_arms(at: Situation) -> np.ndarray:
    """(N, m, 3) Unit vectors from the motor axis to each base-side anchor, square to the axis, base frame."""
    tangent = at.arms / np.linalg.norm(at.arms, axis=-1, keepdims=True)
    return np.cross(tangent, motor_axes(at))


def motor_axes(at: Situation) -> np.ndarray:
    """(N, m, 3) Unit vectors of the motor axis of each rod, base frame."""
    from pcalib.effects.library import motor_axes as axes

    mechanism = at.robot.mechanism
    found = axes(mechanism, at.k)
    assert found is not None
    return np.broadcast_to(found[mechanism.actuator], at.arms.shape)


def _pad(v: np.ndarray, before: int, after: int) -> np.ndarray:
    return np.pad(v, ((0, 0), (before, after)))


ARM = "at.robot.mechanism.actuator"
"""Text of the index of the motor of each rod."""

CHANNELS = (
    Channel("actuator", "motor angles", "urad", 1e-4, "arm",
            lambda at, v: Contribution(actuator=v), "Contribution(actuator={v})", _rotary),
    Channel("actuator", "motor positions", "um", 1e-4, "arm",
            lambda at, v: Contribution(actuator=v), "Contribution(actuator={v})", lambda m: not _rotary(m)),
    Channel("arm", "both rods of an arm", "um", 1e-4, "arm",
            lambda at, v: Contribution(rod=v[:, _arm(at)]), f"Contribution(rod={{v}}[:, {ARM}])", _paired),
    Channel("pair", "the rods of a pair against each other", "um", 1e-4, "arm",
            lambda at, v: Contribution(rod=v[:, _arm(at)] * _signs(at)),
            f"Contribution(rod={{v}}[:, {ARM}] * np.tile([1, -1], {{v}}.shape[1]))", _paired),
    Channel("rod", "rod lengths", "um", 1e-4, "rod", lambda at, v: Contribution(rod=v), "Contribution(rod={v})"),
    Channel("elbow", "elbows along their arm", "um", 1e-4, "arm",
            lambda at, v: Contribution(elbow=v[:, _arm(at), None] * along_arms(at)),
            f"Contribution(elbow={{v}}[:, {ARM}, None] * along_arms(at))", _turns_arms),
    Channel("elbow", "elbows along the motor axis", "um", 1e-4, "arm",
            lambda at, v: Contribution(elbow=v[:, _arm(at), None] * motor_axes(at)),
            f"Contribution(elbow={{v}}[:, {ARM}, None] * motor_axes(at))", _turns_arms),
    Channel("elbow", "rod ends at the elbows, along the motor axis", "um", 1e-4, "rod",
            lambda at, v: Contribution(elbow=v[..., None] * motor_axes(at)),
            "Contribution(elbow={v}[..., None] * motor_axes(at))", _turns_arms),
    Channel("plate", "plate joints along the plate's normal", "um", 1e-4, "rod",
            lambda at, v: Contribution(plate=v[..., None] * np.array([0.0, 0.0, 1.0])),
            "Contribution(plate={v}[..., None] * np.array([0.0, 0.0, 1.0]))",
            lambda m: 2 in m.plate_dofs),
    Channel("tool", "the tool point", "um", 1e-4, "x y z",
            lambda at, v: Contribution(tool=v), "Contribution(tool={v})"),
    Channel("tool", "the turn of the tool on the plate", "urad", 3e-4, "rx ry rz",
            lambda at, v: Contribution(tool=np.cross(v, at.tool)), "Contribution(tool=np.cross({v}, at.tool))"),
    Channel("base", "the place of the base", "um", 1e-4, "x y z",
            lambda at, v: Contribution(base=_pad(v, 0, 3)),
            "Contribution(base=np.pad({v}, ((0, 0), (0, 3))))"),
    Channel("base", "the tilt and turn of the base", "urad", 1e-4, "rx ry rz",
            lambda at, v: Contribution(base=_pad(v, 3, 0)),
            "Contribution(base=np.pad({v}, ((0, 0), (3, 0))))"),
    Channel("sensor", "what the instrument reads", "um", 1e-4, "x y z",
            lambda at, v: Contribution(sensor=v), "Contribution(sensor={v})"),
)  # fmt: skip
