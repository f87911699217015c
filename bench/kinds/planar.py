"""The planar parallelogram in MuJoCo: the driven rod carries the plate on a hinge; rod 2 is a tendon of fixed length.

All hinges stand along z, so that the plane is kept by the bodies and not by constraints. The plate's free joint is
welded to what hangs on the driven rod.
"""

from __future__ import annotations

import mujoco
import numpy as np

from bench import assembly
from bench.geometry import Place
from bench.kinds import Home, Kind, Variant
from pcalib.robot import Robot


def _spec(robot: Robot) -> mujoco.MjSpec:
    size = robot.dimensions
    spec = assembly.skeleton(robot)
    base, plate, mass = spec.body("base"), spec.body("plate"), robot.mass.get("rod", 0.0)
    driven = assembly.body(base, "arm1", (-size["a1x"], 0, 0), mass=mass / 2, com=(0, -size["l1"] / 4, 0))
    assembly.joint(driven, "q1", assembly.Z, range=robot.joint_range)
    assembly.bar(driven, (0, 0, 0), (0, -size["l1"], 0), 0.012 * size["l1"], assembly.ARM)
    carrier = assembly.body(driven, "carrier", (0, -size["l1"], 0), mass=mass / 2, com=(0, size["l1"] / 4, 0))
    assembly.joint(carrier, "carrier", assembly.Z)
    carrier.add_site(name="hold")
    for rod in ("1", "drive"):
        driven.add_site(name=f"a{rod}")
        assembly.anchor(plate, rod, (-size["b1x"], 0, 0))
    base.add_site(name="a2", pos=[size["a2x"], size["a2y"], 0])
    assembly.anchor(plate, "2", (size["b2x"], size["b2y"], 0))
    spec.add_equality(
        name="plate", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_SITE, name1="hold", name2="b1"
    )
    rod = spec.add_tendon(name="rod2", width=0.012 * size["l2"], rgba=assembly.ROD)
    rod.wrap_site("a2")
    rod.wrap_site("b2")
    spec.add_equality(
        name="joint2", type=mujoco.mjtEq.mjEQ_TENDON, objtype=mujoco.mjtObj.mjOBJ_TENDON, name1="rod2"
    )
    return spec


def _places(robot: Robot) -> tuple[Place, ...]:
    return (
        Place("turn", "arm1", "0 0 q0"),
        Place("body", "arm1", "-a1x 0 0"),
        Place("body", "carrier", "0 -l1 0"),
        Place("site", "b1", "-b1x 0 0"),
        Place("site", "bdrive", "-b1x 0 0"),
        Place("site", "a2", "a2x a2y 0"),
        Place("site", "b2", "b2x b2y 0"),
        Place("tendon", "rod2", "l2"),
    )


def _home(robot: Robot) -> Home:
    """The rods upright and the plate level."""
    size = robot.dimensions
    return Home(np.zeros(1), np.array([size["b1x"] - size["a1x"], -size["l1"], 0.0]), np.eye(3))


KIND = Kind(name="planar", variants={"rods": Variant(_spec, _places)}, home=_home, rods_down=False)
