"""How an instrument measures the poses of the robot.

One instrument has all properties, most of them zero: noise of some sort (`bench.noises`), a frame of its own,
resolution, rows and components that go missing, gross outliers. Its drift and its scale are faults. Kinds differ in
what they see:

    pose       position and rotation (a 6-D laser tracker, a camera on a target)
    position   position only (a laser tracker on one reflector)
    probe      z only (a touch probe)
    contact    z only, by commands that are lowered until the tool touches a level bed (`bench.contact`)
    none       nothing: sensors measure that read no pose (`bench.sensors`)

Order: true pose → frame of the instrument (tracker) → faults of it → noise, outliers → resolution → missing.
Every row draws from a generator of its own, so that neither the order nor the number of workers matters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import noises
from bench.noises import Scene
from pcalib import rotation, settings
from pcalib.data.instrument import Instrument as Description
from pcalib.settings import Setting

MEASURED = {
    "pose": (True,) * 6,
    "position": (True, True, True, False, False, False),
    "probe": (False, False, True, False, False, False),
    "contact": (False, False, True, False, False, False),
    "none": (False,) * 6,
}
"""Which of x, y, z, rx, ry, rz each kind sees."""

SETTINGS = (
    Setting("kind", "word", "pose", words=tuple(MEASURED), about="what it sees"),
    Setting("noise", "word", "white", words=tuple(noises.names()), about="how its readings err"),
    Setting("sigma_pos", "length", 0.0, 0.0, 0.1, about="1σ per component of position"),
    Setting("sigma_rot", "angle", 0.0, 0.0, 0.2, about="1σ per component of rotation"),
    Setting("sigma_distance", "ratio", 0.0, 0.0, 1e-2, about="further 1σ per distance from the instrument"),
    Setting("sigma_joint", "angle", 0.0, 0.0, 0.1, about="repeatability of the drives, anew for every row"),
    Setting("sigma_carriage", "length", 0.0, 0.0, 0.1, about="the same where drives move along a length"),
    Setting("frame", "word", "base", words=("base", "tracker"), about="'tracker': its place is unknown to the user"),
    Setting("position", "length", np.array([2.5, -1.0, -0.4]), count=3, about="where it stands, base frame"),
    Setting("rotation", "angle", np.array([0.3, -0.2, 2.0]), count=3, about="rotation vector, its axes → base"),
    Setting("resolution_pos", "length", 0.0, 0.0, 0.1, about="step of its last digit"),
    Setting("resolution_rot", "angle", 0.0, 0.0, 0.2, about="step of its last digit, rotation vector"),
    Setting("outliers", "number", 0.0, 0.0, 1.0, about="share of rows that are grossly wrong"),
    Setting("outlier_size", "length", 1e-3, 0.0, 1.0, about="1σ of their position error per component"),
    Setting("missing_rows", "number", 0.0, 0.0, 1.0, about="share of rows that are lost"),
    Setting("missing_rotations", "number", 0.0, 0.0, 1.0, about="share of rows without rotation"),
    Setting("missing_components", "number", 0.0, 0.0, 1.0, about="share of x, y, z that are blank"),
    Setting("bed", "length", -0.8, about="height of the bed that a contact touches, base frame"),
    Setting("state_sigma", "flag", True, about="whether the data file tells σ"),
    Setting("state_covariance", "flag", False, about="whether it describes the instrument, from which it follows"),
    *noises.all_settings(),
)


@dataclass(frozen=True)
class Reading:
    """What the instrument wrote down for N rows."""

    position: np.ndarray
    """(N, 3) [m], measuring frame; NaN where not measured."""
    rotation: np.ndarray
    """(N, 3, 3); NaN where not measured."""
    sigma_pos: np.ndarray
    """(N,) [m] 1σ per component, as the instrument's maker states it."""
    sigma_rot: np.ndarray
    """(N,) [rad] 1σ per component of the rotation."""
    covariance: np.ndarray
    """(N, 6, 6) [m, rad] true covariance of the noise of each row."""
    description: Description | None
    """What the data file states of the instrument beside or instead of σ."""
    states: tuple[bool, bool]
    """Whether the data file states σ of positions, and σ of rotations."""
    lost: np.ndarray
    """(N,) bool, rows that never made it into the file."""
    outlier: np.ndarray
    """(N,) bool."""


class Instrument:
    """An instrument with given settings (SI)."""

    def __init__(self, **values: Any):
        known = {s.name for s in SETTINGS}
        unknown = set(values) - known
        if unknown:
            raise TypeError(f"no such setting of an instrument: {', '.join(sorted(unknown))}")
        defaults = settings.read({}, SETTINGS, "instrument")
        self.values: dict[str, Any] = defaults | values

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Instrument:
        """Return the instrument of the [instrument] table of a truth file.

        Raises:
            InputError: see :func:`pcalib.settings.read`.
        """
        return cls(**settings.read(table, SETTINGS, "instrument"))

    def to_table(self) -> dict[str, Any]:
        """Return the table that gives this instrument again."""
        return settings.write(self.values, SETTINGS)

    def frame(self, tcp: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (N, 3) [m] and rotations (N, 3, 3) of the base frame in that of the instrument."""
        if self.values["frame"] == "base":
            return tcp, R
        turn = rotation.exp(self.values["rotation"])
        return (tcp - self.values["position"]) @ turn, turn.T @ R

    def joint_noise(self, q: np.ndarray, dimension: str, seed: int, rows: np.ndarray) -> np.ndarray:
        """Return (N, nq) by which the drives miss their commands; `rows` (N,) are the rows' numbers in the plan."""
        sigma = self.values["sigma_joint" if dimension == "angle" else "sigma_carriage"]
        if not sigma:
            return np.zeros_like(q)
        return sigma * np.stack([noises.generator(seed, 2 * int(r) + 1).standard_normal(q.shape[1]) for r in rows])

    def read(
        self, tcp: np.ndarray, R: np.ndarray, seed: int, rows: np.ndarray, tool: np.ndarray | float = 0.0
    ) -> Reading:
        """Measure N poses.

        Args:
            tcp: (N, 3) [m] and R (N, 3, 3) in the instrument's frame.
            rows: (N,) numbers of the rows in the plan: what each row draws depends on seed and number alone, and where
                noise is correlated in time on the rows before it.
            tool: (N, 3) [m] the measured points in the plate frame.
        """
        v, n = self.values, len(tcp)
        draws = np.empty((n, 16))
        for i, row in enumerate(rows):
            drawn = noises.generator(seed, 2 * int(row))
            draws[i, :9], draws[i, 9:] = drawn.standard_normal(9), drawn.random(7)

        station = np.zeros(3) if v["frame"] == "tracker" else np.asarray(v["position"], float)
        scene = Scene(tcp, R, np.broadcast_to(tool, (n, 3)), station, rows, draws[:, :6], seed)
        noise = noises.get(v["noise"])(v)
        error = noise.errors(scene)
        outlier = draws[:, 9] < v["outliers"]
        position = tcp + error[:, :3] + (outlier * v["outlier_size"])[:, None] * draws[:, 6:9]
        position = _rounded(position, v["resolution_pos"])
        R = rotation.exp(error[:, 3:]) @ R if error[:, 3:].any() else R.copy()
        if v["resolution_rot"]:
            R = rotation.exp(_rounded(rotation.log(R), v["resolution_rot"]))

        position = np.where(draws[:, 12:15] < v["missing_components"], np.nan, position)
        R[draws[:, 11] < v["missing_rotations"]] = np.nan
        sees = np.array(MEASURED[v["kind"]])
        position[:, ~sees[:3]] = np.nan
        if not sees[3]:
            R = np.full_like(R, np.nan)
        said = noise.description(scene) if v["state_covariance"] else None
        sigma = noise.stated(scene)
        beside = noise.BESIDE if said is not None else (True, True)
        pos, rot = (bool(v["state_sigma"] and also and s.any()) for also, s in zip(beside, sigma, strict=True))
        lost = draws[:, 10] < v["missing_rows"]
        return Reading(position, R, *sigma, noise.covariance(scene), said, (pos, rot), lost, outlier)


def _rounded(values: np.ndarray, step: float) -> np.ndarray:
    return np.round(values / step) * step if step else values
