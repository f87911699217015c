"""How far from the drawing a fitted robot is, in as few numbers as say it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcalib.fitting.identifiability import PRIOR
from pcalib.fitting.unknowns import Unknowns
from pcalib.model import Model

FAR = 20.0
"""Manufacturing tolerances (1σ) beyond which a value is not taken on trust: 2 mm, 1° or 2 %, which a technician would
see on the robot."""
_MOST = 12
"""Numbers after which the list ends: a robot that needs more is another robot."""


@dataclass(frozen=True)
class Far:
    """One value that lies far from the drawing."""

    name: str
    """A coordinate of the level, or a part that one number describes: `l11`, `q2.zero`."""
    words: str
    """What a technician calls it."""
    change: float
    """Change from the drawing [SI]."""
    sigma: float
    """1σ of the change [SI]."""
    tolerances: float
    """|change| over the manufacturing tolerance (1σ)."""
    unit: str
    """'m', 'rad' or '1'."""
    setting: bool
    """Whether somebody sets the value, as the zero of a motor; other values are made in a workshop."""

    def sentence(self) -> str:
        """How far the value lies from the drawing, in words."""
        value, unit = {"m": (1e3, " mm"), "rad": (180 / np.pi, "°"), "1": (100.0, " %")}[self.unit]
        return (
            f"{self.words} is {self.change * value:+.3g}{unit} from the drawing (± {self.sigma * value:.2g}{unit}), "
            f"{self.tolerances:.0f} times its tolerance"
        )


def far(model: Model, unknowns: Unknowns, covariance: np.ndarray, least: float = FAR) -> tuple[Far, ...]:
    """What lies more than `least` tolerances from the drawing, the farthest first.

    The errors of all parameters, in tolerances and without motions of the base or of the plate as a whole, are taken
    apart by matching pursuit: the one number that explains most of them comes first, and the search goes on with the
    remainder. The zero of a motor is thus found where it says in one number what six parameters say.

    Args:
        covariance: (n, n) of the unknowns [SI].
    """
    mechanism, g = model.robot.mechanism, unknowns.n_geometry
    if g == 0:
        return ()
    tolerance = np.array([model.options.prior.get(unit, PRIOR[unit]) for unit in mechanism.units])
    U, s, _ = np.linalg.svd(mechanism.rigid_motions / tolerance[:, None], full_matrices=False)
    U = U[:, s > 1e-9 * s[0]]
    level = unknowns.level
    columns = [level.columns.index(name) for name in unknowns.names[:g]]
    setting = mechanism.is_setting(level)
    found = []
    drive = "rad" if mechanism.actuator_dimension == "angle" else "m"
    inside = unknowns.basis @ np.linalg.lstsq(unknowns.basis, mechanism.motor_zeros, rcond=None)[0]
    for i, zero in enumerate(mechanism.motor_zeros.T):
        part = next(part for part in mechanism.parts if np.array_equal(part.basis[:, 0], zero))
        if np.allclose(inside[:, i], zero, atol=1e-9):  # else the level cannot make it
            found.append((part.name, part.words, drive, True, zero))
    for name, j in zip(unknowns.names[:g], columns, strict=True):
        found.append((name, name, level.units[j], bool(setting[j]), level.basis[:, j]))
    scaled = np.stack([basis for *_, basis in found], axis=1) / tolerance[:, None]
    scaled -= U @ (U.T @ scaled)
    length = np.linalg.norm(scaled, axis=0)
    error = model.errors / tolerance
    error -= U @ (U.T @ error)
    half = (unknowns.basis / tolerance[:, None]) @ covariance[:g, :g] @ (unknowns.basis / tolerance[:, None]).T
    out: list[Far] = []
    free = length > 1e-6 * length.max()
    while free.any() and len(out) < _MOST:
        direction = scaled / np.where(free, length, np.inf)
        share = direction.T @ error
        best = int(np.argmax(np.abs(share)))
        name, words, unit, is_set, _ = found[best]
        change = share[best] / length[best]
        size = abs(change) / PRIOR[unit]
        if not size > least:
            break
        sigma = np.sqrt(direction[:, best] @ half @ direction[:, best]) / length[best]
        out.append(Far(name, words, float(change), float(sigma), float(size), unit, is_set))
        error = error - direction[:, best] * share[best]
        free[best] = False
    return tuple(out)
