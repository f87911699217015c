"""A robot built of rods between anchor points, as data: what every kind supplies and every solver uses.

Rod r joins a base-side anchor A_r(q), moved by at most one actuator, to a plate-side anchor B_r(X):

    closure    f_r = n_r·(B_r − A_r) − l_r = 0,      n_r = (B_r − A_r)/|B_r − A_r|

A guided row (the driven rod of the planar mechanism) is the same equation with a direction n_r(q) that the
actuator prescribes and l_r = 0. The plate is a rigid body, or a chain of bodies hinged to a central one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from pcalib import rotation


@dataclass(frozen=True)
class BaseSide:
    """The base-side ends of m rods for N actuator settings."""

    A: np.ndarray
    """(N, m, 3) [m], base frame."""
    dA: np.ndarray
    """(N, m, 3), derivative of A by the rod's own actuator [m/rad or 1]."""
    length: np.ndarray
    """(m,) or (N, m) [m]; zero on guided rows."""
    dlength: np.ndarray | float = 0.0
    """(N, m), derivative of the length by the rod's own actuator (legs of commanded length)."""
    guide: np.ndarray | None = None
    """(N, m, 3) prescribed unit directions of guided rows, NaN on plain rods; None where there are none."""
    dguide: np.ndarray | None = None
    """(N, m, 3), derivative of `guide` by the rod's own actuator."""
    frames: np.ndarray | None = None
    """(nq, 3, 3) turn of each actuator's frame, base frame; None where it has none."""


def _no_vectors() -> np.ndarray:
    return np.zeros((0, 3), int)


def _no_numbers() -> np.ndarray:
    return np.zeros(0, int)


@dataclass(frozen=True, kw_only=True)
class Actuation:
    """How actuators and base-side parameters place the anchors: rotary arms, carriages, legs.

    The arrays say where parameters of each sort stand in k; an empty one says that there are none of that sort. The
    frame of a ball joint `a` is that of the part that the actuator moves.
    """

    p: np.ndarray = field(default_factory=_no_vectors)
    """(nq, 3) base point of each actuator."""
    beta: np.ndarray = field(default_factory=_no_vectors)
    """(nq, 3) rotation vector of each actuator's mount, base frame."""
    a: np.ndarray = field(default_factory=_no_vectors)
    """(m, 3) ball joint of each rod on the part that its actuator moves."""
    scale: np.ndarray = field(default_factory=_no_numbers)
    """(nq,) factor of each actuator's motion."""
    length: np.ndarray = field(default_factory=_no_numbers)
    """(m,) length of each rod, or of a leg at q = 0; −1 on a row that is no rod."""
    drive: ClassVar[str] = "motor"
    """'motor', or 'leg' where each actuator is a leg of commanded length with a base point of its own."""
    moves: ClassVar[str] = ""
    """What an actuator moves, in words: arm, carriage; empty where it moves the rod itself."""
    mount: ClassVar[str] = ""
    """What carries it, in words."""

    @property
    def columns(self) -> np.ndarray:
        """(m, c) where the base-side parameters of each rod stand in k, its length included."""
        raise NotImplementedError

    def base(self, k: np.ndarray, q: np.ndarray) -> BaseSide:
        """Anchors for parameters k (nk,) and actuator values q (N, nq)."""
        raise NotImplementedError

    def rows(self, k: np.ndarray, q: np.ndarray, side: BaseSide, n: np.ndarray, d: np.ndarray) -> np.ndarray:
        """∂f/∂k of each rod by its `columns`, (N, m, c), for directions n and rod vectors d = B − A (N, m, 3)."""
        raise NotImplementedError

    def slopes(self, k: np.ndarray) -> np.ndarray | None:
        """What :meth:`rows` are made of at every pose, (m, 14, c): the factors of n, n·cos q, n·sin q and n·q (3 each),
        of 1 and of q. The extension asks for it, and leaves rows to NumPy where it is None."""
        return None

    def reach(self, k: np.ndarray, B: np.ndarray) -> np.ndarray:
        """Closed-form actuator value that lets each rod reach B (N, m, 3): (N, m), NaN where it cannot."""
        raise NotImplementedError

    def zeros(self, nk: int) -> np.ndarray:
        """(nk, nq) change of k that acts as an offset of 1 [rad or m] on each actuator, to first order."""
        raise NotImplementedError

    def weight_moment(self, k: np.ndarray, q: np.ndarray, mass: Mapping[str, float], g: np.ndarray) -> np.ndarray:
        """Generalised force of the moving base-side masses on each actuator, (N, nq) [N·m or N]; none by default."""
        return np.zeros(q.shape)


@dataclass(frozen=True)
class Part:
    """A part of a robot that may be made, mounted or bent otherwise than drawn, and what of the geometry it changes."""

    name: str
    """E.g. q1.zero, motor1, arm1, a11, b11, l11, pair1, plate, leg1.zero, hinge1."""
    words: str
    """In a technician's words."""
    basis: np.ndarray
    """(nk, p) changes of k that it can make."""


@dataclass(frozen=True)
class Hinge:
    """A revolute joint that carries a further plate body on the central one, where its parameters put it."""

    point: np.ndarray
    """(3,) [m], plate frame."""
    axis: np.ndarray
    """(3,) unit vector, plate frame."""


@dataclass(frozen=True)
class HingeColumns:
    """The parameters of a hinge: its axis runs through point h along exp(τ)·(nominal axis)."""

    point: np.ndarray
    """(3,) where h stands in k."""
    tilt: np.ndarray
    """(3,) where the rotation vector τ stands in k."""
    axis: np.ndarray
    """(3,) nominal unit vector, plate frame."""

    def at(self, k: np.ndarray) -> Hinge:
        """The hinge for parameters k."""
        return Hinge(k[self.point], rotation.exp(k[self.tilt]) @ self.axis)


@dataclass(frozen=True)
class Level:
    """A named subspace of geometric errors, δk = basis·z: what a calibration method lets vary."""

    name: str
    columns: tuple[str, ...]
    basis: np.ndarray
    """(nk, nz)."""
    units: tuple[str, ...]
    perfect: bool = False
    """Parallelograms stay perfect: the plate cannot tilt, so measured rotations are left out of the fit."""
    strict: bool = False
    """Every coordinate must be identified: its value is handed on by itself, to a firmware that knows no others."""
    text: str = ""
    """What may vary and what cannot be seen, in plain sentences."""

    @cached_property
    def raw(self) -> bool:
        """Whether the columns are the raw parameters themselves."""
        return self.basis.shape[0] == self.basis.shape[1] and np.array_equal(self.basis, np.eye(len(self.basis)))

    @cached_property
    def _left_inverse(self) -> np.ndarray:
        return np.linalg.pinv(self.basis)

    def coordinates(self, errors: np.ndarray) -> np.ndarray:
        """Level coordinates (nz,) nearest to raw geometric errors (nk,)."""
        return errors if self.raw else self._left_inverse @ errors

    def project(self, errors: np.ndarray) -> np.ndarray:
        """The part (nk,) of raw geometric errors that lies in the level."""
        return errors if self.raw else self.basis @ self.coordinates(errors)


@dataclass(frozen=True)
class Pose:
    """Plate poses: x (N, 3) [m], R (N, 3, 3) plate → base, phi (N, h) [rad] angles of the plate's hinges."""

    x: np.ndarray
    R: np.ndarray
    phi: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def __len__(self) -> int:
        return len(self.x)

    def tcp(self, tool: np.ndarray) -> np.ndarray:
        """TCP positions x + R·t (N, 3) [m], for a tool (3,) or (N, 3) in the plate frame."""
        if not np.asarray(tool).any():
            return self.x.copy()
        return self.x + (self.R @ np.broadcast_to(tool, self.x.shape)[..., None])[..., 0]

    def take(self, rows: np.ndarray | slice) -> Pose:
        """The poses of some rows."""
        return Pose(self.x[rows], self.R[rows], self.phi[rows])


@dataclass(frozen=True, eq=False)
class Mechanism:
    """One robot's topology, its named geometric parameters with nominal values, and its start values."""

    kind: str
    parameters: tuple[str, ...]
    """Names of the geometric parameters, in the order of the vector k."""
    nominal: np.ndarray
    """(nk,) nominal values [m, rad or 1]."""
    units: tuple[str, ...]
    """'m', 'rad' or '1' of each parameter."""
    rods: tuple[str, ...]
    """Names of the m rows."""
    actuators: tuple[str, ...]
    """Names of the nq actuator coordinates, e.g. q1 q2 q3."""
    actuator_dimension: str
    """'angle' or 'length'."""
    actuator: np.ndarray
    """(m,) which actuator moves each rod."""
    actuation: Actuation
    plate_columns: np.ndarray
    """(m, 3) where b_r stands in k, plate frame; no entry of a row stands twice in it, or in that of the actuation."""
    levels: Mapping[str, Level]
    start: Callable[[np.ndarray, np.ndarray], Pose]
    """Approximate plate poses for (k, q): where Newton starts."""
    level_pairs: bool = False
    """Whether `start` takes rods 2j and 2j + 1 as one virtual rod: three spheres meet below, the plate unturned."""
    task: tuple[int, ...] = (0, 1, 2)
    """Which of (x y z rx ry rz) a command prescribes; as many as there are actuators."""
    plate_dofs: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    """Which components of the plate's twist exist (a planar mechanism has 0 1 5)."""
    hinges: tuple[HingeColumns, ...] = ()
    body: np.ndarray | None = None
    """(m,) plate body of each rod: 0 the central one, h the one on hinge h; None where there is but one."""
    combinations: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Sums of parameters that are reported beside them, e.g. the paper's merged bp11.x = b11.x − p1.x."""
    rod_side: int = -1
    """Sign of every rod's z direction on the working branch, seen from base to plate; 0: not checked."""
    plate_signs: np.ndarray | None = None
    """(m, 3) factors of `plate_columns`: −1 on a coordinate counted backwards, 0 where there is none; None: all +1."""
    closed_form_inverse: bool = False
    """Whether the nominal inverse is the rods' own closed form with the plate unturned (the Delta's IPR_S)."""
    max_tilt: float = 0.3
    """[rad] a plate turned further than this from its commanded orientation is on a wrong branch."""

    def __post_init__(self) -> None:
        for rod, row in zip(self.rods, np.hstack([self.actuation.columns, self.plate_columns]), strict=True):
            if len(set(row.tolist())) < len(row):
                twice = sorted({self.parameters[i] for i in row if np.sum(row == i) > 1})
                raise ValueError(
                    f"kind {self.kind}: {', '.join(twice)} stands twice among the columns of rod {rod}, those of the "
                    "actuation and of the plate, and one derivative would overwrite the other; where plate_signs is 0 "
                    "any column serves that does not stand there yet"
                )

    @property
    def n_state(self) -> int:
        """Unknowns of the plate: its twist components and hinge angles."""
        return len(self.plate_dofs) + len(self.hinges)

    @cached_property
    def free_state(self) -> list[int]:
        """State components that a command leaves to the closure: untasked twist components and hinge angles."""
        twist = [c for c, dof in enumerate(self.plate_dofs) if dof not in self.task]
        return twist + list(range(len(self.plate_dofs), self.n_state))

    @property
    def tool_direction(self) -> np.ndarray:
        """(3,) where a straight tool points from the plate: away from the drives, in the plane of a planar one."""
        return np.array([0.0, 0.0, self.rod_side or -1.0]) if 2 in self.plate_dofs else np.array([0.0, -1.0, 0.0])

    @property
    def plate_turns(self) -> bool:
        """Whether errors can turn the plate."""
        return any(dof >= 3 for dof in self.plate_dofs)

    def index(self, name: str) -> int:
        """Position of a named parameter in k."""
        return self.parameters.index(name)

    def rods_on(self, h: int) -> np.ndarray:
        """Which rods (m,) hang on the body of hinge h."""
        assert self.body is not None
        return self.body == h + 1

    def plate_points(self, k: np.ndarray) -> np.ndarray:
        """b_r of every rod, (m, 3) [m], plate frame at zero hinge angles."""
        b = k[self.plate_columns]
        return b if self.plate_signs is None else self.plate_signs * b

    @cached_property
    def is_rod(self) -> np.ndarray:
        """(m,) bool: a rod of some length, and no guided row."""
        return self.actuation.length >= 0

    @property
    def rod_lengths(self) -> np.ndarray:
        """Where the lengths of rods stand in k."""
        return np.unique(self.actuation.length[self.is_rod])

    @property
    def base_points(self) -> np.ndarray:
        """(nq, 3) where the base point of each actuator stands in k; empty where it is no parameter."""
        return self.actuation.p

    @property
    def arm_joints(self) -> np.ndarray:
        """(m, 3) where the ball joint of each rod on its arm or carriage stands in k; empty where there are none."""
        return self.actuation.a

    @property
    def leg_scales(self) -> np.ndarray:
        """Where the scales of legs of commanded length stand in k."""
        return self.actuation.scale if self.actuation.drive == "leg" else _no_numbers()

    @cached_property
    def motor_zeros(self) -> np.ndarray:
        """(nk, nq) change of k that acts as an offset of 1 [rad or m] on each actuator, to first order."""
        return self.actuation.zeros(len(self.nominal))

    @cached_property
    def rigid_motions(self) -> np.ndarray:
        """(nk, 12) change of k by small motions (translation, rotation) of the base and of the plate as a whole.

        Motions that the parameters cannot express, as those out of a planar mechanism's plane, are zero.
        """
        out = np.zeros((len(self.nominal), 12))
        plate = [self.plate_columns] if self.plate_signs is None else []
        for side, points, turns in (
            (0, [self.actuation.p], [self.actuation.beta]),
            (6, [*plate, *(h.point[None] for h in self.hinges)], [h.tilt[None] for h in self.hinges]),
        ):
            for where in np.concatenate([_no_vectors(), *points]):
                out[where, side : side + 3] = np.eye(3)
                out[where, side + 3 : side + 6] = -rotation.hat(self.nominal[where])
            for where in np.concatenate([_no_vectors(), *turns]):
                out[where, side + 3 : side + 6] = np.eye(3)
        return out

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Every part of the robot, from its topology; a parameter of no part is one by itself."""
        found: list[Part] = []
        act, eye = self.actuation, np.eye(len(self.nominal))

        def add(name: str, words: str, *where: np.ndarray) -> None:
            columns = np.unique(np.concatenate([np.ravel(w) for w in where]))
            if len(columns) and not any(np.array_equal(eye[:, columns], part.basis) for part in found):
                found.append(Part(name, words, eye[:, columns]))

        leg = act.drive == "leg"
        for i, q in enumerate(self.actuators):
            rods = np.flatnonzero((self.actuator == i) & self.is_rod)
            drive, said = (f"leg{i + 1}", f"leg {i + 1}") if leg else (q, f"motor {q}")
            found.append(Part(f"{drive}.zero", f"the zero of {said}", self.motor_zeros[:, i : i + 1]))
            add(f"{drive}.scale", f"the motion of {said} per command", act.scale[i : i + 1])
            if leg:
                add(f"a{i + 1}", f"the ball joint of leg {i + 1} on the base", act.p[i])
            else:
                words = f"the {act.mount} of {act.moves} {i + 1}, its place and tilt"
                add(f"motor{i + 1}", words, act.p[i : i + 1], act.beta[i : i + 1])
            if len(act.a):
                add(f"arm{i + 1}", f"{act.moves} {i + 1} with its ball joints", act.a[rods])
                if len(rods) > 1:
                    add(f"pair{i + 1}", f"the rods of {act.moves} {i + 1}", act.length[rods])
        signs = np.ones(self.plate_columns.shape) if self.plate_signs is None else self.plate_signs
        for r in np.flatnonzero(self.is_rod):
            rod, said = self.rods[r], f"{'leg' if leg else 'rod'} {self.rods[r]}"
            if len(act.a):
                add(f"a{rod}", f"the ball joint of {said} on {act.moves} {self.actuator[r] + 1}", act.a[r])
            add(f"b{rod}", f"the ball joint of {said} on the plate", self.plate_columns[r][signs[r] != 0])
            if not leg:  # the length of a leg is its zero
                add(f"l{rod}", said, act.length[r])
        for h, hinge in enumerate(self.hinges, 1):
            add(f"hinge{h}", f"hinge {h} of the plate", hinge.point, hinge.tilt)
        add("plate", "the plate with its ball joints", self.plate_columns[self.is_rod][signs[self.is_rod] != 0])
        covered = np.any(np.hstack([part.basis for part in found]), axis=1)
        for j in np.flatnonzero(~covered):
            add(self.parameters[j], f"dimension {self.parameters[j]}", np.array([j]))
        return tuple(found)

    def is_setting(self, level: Level) -> np.ndarray:
        """(nz,) bool: coordinates of a level that are zeros of actuators, which are set and not made.

        None of a raw level, where the zero of a leg is the length that it was made with.
        """
        if level.raw:
            return np.zeros(level.basis.shape[1], bool)
        unit = [b / np.linalg.norm(b, axis=0) for b in (self.motor_zeros, level.basis)]
        return (np.abs(unit[0].T @ unit[1]) > 1 - 1e-9).any(axis=0)
