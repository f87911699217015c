"""A calibrated robot as rods between anchors, in numbers alone: what every export is written from.

With the geometry fixed, every base-side anchor runs on a circle or a straight line, whatever the kind of robot:

    A = O + C·cos q + S·sin q + D·q        l = L + s·q

so that one program serves rotary arms, carriages and legs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcalib import rotation
from pcalib.effects.base import ClosedForm
from pcalib.errors import EffectError, InputError
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.mechanics.paths import SAME, base_paths
from pcalib.model import Model
from pcalib.workspace import reachable

SAMPLE = 600
"""Poses over the workspace to which the start of the forward solution is fitted: twenty for each of the 28 terms of a
robot of six drives."""


@dataclass(frozen=True)
class Rods:
    """The robot as built. Vectors in metres, angles in radians, rods along the first axis."""

    name: str
    kind: str
    actuators: tuple[str, ...]
    rods: tuple[str, ...]
    dimension: str
    """'angle' or 'length' of an actuator value."""
    joint_range: tuple[float, float]
    """[rad or m] least and largest command."""
    actuator: np.ndarray
    """(m,) int, which actuator moves each rod."""
    body: np.ndarray
    """(m,) int, plate body of each rod: 0 the central one, h the one on hinge h."""
    centre: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    slope: np.ndarray
    """(m, 3) [m, m, m, m per unit of q]: O, C, S and D of the base-side anchors, base frame."""
    pivot: np.ndarray
    """(m, 3) [m] base point of each rod's actuator, from which its arm grows."""
    length: np.ndarray
    rate: np.ndarray
    """(m,) L [m] and s [m per unit of q]."""
    plate: np.ndarray
    """(m, 3) [m] plate-side anchors, plate frame, hinges at zero."""
    guided: np.ndarray
    """(m,) bool: rows whose direction the actuator prescribes, n = guide_cosine·cos q + guide_sine·sin q."""
    guide_cosine: np.ndarray
    guide_sine: np.ndarray
    """(m, 3); zero on plain rods."""
    guide_length: np.ndarray
    """(m,) [m] length of the rod that a guided row turns, which joins the same anchors; 1 on plain rods."""
    hinge_point: np.ndarray
    hinge_axis: np.ndarray
    """(h, 3) [m, 1], plate frame."""
    dofs: tuple[int, ...]
    """Components of the plate's twist that exist."""
    task: tuple[int, ...]
    """Components that a command prescribes."""
    rod_side: int
    max_tilt: float
    ratio: np.ndarray
    """(nq,) error of each drive's ratio."""
    waves: Mapping[int, tuple[np.ndarray, np.ndarray]]
    """Cycles per turn → sine and cosine of each drive's error, (nq,) [rad] each."""
    rod_growth: np.ndarray
    arm_growth: np.ndarray
    base_growth: np.ndarray
    """(m,) [1/K] by rod."""
    start: np.ndarray
    """(6 + h, 1 + nq + nq·(nq+1)/2) polynomial of second degree in u = (q − middle)/half for the plate's place [m],
    rotation vector and hinge angles [rad]: where a forward solution starts."""
    home: Pose
    """One pose, at the middle of the poses that the robot can take."""
    home_q: np.ndarray
    """(nq,) commands at home."""
    mass: Mapping[str, float]
    gravity: np.ndarray

    @property
    def nq(self) -> int:
        """Number of actuators."""
        return len(self.actuators)


def rods_of(model: Model) -> Rods:
    """The numbers of a model.

    Raises:
        EffectError: the model has an effect of which no closed form is known.
        InputError: its anchors run neither on circles nor on lines.
    """
    robot, mechanism, k = model.robot, model.robot.mechanism, model.k
    m, nq = len(mechanism.rods), len(mechanism.actuators)
    paths = base_paths(mechanism, k)
    if paths.misses(mechanism, k) > SAME:
        raise InputError(
            f"robots of kind {mechanism.kind} cannot be exported: their base-side joints run neither on circles nor "
            "on straight lines"
        )
    effects = _closed_forms(model)
    points = mechanism.base_points
    pivot = k[points][mechanism.actuator] if len(points) else np.zeros((m, 3))
    hinges = [hinge.at(k) for hinge in mechanism.hinges]
    q, pose = _poses(model)
    middle, half = 0.5 * (robot.joint_min + robot.joint_max), 0.5 * (robot.joint_max - robot.joint_min)
    terms = polynomial((q - middle) / half)
    values = np.hstack([pose.x, rotation.log(pose.R), pose.phi])
    start = np.linalg.lstsq(terms, values, rcond=None)[0].T
    off = np.linalg.norm(pose.x - pose.x.mean(axis=0), axis=1) + np.abs(rotation.log(pose.R)).sum(axis=1)
    home = int(np.argmin(off))
    return Rods(
        name=robot.name, kind=robot.kind, actuators=mechanism.actuators, rods=mechanism.rods,
        dimension=mechanism.actuator_dimension, joint_range=(float(robot.joint_min), float(robot.joint_max)),
        actuator=mechanism.actuator, body=np.zeros(m, int) if mechanism.body is None else mechanism.body,
        **vars(paths), pivot=pivot, plate=mechanism.plate_points(k),
        hinge_point=np.array([h.point for h in hinges]).reshape(-1, 3),
        hinge_axis=np.array([h.axis for h in hinges]).reshape(-1, 3),
        dofs=mechanism.plate_dofs, task=mechanism.task, rod_side=mechanism.rod_side, max_tilt=mechanism.max_tilt,
        ratio=_sum(nq, [e.ratio for e in effects]), waves=_waves(effects),
        rod_growth=_sum(m, [e.rods for e in effects]), arm_growth=_sum(m, [e.arms for e in effects]),
        base_growth=_sum(m, [e.base for e in effects]),
        start=start, home=pose.take(slice(home, home + 1)), home_q=q[home], mass=robot.mass, gravity=robot.gravity,
    )  # fmt: skip


def polynomial(u: np.ndarray) -> np.ndarray:
    """(N, 1 + n + n(n+1)/2) terms 1, u_i, u_i·u_j (i ≤ j) of u (N, n)."""
    n = u.shape[1]
    square = [u[:, i] * u[:, j] for i in range(n) for j in range(i, n)]
    return np.column_stack([np.ones(len(u)), u, *square])


def _closed_forms(model: Model) -> list[ClosedForm]:
    found = []
    for fitted in model.effects:
        if fitted.effect.channels == ("sensor",):
            continue  # the instrument errs, and no command changes with it
        form = fitted.effect.closed_form(fitted.theta)
        if form is None:
            raise EffectError(
                f"effect {fitted.effect.name} cannot be exported: it states no closed form; effects that need "
                "loads, directions or the time have none, because the controller's code does not compute these\n"
                f"  'pcalib drop {fitted.effect.name} …' refits without it; 'pcalib compensate' takes it along"
            )
        found.append(form)
    return found


def _sum(n: int, parts: list[np.ndarray | None]) -> np.ndarray:
    return np.sum([np.zeros(n), *(part for part in parts if part is not None)], axis=0)


def _waves(effects: list[ClosedForm]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    out: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for form in effects:
        for n, (sine, cosine) in form.waves.items():
            before = out.get(n, (0.0 * sine, 0.0 * cosine))
            out[n] = (before[0] + sine, before[1] + cosine)
    return dict(sorted(out.items()))


def _poses(model: Model) -> tuple[np.ndarray, Pose]:
    """Commands and plate poses over the workspace, of the geometry as built."""
    found = reachable(model.robot, SAMPLE, np.random.default_rng(0))
    solved = kinematics.forward(model.robot.mechanism, model.k, found.q, found.pose)
    return found.q[solved.ok], solved.pose.take(solved.ok)
