"""MJCF of the calibrated robot: rods between anchors as built, loops closed by connects, for MuJoCo.

Arms, carriages, legs and rods are bodies; a `connect` holds the end of every rod in its ball joint on the plate. Every
drive is a joint and a position actuator of its own name; the actuator takes commands as the robot does, and its gear
is the drive's identified ratio.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

import numpy as np

from pcalib import rotation
from pcalib.errors import EffectError
from pcalib.export import Target
from pcalib.export.rods import Rods, rods_of
from pcalib.export.vectors import plain
from pcalib.model import Model

LEAST = 1e-3
"""[kg] mass of a part whose mass the robot file does not give; MuJoCo needs some."""
SMALLEST = 0.01
"""[m] radius of the ball whose inertia a plate has where all rods meet in its origin; MuJoCo needs some."""
STIFF = {"angle": 1e4, "length": 1e5}
"""[N·m/rad, N/m] gain of the position actuators: a start, which a user's controller replaces."""
ROTOR = {"angle": 0.02, "length": 1.0}
"""[kg·m², kg] inertia of a geared motor at its joint."""
STEP = 5e-4
"""[s] time step: ten steps in the fastest oscillation of such a gain on the inertia below."""


@dataclass
class _Scene:
    """The XML in the making: lines of the world, of equalities, and joint positions at home in the order of joints."""

    world: list[str] = field(default_factory=list)
    equalities: list[str] = field(default_factory=list)
    home: list[float] = field(default_factory=list)


def write(model: Model) -> dict[str, str]:
    """The file of a model.

    Raises:
        EffectError: the model has effects, of which this form holds none.
    """
    left = [f.effect.name for f in plain(model).effects]
    if left:
        raise EffectError(
            f"effect {left[0]} cannot be written as MJCF, which holds the geometry alone\n"
            f"  'pcalib drop {left[0]} …' refits without it"
        )
    rods = rods_of(model)
    return {f"{rods.kind}.xml": xml(rods)}


def xml(rods: Rods) -> str:
    """The whole model."""
    scene = _Scene()
    for i in range(rods.nq):
        _drive(rods, i, scene)
    _plate(rods, scene)
    where = rods.home.x[0]
    extent = float(np.linalg.norm(rods.centre - where, axis=1).max())
    low, high = rods.joint_range
    lines = [
        f"<mujoco model={quoteattr(rods.name)}>",
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option gravity="{_list(rods.gravity)}" timestep="{STEP!r}" integrator="implicitfast">',
        '    <flag contact="disable"/>',
        "  </option>",
        f'  <statistic center="{_list(0.5 * (where + rods.centre.mean(axis=0)))}" extent="{extent!r}"/>',
        "  <default>",
        '    <geom contype="0" conaffinity="0" mass="0" rgba="0.6 0.63 0.7 1"/>',
        '    <equality solref="0.002 1" solimp="0.99 0.9999 0.0001"/>',
        '    <joint armature="1e-4" damping="1e-3"/>',
        f'    <default class="drive"><joint armature="{ROTOR[rods.dimension]!r}" damping="1"/></default>',
        "  </default>",
        "  <worldbody>",
        f'    <light pos="{_list(where + [0.4, -0.6, 1.5])}" dir="-0.2 0.3 -1"/>',
        *scene.world,
        "  </worldbody>",
        "  <equality>",
        *scene.equalities,
        "  </equality>",
        "  <actuator>",
        *(
            f'    <position name="{q}" joint="{q}" gear="{float(1 / ratio)!r}" kp="{STIFF[rods.dimension]!r}" '
            f'dampratio="1" ctrlrange="{low!r} {high!r}"/>'
            for q, ratio in zip(rods.actuators, ratios(rods), strict=True)
        ),
        "  </actuator>",
        "  <sensor>",
        *(f'    <actuatorpos name="{q}" actuator="{q}"/>' for q in rods.actuators),
        '    <framepos name="tool_position" objtype="site" objname="tool"/>',
        '    <framequat name="tool_rotation" objtype="site" objname="tool"/>',
        "  </sensor>",
        "  <keyframe>",
        f'    <key name="home" qpos="{_list(scene.home)}" ctrl="{_list(rods.home_q)}"/>',
        "  </keyframe>",
        "</mujoco>",
        "",
    ]
    return "\n".join(lines)


def ratios(rods: Rods) -> np.ndarray:
    """(nq,) motion of each drive's joint per unit of its command."""
    speed = np.linalg.norm(rods.slope, axis=1) + np.abs(rods.rate)
    speed = np.where(speed > 0, speed, 1.0)
    return np.array([speed[(rods.actuator == i) & ~rods.guided][0] for i in range(rods.nq)])


def _list(values: np.ndarray | list[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def _inertial(mass: float, size: float, at: np.ndarray) -> str:
    mass = max(mass, LEAST)
    ball = 0.4 * mass * size**2
    return f'<inertial pos="{_list(at)}" mass="{mass!r}" diaginertia="{_list([ball] * 3)}"/>'


def _ends(rods: Rods, r: int) -> tuple[np.ndarray, np.ndarray]:
    """Both ends of a rod at home, base frame."""
    q = rods.home_q[rods.actuator[r]]
    A = rods.centre[r] + rods.cosine[r] * np.cos(q) + rods.sine[r] * np.sin(q) + rods.slope[r] * q
    b = rods.plate[r]
    if rods.body[r]:
        h = rods.body[r] - 1
        turn = rotation.about(rods.hinge_axis[h], rods.home.phi[0, h])
        b = rods.hinge_point[h] + turn @ (b - rods.hinge_point[h])
    return A, rods.home.x[0] + rods.home.R[0] @ b


def _drive(rods: Rods, i: int, scene: _Scene) -> None:
    """A drive with the part that it moves and the rods that hang on it."""
    mine = [int(r) for r in np.flatnonzero(rods.actuator == i) if not rods.guided[r]]
    name, q, first = rods.actuators[i], rods.home_q[i], mine[0]
    if rods.cosine[first].any():  # an arm: both anchors run on circles about one axis
        axis = np.cross(rods.cosine[first], rods.sine[first])
        axis = axis / np.linalg.norm(axis)
        tips = np.array([rods.centre[r] + rods.cosine[r] for r in mine])
        pivot, middle = rods.pivot[first], tips.mean(axis=0)
        if not pivot.any():
            pivot = rods.centre[mine].mean(axis=0)
        along = middle - pivot
        com = pivot + along * min(rods.mass.get("arm_com", 0.0) / max(np.linalg.norm(along), 1e-9), 1.0)
        scene.world += [
            f'    <body name="arm{i + 1}">',
            f'      <joint class="drive" name="{name}" axis="{_list(axis)}" pos="{_list(rods.centre[first])}"/>',
            f"      {_inertial(rods.mass.get('arm', 0.0), 0.5 * float(np.linalg.norm(along)), com)}",
            *(f'      <geom type="capsule" size="0.008" fromto="{_list(pivot)} {_list(tip)}"/>' for tip in tips),
        ]
        scene.home.append(float(q))
        turn = rotation.exp(axis * q)
        for r, tip in zip(mine, tips, strict=True):
            _rod(rods, r, tip, turn, scene, "      ")
        scene.world.append("    </body>")
    elif rods.slope[first].any():  # a carriage: its anchors run on lines
        speed = float(np.linalg.norm(rods.slope[first]))
        start = rods.centre[mine].mean(axis=0)
        scene.world += [
            f'    <body name="carriage{i + 1}">',
            f'      <joint class="drive" name="{name}" type="slide" axis="{_list(rods.slope[first] / speed)}"/>',
            f"      {_inertial(rods.mass.get('carriage', 0.0), 0.03, start)}",
            f'      <geom type="sphere" size="0.02" pos="{_list(start)}"/>',
        ]
        scene.home.append(speed * float(q))
        for r in mine:
            _rod(rods, r, rods.centre[r], np.eye(3), scene, "      ")
        scene.world.append("    </body>")
    else:
        for r in mine:
            _leg(rods, r, i, scene)


def _towards(direction: np.ndarray) -> np.ndarray:
    """(3, 3) a frame whose −z points along a direction (3,)."""
    z = -direction / np.linalg.norm(direction)
    other = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(other, z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _rod(rods: Rods, r: int, at: np.ndarray, turn: np.ndarray, scene: _Scene, indent: str) -> None:
    """A rod of fixed length on two hinges, in a parent that is turned by `turn` (3, 3) at home."""
    A, B = _ends(rods, r)
    tag, length = rods.rods[r], float(rods.length[r])
    frame = _towards(turn.T @ (B - A))
    scene.world += [
        f'{indent}<body name="rod{tag}" pos="{_list(at)}" quat="{_list(rotation.to_quaternion(frame))}">',
        f'{indent}  <joint name="rod{tag}.x" axis="1 0 0"/><joint name="rod{tag}.y" axis="0 1 0"/>',
        f"{indent}  {_inertial(rods.mass.get('rod', 0.0), length / 4, np.array([0, 0, -length / 2]))}",
        f'{indent}  <geom type="capsule" size="0.004" fromto="0 0 0 0 0 {-length!r}"/>',
        f'{indent}  <site name="end{tag}" pos="0 0 {-length!r}"/>',
        f"{indent}</body>",
    ]
    scene.home += [0.0, 0.0]
    scene.equalities.append(f'    <connect name="joint{tag}" site1="end{tag}" site2="b{tag}"/>')


def _leg(rods: Rods, r: int, i: int, scene: _Scene) -> None:
    """A leg from a fixed base joint: of commanded length, or of fixed length and turned by the drive."""
    A, B = _ends(rods, r)
    tag, name, q = rods.rods[r], rods.actuators[i], float(rods.home_q[i])
    length, rate = float(rods.length[r]), float(rods.rate[r])
    planar = len(rods.dofs) < 6
    guide = [g for g in np.flatnonzero(rods.guided) if np.allclose(rods.centre[g], rods.centre[r])]
    direction = B - A
    hinges, positions = [("x", [1.0, 0, 0]), ("y", [0, 1.0, 0])], [0.0, 0.0]
    if planar:
        frame = _towards(direction)
        hinges, positions = [("z", list(frame.T @ [0, 0, 1.0]))], [0.0]
    if guide:  # the drive turns this rod: at q = 0 it is normal to its guide
        axis = np.cross(rods.guide_cosine[guide[0]], rods.guide_sine[guide[0]])
        direction = rotation.exp(-axis * q) @ direction
        frame = _towards(direction)
        hinges, positions = [("", list(frame.T @ axis))], [q]
    frame = _towards(direction)
    scene.world.append(f'    <body name="rod{tag}" pos="{_list(A)}" quat="{_list(rotation.to_quaternion(frame))}">')
    for suffix, axis in hinges:
        called = f"rod{tag}.{suffix}" if suffix else name
        sort = "" if suffix else 'class="drive" '
        scene.world.append(f'      <joint {sort}name="{called}" axis="{_list(axis)}"/>')
    scene.home += positions
    scene.world += [
        f"      {_inertial(rods.mass.get('rod', 0.0), length / 4, np.array([0, 0, -length / 2]))}",
        f'      <geom type="capsule" size="0.006" fromto="0 0 0 0 0 {-length!r}"/>',
    ]
    if rate:
        scene.world += [
            f'      <body name="tip{tag}"><joint class="drive" name="{name}" type="slide" axis="0 0 -1"/>',
            f"        {_inertial(0.0, 0.02, np.array([0, 0, -length]))}",
            f'        <site name="end{tag}" pos="0 0 {-length!r}"/>',
            "      </body>",
        ]
        scene.home.append(rate * q)
    else:
        scene.world.append(f'      <site name="end{tag}" pos="0 0 {-length!r}"/>')
    scene.world.append("    </body>")
    scene.equalities.append(f'    <connect name="joint{tag}" site1="end{tag}" site2="b{tag}"/>')


def _plate(rods: Rods, scene: _Scene) -> None:
    """The plate with its ball joints, hinged bodies and the tool point."""
    x, R = rods.home.x[0], rods.home.R[0]
    shown = [r for r in range(len(rods.rods)) if not rods.guided[r]]
    size = max(float(np.linalg.norm(rods.plate[shown], axis=1).max()), SMALLEST)
    if len(rods.dofs) == 6:
        scene.world += [
            f'    <body name="plate" pos="{_list(x)}" quat="{_list(rotation.to_quaternion(R))}">',
            '      <freejoint name="plate"/>',
        ]
        scene.home += [*map(float, x), *map(float, rotation.to_quaternion(R))]
    else:
        scene.world.append('    <body name="plate">')
        turn = rotation.log(R[None])[0]
        for dof in rods.dofs:
            kind, axis = ("slide", np.eye(3)[dof]) if dof < 3 else ("hinge", np.eye(3)[dof - 3])
            scene.world.append(f'      <joint name="plate.{dof}" type="{kind}" axis="{_list(axis)}"/>')
            scene.home.append(float(x[dof] if dof < 3 else turn[dof - 3]))
    scene.world += [
        f"      {_inertial(rods.mass.get('plate', 0.0), size, np.zeros(3))}",
        '      <site name="tool" pos="0 0 0"/>',
    ]

    def anchors(body: int, indent: str) -> None:
        for r in shown:
            if rods.body[r] == body:
                middle = rods.hinge_point[body - 1] if body else np.zeros(3)
                scene.world.append(f'{indent}<site name="b{rods.rods[r]}" pos="{_list(rods.plate[r])}"/>')
                if np.linalg.norm(rods.plate[r] - middle) > LEAST:
                    ends = f"{_list(middle)} {_list(rods.plate[r])}"
                    scene.world.append(f'{indent}<geom type="capsule" size="0.006" fromto="{ends}"/>')

    anchors(0, "      ")
    for h, (point, axis) in enumerate(zip(rods.hinge_point, rods.hinge_axis, strict=True)):
        scene.world += [
            f'      <body name="side{h + 1}">',
            f'        <joint name="side{h + 1}" pos="{_list(point)}" axis="{_list(axis)}"/>',
            f"        {_inertial(rods.mass.get('side', 0.0), 0.03, point)}",
        ]
        scene.home.append(float(rods.home.phi[0, h]))
        anchors(h + 1, "        ")
        scene.world.append("      </body>")
    scene.world.append("    </body>")


TARGET = Target(
    "MJCF for MuJoCo: the robot as built, with a home position, actuators and sensors", write,
    "python -m mujoco.viewer --mjcf={folder}/*.xml",
)  # fmt: skip
