"""The Delta: three arms, six rods in three parallelograms, three translations (paper section II)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcalib import rotation
from pcalib.kinds import Kind, azimuths, radius, size
from pcalib.mechanics.actuation import Carriages, RotaryArms
from pcalib.mechanics.layout import AS_DRAWN, EVERYTHING
from pcalib.mechanics.mechanism import Level, Mechanism, Pose

_AXES = "xyz"


def build(dimensions: Mapping[str, Any]) -> Mechanism:
    """A Delta from its nominal dimensions, 60 raw parameters: p(9) a(18) b(18) l(6) beta(9)."""
    azimuth = dimensions["axis_azimuth"]
    half = 0.5 * dimensions["rod_spacing"]
    arm = np.repeat(np.arange(3), 2)
    pairs = [f"{i + 1}{j + 1}" for i in range(3) for j in range(2)]

    u = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
    v = np.stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1)
    side = np.tile([-half, half], 3)[:, None]
    p = dimensions["base_radius"] * v
    a = np.hstack([side, np.full((6, 1), dimensions["arm_length"]), np.zeros((6, 1))])
    b = side * u[arm] + dimensions["plate_radius"] * v[arm]

    parameters, values = [], []
    for name, block in [
        *((f"p{i + 1}", p[i]) for i in range(3)),
        *((f"a{pair}", a[r]) for r, pair in enumerate(pairs)),
        *((f"b{pair}", b[r]) for r, pair in enumerate(pairs)),
    ]:
        parameters += [f"{name}.{axis}" for axis in _AXES]
        values += list(block)
    parameters += [f"l{pair}" for pair in pairs] + [f"beta{i + 1}.{axis}" for i in range(3) for axis in _AXES]
    values += [dimensions["rod_length"]] * 6 + [0.0] * 9
    at = {name: i for i, name in enumerate(parameters)}

    def where(names: list[str]) -> np.ndarray:
        return np.array([[at[f"{name}.{axis}"] for axis in _AXES] for name in names])

    actuation = RotaryArms(
        azimuth=azimuth,
        actuator=arm,
        p=where(["p1", "p2", "p3"]),
        beta=where(["beta1", "beta2", "beta3"]),
        a=where([f"a{pair}" for pair in pairs]),
        length=np.array([at[f"l{pair}"] for pair in pairs]),
    )
    plate_columns = where([f"b{pair}" for pair in pairs])
    units = tuple("rad" if name.startswith("beta") else "m" for name in parameters)
    nominal = np.array(values)
    return Mechanism(
        kind="delta",
        parameters=tuple(parameters),
        nominal=nominal,
        units=units,
        rods=tuple(pairs),
        actuators=("q1", "q2", "q3"),
        actuator_dimension="angle",
        actuator=arm,
        actuation=actuation,
        plate_columns=plate_columns,
        levels=_levels(tuple(parameters), units, u, a[:, 0]),
        combinations={
            f"bp{pair}.{axis}": {f"b{pair}.{axis}": 1.0, f"p{pair[0]}.{axis}": -1.0} for pair in pairs for axis in _AXES
        },
        closed_form_inverse=True,
        start=lambda k, q: simplified_pose(actuation, plate_columns, k, q),
    )


_CLASSICAL = (
    "One rod for each parallelogram, one length for each arm and rod, one offset for each motor. The plate cannot tilt "
    "in this model."
)
_MODEL24 = (
    "All that perfect parallelograms can have wrong (Vischer's Model 24). The plate's centre is right; its tilt is not "
    "in the model, so the miss grows with the tool."
)


def _levels(
    parameters: tuple[str, ...], units: tuple[str, ...], u: np.ndarray, ax: np.ndarray
) -> dict[str, Level]:
    """The named geometry levels as subspaces of the 60 raw parameters."""
    at = {name: i for i, name in enumerate(parameters)}

    def level(name: str, columns: list[tuple[str, str, dict[str, float]]], text: str) -> Level:
        basis = np.zeros((len(parameters), len(columns)))
        for j, (_, _, entries) in enumerate(columns):
            for key, value in entries.items():
                basis[at[key], j] = value
        return Level(name, tuple(c[0] for c in columns), basis, tuple(c[1] for c in columns), perfect=True, text=text)

    lengths, offsets, plates, turns = [], [], [], []
    for i in range(1, 4):
        both = [f"{i}1", f"{i}2"]
        lengths.append((f"arm{i}.length", "m", {f"a{pair}.y": 1.0 for pair in both}))
        lengths.append((f"rod{i}.length", "m", {f"l{pair}": 1.0 for pair in both}))
        offsets.append((f"q{i}.offset", "rad", {f"beta{i}.{c}": u[i - 1, n] for n, c in enumerate(_AXES)}))
        plates += [(f"bp{i}.{c}", "m", {f"b{pair}.{c}": 1.0 for pair in both}) for c in _AXES]
        for n, c in enumerate(_AXES):
            # The plate side turns with the motor axis, so that the parallelogram stays perfect (to first order).
            entries = {f"beta{i}.{c}": 1.0}
            swing = np.cross(np.eye(3)[n], u[i - 1])
            for j, pair in enumerate(both):
                entries |= {f"b{pair}.{e}": ax[2 * (i - 1) + j] * swing[m] for m, e in enumerate(_AXES)}
            turns.append((f"beta{i}.{c}", "rad", entries))
    return {
        "nominal": level("nominal", [], AS_DRAWN),
        "classical": level("classical", offsets + lengths, _CLASSICAL),
        "model24": level("model24", plates + lengths + turns, _MODEL24),
        "complete": Level("complete", parameters, np.eye(len(parameters)), units, text=EVERYTHING),
    }


def simplified_forward(
    actuation: RotaryArms | Carriages, plate_columns: np.ndarray, k: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """FPR_S: plate position of the perfect-parallelogram Delta, (N, 3) [m], NaN where its spheres do not meet.

    The middle of each pair is one virtual rod; shifted by the plate side, its three spheres meet in the plate
    centre, and the lower of the two points is the working branch.
    """
    side = actuation.base(k, q)
    centre = side.A - k[plate_columns]
    centre = 0.5 * (centre[:, 0::2] + centre[:, 1::2])
    length = k[actuation.length].reshape(3, 2).mean(axis=1)
    s1 = centre[:, 0]
    e, f = centre[:, 1] - s1, centre[:, 2] - s1
    ee, ff, ef = rotation.dot(e, e), rotation.dot(f, f), rotation.dot(e, f)
    ge = 0.5 * (ee + length[0] ** 2 - length[1] ** 2)
    gf = 0.5 * (ff + length[0] ** 2 - length[2] ** 2)
    det = ee * ff - ef * ef
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = ((ge * ff - gf * ef) / det)[:, None] * e + ((gf * ee - ge * ef) / det)[:, None] * f
        normal = rotation.cross(e, f) / np.sqrt(det)[:, None]
        normal *= -np.sign(normal[:, 2:])
        height = np.sqrt(length[0] ** 2 - rotation.dot(foot, foot))
    return s1 + foot + height[:, None] * normal


def simplified_pose(
    actuation: RotaryArms | Carriages, plate_columns: np.ndarray, k: np.ndarray, q: np.ndarray
) -> Pose:
    """FPR_S as a plate pose with the plate parallel to the base."""
    x = simplified_forward(actuation, plate_columns, k, q)
    return Pose(x, np.broadcast_to(np.eye(3), (len(x), 3, 3)).copy(), np.zeros((len(x), 0)))


KIND = Kind(
    name="delta",
    dimensions=(
        radius("base_radius"),
        size("arm_length"),
        size("rod_length"),
        radius("plate_radius"),
        size("rod_spacing"),
        azimuths("axis_azimuth", 3),
    ),
    build=build,
)
