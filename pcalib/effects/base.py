"""What an effect is: a physical cause that moves the TCP and that geometry alone does not know.

An effect states its parameters, the data columns it needs, and what it adds for given parameter values. All solvers
work with any combination of effects; derivatives come from the contribution itself (exact where it is linear).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Protocol

import numpy as np

from pcalib.kinematics import Deviation
from pcalib.mechanism import Pose
from pcalib.robot import Robot


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect."""

    name: str
    unit: str
    """A spelling of `pcalib.units`; values in code are SI, files show this unit."""
    prior: float
    """[SI] 1σ of what is usual, the scale of the parameter."""
    low: float = -np.inf
    """[SI] physical range; a fitted value outside it is reported."""
    high: float = np.inf


@dataclass(frozen=True)
class Situation:
    """What an effect may look at, for N poses at the current model."""

    robot: Robot
    q: np.ndarray
    """(N, nq) commanded actuator values [rad or m]."""
    pose: Pose
    """Plate pose."""
    rods: np.ndarray
    """(N, m, 3) unit directions from base to plate anchor, base frame."""
    arms: np.ndarray
    """(N, m, 3) [m], derivative of each base anchor by its actuator (the lever of a rod on its drive)."""
    tension: np.ndarray
    """(N, m) [N] rod forces, tension positive."""
    torque: np.ndarray
    """(N, nq) [N·m or N] generalised load on each actuator, positive where it turns the arm towards +q."""
    tool: np.ndarray
    """(N, 3) [m] TCP in the plate frame."""
    payload: np.ndarray
    """(N,) [kg] at the tool point."""
    columns: Mapping[str, np.ndarray]
    """Every further numeric column of the data, (N,), SI where a unit is known, by its name without unit:
    temp_arms, temp_rods, temp_base [°C], time [s], dir1 … and the user's own columns under their full name."""

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True)
class Contribution:
    """What an effect adds; None is nothing. All small."""

    actuator: np.ndarray | None = None
    """(N, nq) [rad or m], true minus commanded actuator value."""
    rod: np.ndarray | None = None
    """(N, m) [m], lengthening of the rods."""
    elbow: np.ndarray | None = None
    """(N, m, 3) [m], base frame: displacement of the base-side anchors."""
    plate: np.ndarray | None = None
    """(N, m, 3) [m], plate frame: displacement of the plate-side anchors."""
    tool: np.ndarray | None = None
    """(N, 3) [m], plate frame: displacement of the TCP in the plate; the measured rotation stays the plate's."""
    base: np.ndarray | None = None
    """(N, 6) twist (v, ω) of the whole robot about the base origin: x → exp(ω)·x + v, R → exp(ω)·R."""
    sensor: np.ndarray | None = None
    """(N, 3) [m], measuring frame: added to the measured position."""

    def __add__(self, other: Contribution) -> Contribution:
        out = {}
        for f in fields(self):
            a, b = getattr(self, f.name), getattr(other, f.name)
            out[f.name] = b if a is None else a if b is None else a + b
        return Contribution(**out)

    @property
    def deviation(self) -> Deviation:
        """The part inside the closed loops."""
        return Deviation(self.actuator, self.rod, self.elbow, self.plate)


class Effect(Protocol):
    """An effect of the library or of the user's own; a frozen dataclass."""

    name: ClassVar[str]
    """The name in files and options."""

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Its numbers; common to all arms or one per arm."""
        ...

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns without which it cannot be computed, by name without unit."""
        ...

    def contribution(self, at: Situation, theta: np.ndarray) -> Contribution:
        """What it adds at parameter values theta (np,) [SI]; nothing at theta = 0."""
        ...
