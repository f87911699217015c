"""The virtual machines of all kinds against the core: two implementations that share only names and values."""

from functools import lru_cache

import numpy as np
import pytest

from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import robot as robots
from pcalib import rotation
from pcalib.mechanics import kinematics
from pcalib.workspace import reachable

NAMES = sorted(path.stem for path in MODELS.glob("*.toml") if path.stem != "delta")
TOOL = np.array([0.02, -0.01, -0.3])
SIZE = {"m": 1e-3, "rad": 4e-3, "1": 1e-3}


@lru_cache
def load(name):
    return robots.load(MODELS / f"{name}.toml")


@lru_cache
def commands(name, n):
    return reachable(load(name), n, np.random.default_rng(1)).q


def apart(landing, pose):
    """Largest distance [m] and angle [rad] between MuJoCo's poses and the core's."""
    turn = rotation.log(landing.R @ np.swapaxes(pose.R, 1, 2))
    return max(np.abs(landing.tcp - pose.tcp(TOOL)).max(), np.abs(landing.x - pose.x).max(), np.abs(turn).max())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", NAMES)
def test_mujoco_and_the_core_agree(name, seed):
    robot, q = load(name), commands(name, 500)
    mechanism = robot.mechanism
    size = np.array([SIZE[unit] for unit in mechanism.units])
    k = mechanism.nominal + size * np.random.default_rng(seed).standard_normal(len(size))
    landing, core = Machine(robot, k).land(q, TOOL), kinematics.forward(mechanism, k, q)
    assert landing.ok.all() and core.ok.all()
    assert apart(landing, core.pose) <= 1e-10


@pytest.mark.parametrize("name", [name for name in NAMES if not name.startswith("delta")])
def test_every_parameter_counts(name):
    """Each parameter alone, at perturbed geometry, moves the robot as the core says; none is ignored by either."""
    robot, q = load(name), commands(name, 2)
    mechanism = robot.mechanism
    size = np.array([SIZE[unit] for unit in mechanism.units])
    k = mechanism.nominal + size * np.random.default_rng(9).standard_normal(len(size))
    machine = Machine(robot, k)
    rest = machine.land(q, TOOL)
    blind = []
    for i, parameter in enumerate(mechanism.parameters):
        changed = k.copy()
        changed[i] += 2e-3
        machine.geometry.write(changed)
        landing, core = machine.land(q, TOOL), kinematics.forward(mechanism, changed, q)
        assert landing.ok.all() and core.ok.all(), parameter
        assert apart(landing, core.pose) <= 1e-10, parameter
        if np.abs(landing.tcp - rest.tcp).max() < 1e-8:
            blind.append(parameter)
    # What no pose can show: a hinge slid along its axis or turned about it.
    assert set(blind) <= {"hinge1.z", "hinge2.z", "tilt1.z", "tilt2.z"}


def test_a_command_that_two_assemblies_share():
    """Newton from home ends on one where the plate is turned by 140°; all other guards let it pass."""
    robot = load("hexa")
    q = np.radians([[-26.07748095, -12.18619976, -36.69077529, -45.35664775, -55.29380691, -41.80547255]])
    machine = Machine(robot)
    machine.go_home()
    machine.loops.drive(q[0])
    closed = machine.loops.close()
    turned = machine.loops.data.body("plate").xmat.reshape(3, 3)
    assert closed.ok and np.trace(turned) < 0 and not machine.fits(closed)
    landing, core = machine.land(q, TOOL), kinematics.forward(robot.mechanism, robot.mechanism.nominal, q)
    assert landing.ok.all() and np.trace(landing.R[0]) > 2 and apart(landing, core.pose) <= 1e-10


def test_a_hexapod_that_hangs_and_takes_motor_angles():
    text = (MODELS / "hexapod.toml").read_text().replace("home_height_mm = 450.0", "home_height_mm = -450.0")
    text = text.replace("[joints] ", "leg_travel_mm_rev = [70.0, 71.0, 72.0, 73.0, 74.0, 75.0]\n[joints] ")
    text = text.replace("min_mm = -120.0", "min_rev = -1.6").replace("max_mm = 120.0", "max_rev = 1.6")
    text = text.replace("z_min_mm = 400.0", "z_min_mm = -500.0").replace("z_max_mm = 500.0", "z_max_mm = -400.0")
    robot = robots.parse(text)
    q = reachable(robot, 50, np.random.default_rng(0)).q
    k = robot.mechanism.nominal + 1e-3 * np.random.default_rng(1).standard_normal(48)
    landing, core = Machine(robot, k).land(q, TOOL), kinematics.forward(robot.mechanism, k, q)
    assert landing.ok.all() and core.ok.all() and np.ptp(q) > np.pi
    assert apart(landing, core.pose) <= 1e-10


def test_h4_sides_turn_against_the_plate():
    """MuJoCo's own hinge angles: with perfect parallelograms they undo the commanded turn."""
    robot = load("h4")
    machine, q = Machine(robot), commands("h4", 20)
    pose = kinematics.forward(robot.mechanism, robot.mechanism.nominal, q).pose
    adr = [machine.model.joint(f"hinge{h}").qposadr[0] for h in (1, 2)]
    for row in range(len(q)):
        assert machine.land(q[row : row + 1]).ok.all()
        yaw = np.arctan2(pose.R[row, 1, 0], pose.R[row, 0, 0])
        assert np.abs(machine.loops.data.qpos[adr] + yaw).max() < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_masses_of_the_file_reach_the_model(name):
    robot = load(name)
    mass, model = robot.mass, Machine(robot).model
    arms = len(robot.mechanism.actuators)
    total = arms * (mass.get("arm", 0) + mass.get("carriage", 0)) + mass["plate"]
    total += len(set(robot.mechanism.rods) - {"drive"}) * mass["rod"]  # the planar drive is no rod of its own
    assert model.body_mass.sum() == pytest.approx(total, abs=1e-6)
