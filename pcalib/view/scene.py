"""The three-dimensional part of a recording: robot, tool, workspace and error field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pcalib import rotation
from pcalib.ladder import ErrorMap, Ladder
from pcalib.palette import NO_VALUE, LogScale
from pcalib.view.recording import TIMELINE, sdk
from pcalib.view.skeleton import Skeleton
from pcalib.wording import size

if TYPE_CHECKING:
    import rerun as rr

ARM, ROD, PLATE, MOTOR, BASE, JOINT, TOOL = (
    (235, 122, 38), (178, 184, 194), (58, 132, 205), (74, 79, 88), (104, 110, 121), (52, 57, 65), (226, 229, 234),
)  # fmt: skip
AXES = ((214, 76, 76), (92, 176, 92), (84, 132, 222))
"""x, y and z of the base frame: red, green and blue."""
LINE, TEXT = (70, 78, 92), (214, 219, 228)


LARGE = 0.995
"""Quantile of the errors that is drawn about as long as targets are apart: a few may be longer."""


def gain_of(errors: np.ndarray, radius: float) -> float:
    """Factor, 1, 2 or 5 times a power of ten, that draws large errors as long as targets are apart.

    Args:
        errors: (n,) [m]; zeros and NaN do not count.
        radius: [m] of the workspace.
    """
    seen = errors[np.isfinite(errors) & (errors > 0)]
    wanted = 0.3 * radius / (float(np.quantile(seen, LARGE)) if len(seen) else 1e-3)
    decade = 10.0 ** math.floor(math.log10(wanted))
    return decade * max(step for step in (1, 2, 5) if step * decade <= wanted * (1 + 1e-9))


@dataclass(frozen=True)
class Style:
    """What stays the same over all steps, so that steps compare."""

    colours: LogScale
    """[m]"""
    gain: float
    """Length of a drawn arrow per error where all steps have one scale."""
    size: float
    """[m] length that radii of drawn parts are taken from."""
    radius: float = 1.0
    """[m] radius of the workspace, by which the arrows of a single step are scaled."""

    @classmethod
    def of(cls, ladder: Ladder, size: float) -> Style:
        """Colours and arrows for all steps of a ladder."""
        errors = np.concatenate([m.distance.ravel() for m in ladder.maps]) if ladder.maps else np.zeros(0)
        errors = errors[np.isfinite(errors) & (errors > 0)]
        large = float(np.quantile(errors, LARGE)) if len(errors) else 1e-3
        gain = gain_of(errors, ladder.robot.workspace.radius)
        # From the decade of the smallest RMS: single tiny errors would stretch the scale and tell nothing.
        sizes = np.concatenate([ladder.rms.ravel(), [large]]) if ladder.maps else errors
        sizes = np.concatenate([sizes, *(m.expected.pooled for m in ladder.maps if m.expected is not None)])
        return cls(LogScale.of(sizes), gain, size, ladder.robot.workspace.radius)


def draw_robot(rec: rr.RecordingStream, path: str, s: Skeleton) -> None:
    """The robot at one pose, for all steps."""
    rr, u = sdk(), s.size
    log = _logger(rec, path)
    log("base", _capsules(_ring(s.base), 0.018 * u, BASE))
    log("rails", _capsules(s.rails, 0.016 * u, BASE))
    if len(s.rails) > 2:
        log("frame", _capsules(_ring(s.rails[:, 1]), 0.012 * u, BASE))
    axes = 0.22 * u * np.eye(3)
    log("axes", rr.Arrows3D(
        origins=np.zeros((3, 3)), vectors=axes, colors=AXES, labels=["x", "y", "z"], radii=0.004 * u, show_labels=True
    ))  # fmt: skip
    log("motors", _cylinders(s.motors, 0.055 * u, MOTOR))
    log("arms", _capsules(s.arms, 0.028 * u, ARM))
    log("elbows", _capsules(s.elbows, 0.014 * u, ARM))
    log("rods", _capsules(s.rods, 0.0075 * u, ROD))
    log("legs", _capsules(s.legs, 0.010 * u, ROD))
    if len(s.legs):
        barrels = np.stack([s.legs[:, 0], s.legs[:, 0] + 0.55 * (s.legs[:, 1] - s.legs[:, 0])], axis=1)
        log("barrels", _capsules(barrels, 0.026 * u, ARM))
    joints = np.concatenate([part.reshape(-1, 3) for part in (s.rods, s.legs)])
    log("joints", rr.Points3D(joints, radii=0.013 * u, colors=JOINT))
    for i, plate in enumerate(s.plates):
        if len(plate) < 3:
            log(f"plate{i}", _capsules(plate.reshape(1, 2, 3), 0.02 * u, PLATE))
        else:
            log(f"plate{i}", _prism(plate, 0.012 * u, PLATE))


def draw_tool(rec: rr.RecordingStream, path: str, s: Skeleton, tool: np.ndarray) -> None:
    """A tool on the robot's plate, and its TCP."""
    rr = sdk()
    start, end = s.pose.x[0], s.pose.tcp(tool)[0]
    log = _logger(rec, path)
    if np.linalg.norm(tool) > 1e-9:
        log("tool", _capsules(np.stack([start, end])[None], 0.012 * s.size, TOOL))
    log("tcp", rr.Points3D([end], radii=0.016 * s.size, colors=TOOL))


def draw_workspace(rec: rr.RecordingStream, path: str, tool: np.ndarray, radius: float, z: tuple[float, float]) -> None:
    """The working cylinder of the TCP as a wire frame: that of the plate, shifted by the tool (3,)."""
    rr = sdk()
    turn = np.linspace(0, 2 * np.pi, 97)
    circle = radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    flat = z[1] - z[0] < 0.02 * radius  # a plane needs no second circle
    levels = [(z[0] + z[1]) / 2] if flat else z
    strips = [circle + tool + [0.0, 0.0, level] for level in levels]
    if not flat:
        strips += [np.stack([strips[0][i], strips[1][i]]) for i in range(0, 96, 8)]
    _logger(rec, path)("wire", rr.LineStrips3D(strips, radii=rr.Radius.ui_points(0.7), colors=LINE))


def draw_field(
    rec: rr.RecordingStream, path: str, field: ErrorMap, labels: Sequence[str], style: Style, title: np.ndarray
) -> None:
    """The error field of one tool: arrows and dots on the timeline, colours the same in every step.

    The arrows stand twice: `error` with one scale for all steps, `error_of_step` with a scale of each step's own, so
    that its pattern is seen however small it is; the title says which.

    Args:
        labels: name of each step, shown in the scene at `title` (3,).
    """
    rr = sdk()
    colours = style.colours.rgb(field.distance)
    rms = field.rms
    for s, label in enumerate(labels):
        rec.set_time(TIMELINE, sequence=s)
        good = field.status[s] == "ok"
        own = gain_of(field.distance[s], style.radius)
        for name, gain in (("error", style.gain), ("error_of_step", own)):
            rec.log(
                f"{path}/{name}",
                rr.Arrows3D(
                    origins=field.targets[good], vectors=gain * field.errors[s, good], colors=colours[s, good],
                    radii=0.0030 * style.size,
                ),
            )  # fmt: skip
        rec.log(f"{path}/target", rr.Points3D(field.targets[good], radii=0.0070 * style.size, colors=colours[s, good]))
        rec.log(f"{path}/missed", rr.Points3D(field.targets[~good], radii=0.004 * style.size, colors=NO_VALUE))
        text = f"{s} · {label} · RMS {size(rms[s])} · arrows ×{own:g}"
        if rms[s] == 0:
            text = f"{s} · {label} · the model's own commands: nothing is missed by what it says"
        rec.log(f"{path}/title", rr.Points3D([title], labels=[text], show_labels=True, radii=1e-4, colors=TEXT))
    rec.reset_time()


def draw_expected(
    rec: rr.RecordingStream, path: str, field: ErrorMap, labels: Sequence[str], style: Style, title: np.ndarray
) -> None:
    """How far off the TCP may be by each step's model: ellipsoids of 95 % at the targets, one scale for all steps.

    Args:
        labels: name of each step, shown in the scene at `title` (3,).
    """
    rr = sdk()
    expected = field.expected
    assert expected is not None
    gain = gain_of(2 * expected.u95, style.radius)
    for s, label in enumerate(labels):
        rec.set_time(TIMELINE, sequence=s)
        good = np.isfinite(expected.u95[s])
        sigma, axes = _axes(expected.covariance[s, good])
        times = expected.u95[s, good] / np.maximum(np.linalg.norm(sigma, axis=1), 1e-15)
        rec.log(
            f"{path}/may_miss",
            rr.Ellipsoids3D(
                centers=field.targets[good], half_sizes=gain * times[:, None] * sigma,
                quaternions=rotation.to_quaternion(axes), colors=style.colours.rgb(expected.u95[s, good]),
                fill_mode=rr.components.FillMode.Solid,
            ),
        )  # fmt: skip
        said = f"95 % of landings within {size(expected.pooled[s])} · drawn ×{gain:g}"
        text = f"{s} · {label} · {said if good.any() else 'states no uncertainty'}"
        title_of = rr.Points3D([title], labels=[text], show_labels=True, radii=1e-4, colors=TEXT)
        rec.log(f"{path}/may_miss_title", title_of)
    rec.reset_time()


def _axes(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half axes (n, 3) [m] of the 1σ ellipsoids of covariances (n, 3, 3) [m²], and rotations (n, 3, 3) onto them."""
    values, axes = np.linalg.eigh(covariance)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1.0
    return np.sqrt(np.maximum(values, 0.0)), axes


def _logger(rec: rr.RecordingStream, path: str) -> Any:
    def log(name: str, what: Any) -> None:
        if what is not None:
            rec.log(f"{path}/{name}", what, static=True)

    return log


def _ring(points: np.ndarray) -> np.ndarray:
    """(n, 2, 3) segments that close a polygon."""
    if len(points) < 2:
        return np.zeros((0, 2, 3))
    following = np.roll(points, -1, axis=0)
    return np.stack([points, following], axis=1)[: len(points) if len(points) > 2 else 1]


def _turns(segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions (n, 4) xyzw that turn z along each segment, and lengths (n,)."""
    along = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(along, axis=1)
    d = along / np.where(length > 0, length, 1.0)[:, None]
    half = np.stack([-d[:, 1], d[:, 0], 0 * d[:, 0], 1 + d[:, 2]], axis=-1)  # z × d and 1 + z·d
    half[1 + d[:, 2] < 1e-9] = [1.0, 0.0, 0.0, 0.0]
    return half / np.linalg.norm(half, axis=1, keepdims=True), length


def _capsules(segments: np.ndarray, radius: float, colour: tuple[int, int, int]) -> Any:
    if len(segments) == 0:
        return None
    rr = sdk()
    quaternions, lengths = _turns(segments)
    n = len(segments)  # one number is drawn once, whatever the number of places
    return rr.Capsules3D(
        lengths=lengths, radii=np.full(n, radius), translations=segments[:, 0], quaternions=quaternions,
        colors=[colour] * n, fill_mode=rr.components.FillMode.Solid,
    )  # fmt: skip


def _cylinders(segments: np.ndarray, radius: float, colour: tuple[int, int, int]) -> Any:
    if len(segments) == 0:
        return None
    rr = sdk()
    quaternions, lengths = _turns(segments)
    n = len(segments)
    return rr.Cylinders3D(
        lengths=lengths, radii=np.full(n, radius), centers=segments.mean(axis=1), quaternions=quaternions,
        colors=[colour] * n, fill_mode=rr.components.FillMode.Solid,
    )  # fmt: skip


def _prism(polygon: np.ndarray, half: float, colour: tuple[int, int, int]) -> Any:
    """A plate of thickness 2·half with the given outline (n, 3), its normals flat."""
    rr = sdk()
    middle = polygon.mean(axis=0)
    _, _, axes = np.linalg.svd(polygon - middle, full_matrices=False)
    normal = axes[2]
    vertices, normals, triangles = [], [], []

    def fan(points: np.ndarray, n: np.ndarray) -> None:
        start = len(vertices)
        vertices.extend(points)
        normals.extend([n] * len(points))
        triangles.extend([start, start + i, start + i + 1] for i in range(1, len(points) - 1))

    top, bottom = polygon + half * normal, polygon - half * normal
    fan(top, normal)
    fan(bottom[::-1], -normal)
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        outwards = rotation.cross(polygon[j] - polygon[i], normal)
        fan(np.array([bottom[i], bottom[j], top[j], top[i]]), outwards / np.linalg.norm(outwards))
    return rr.Mesh3D(
        vertex_positions=np.array(vertices), vertex_normals=np.array(normals), triangle_indices=np.array(triangles),
        albedo_factor=(*colour, 255),
    )  # fmt: skip
