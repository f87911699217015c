"""The planar parallelogram in MuJoCo: a driven rod that carries the plate, and a second rod that guides it.

The plane is x, y. Rod 1 is a body on the motor's hinge; the plate's own hinge at its end is a further body there, which
a weld makes one with the plate. Rod 2 stands on two hinges like the rods of other kinds and is connected to the plate.
"""

from __future__ import annotations

import mujoco
import numpy as np

from bench import assembly
from bench.geometry import Place
from bench.kinds import Home, Kind, Variant
from pcalib.robot import Robot

TURN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Rods run along their −z, which is −y of the base, and turn about their x, which is z of the base."""


def _spec(robot: Robot) -> mujoco.MjSpec:
    size, mass = robot.dimensions, robot.mass.get("rod", 0.0)
    spec = assembly.skeleton(robot)
    base, plate = spec.body("base"), spec.body("plate")
    feet = [-size["a1x"], 0.0, 0.0], [size["a2x"], size["a2y"], 0.0]
    assembly.bar(base, *feet, 0.02, assembly.FRAME)

    length = size["l1"]
    rod = assembly.body(base, "rod1", feet[0], mass=mass / 2, com=(0, 0, -length / 4), size=length / 4, turn=TURN)
    assembly.joint(rod, "q1", (1, 0, 0), range=robot.joint_range)
    assembly.bar(rod, (0, 0, 0), (0, 0, -length), 0.015, assembly.ARM)
    tip = assembly.body(rod, "tip1", (0, 0, -length), mass=mass / 2, com=(0, 0, length / 4), size=length / 4)
    carrier = assembly.body(tip, "carrier", turn=TURN.T)  # the axes of the plate
    assembly.joint(carrier, "plate.turn", assembly.Z)
    carrier.add_site(name="end1")
    assembly.anchor(plate, "1", [-size["b1x"], 0.0, 0.0])
    spec.add_equality(
        name="joint1", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_SITE, name1="end1", name2="b1"
    )

    assembly.anchor(plate, "2", [size["b2x"], size["b2y"], 0.0])
    assembly.rod(spec, robot, base, "2", feet[1], size["l2"], turn=TURN)
    return spec


def _places(robot: Robot) -> tuple[Place, ...]:
    return (
        Place("turn", "rod1", "0 0 q0", nominal=TURN),
        Place("body", "rod1", "-a1x 0 0"),
        Place("body", "rod2", "a2x a2y 0"),
        Place("site", "b1", "-b1x 0 0"),
        Place("site", "b2", "b2x b2y 0"),
        Place("rod", "tip1", "l1"),
        Place("rod", "tip2", "l2"),
    )


def _home(robot: Robot) -> Home:
    """Return the home pose: the driven rod plumb and the plate level."""
    size = robot.dimensions
    return Home(np.zeros(1), np.array([size["b1x"] - size["a1x"], -size["l1"], 0.0]), np.eye(3))


KIND = Kind(name="planar", variants={"rods": Variant(_spec, _places)}, home=_home, rods_down=False)
