"""The hand-written MJCF files describe the robot of models/delta.toml."""

import mujoco
import numpy as np
import pytest

from bench import kinds
from bench.kinds import MODELS
from pcalib import robot as robots
from pcalib import rotation

PAIRS = [f"{i}{j}" for i in (1, 2, 3) for j in (1, 2)]


@pytest.fixture(scope="module")
def robot():
    return robots.load(MODELS / "delta.toml")


@pytest.fixture(scope="module", params=["delta", "delta_tendon"])
def file(request):
    """The file as it stands, compiled, with all joints at zero."""
    model = mujoco.MjModel.from_xml_path(str(MODELS / f"{request.param}.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def nominal(robot, name):
    mechanism = robot.mechanism
    if name in mechanism.parameters:
        return mechanism.nominal[mechanism.index(name)]
    return np.array([mechanism.nominal[mechanism.index(f"{name}.{axis}")] for axis in "xyz"])


def test_motor_axes(robot, file):
    model, data = file
    for i, azimuth in enumerate(robot.dimensions["axis_azimuth"], 1):
        joint = model.joint(f"q{i}")
        assert np.allclose(data.xanchor[joint.id], nominal(robot, f"p{i}"), atol=1e-15)
        assert np.allclose(data.xaxis[joint.id], [np.cos(azimuth), np.sin(azimuth), 0], atol=1e-15)
        assert np.allclose(joint.range, robot.joint_range, atol=1e-15)


def test_points_and_lengths(robot, file):
    model, data = file
    plate = model.body("plate").id
    for pair in PAIRS:
        arm = model.body(f"arm{pair[0]}").id
        R = data.xmat[arm].reshape(3, 3)
        bodies = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"rod{pair}") >= 0
        A = data.xpos[model.body(f"rod{pair}").id] if bodies else data.site_xpos[model.site(f"a{pair}").id]
        assert np.allclose(R.T @ (A - data.xpos[arm]), nominal(robot, f"a{pair}"), atol=1e-10)
        b = data.site_xpos[model.site(f"b{pair}").id] - data.xpos[plate]
        assert np.allclose(data.xmat[plate].reshape(3, 3).T @ b, nominal(robot, f"b{pair}"), atol=1e-15)
        if bodies:
            length = np.linalg.norm(data.site_xpos[model.site(f"end{pair}").id] - A)
        else:
            tendon = model.tendon(f"rod{pair}").id
            equality = np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_TENDON) & (model.eq_obj1id == tendon))[0]
            length = model.tendon_length0[tendon] + model.eq_data[equality, 0]
        assert abs(length - nominal(robot, f"l{pair}")) < 1e-15


def test_masses_and_centres_of_mass(robot, file):
    model, data = file
    tendons = model.ntendon > 0
    for i in (1, 2, 3):
        parts = [b for b in range(model.nbody) if model.body(b).name in (f"arm{i}", f"beam{i}", f"elbow{i}")]
        mass = model.body_mass[parts]
        assert abs(mass.sum() - robot.mass["arm"]) < 1e-9
        arm = model.body(f"arm{i}").id
        com = mass @ data.xipos[parts] / mass.sum() - data.xpos[arm]
        assert np.allclose(data.xmat[arm].reshape(3, 3).T @ com, [0, robot.mass["arm_com"], 0], atol=1e-9)
    for pair in PAIRS if not tendons else []:
        parts = [model.body(f"rod{pair}").id, model.body(f"tip{pair}").id]
        mass = model.body_mass[parts]
        assert abs(mass.sum() - robot.mass["rod"]) < 1e-15
        ends = data.xpos[parts[0]], data.site_xpos[model.site(f"end{pair}").id]
        assert np.allclose(mass @ data.xipos[parts] / mass.sum(), np.mean(ends, axis=0), atol=1e-12)
    assert model.body("plate").mass[0] == robot.mass["plate"]
    assert np.allclose(model.opt.gravity, robot.gravity)
    assert model.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE


def test_home_pose_is_closed(file):
    model, data = file
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_fwdKinematics(model, data)
    mujoco.mj_makeConstraint(model, data)
    assert np.abs(data.efc_pos).max() < 1e-10


@pytest.mark.parametrize("variant", ["rods", "tendons"])
def test_a_spec_for_the_same_robot_changes_nothing(robot, variant):
    file = {"rods": "delta", "tendons": "delta_tendon"}[variant]
    as_written = mujoco.MjModel.from_xml_path(str(MODELS / f"{file}.xml"))
    made = kinds.get("delta").variants[variant].spec(robot).compile()
    for name in ("body_pos", "body_ipos", "body_mass", "site_pos", "jnt_range", "geom_pos", "geom_size"):
        assert np.allclose(getattr(made, name), getattr(as_written, name), atol=1e-10), name
    for name in ("body_quat", "geom_quat"):  # q and −q are one rotation
        turn = rotation.from_quaternion(getattr(made, name)) - rotation.from_quaternion(getattr(as_written, name))
        assert np.abs(turn).max() < 1e-10, name


def test_another_robots_masses_and_range_reach_the_model(robot):
    import re

    text = re.sub(r"arm_com_mm = .*", "arm_com_mm = 120.0", robot.text)
    text = text.replace("rod_kg = 0.10", "rod_kg = 0.25").replace("min_deg = -60.0", "min_deg = -50.0")
    other = robots.parse(text.replace("arm_length_mm = 350.0", "arm_length_mm = 300.0"))
    model = kinds.get("delta").variants["rods"].spec(other).compile()
    parts = [model.body(f"{name}2").id for name in ("arm", "beam", "elbow")]
    offsets = np.cumsum([0.0, model.body_pos[parts[1], 1], model.body_pos[parts[2], 1]])
    mass = model.body_mass[parts]
    assert abs(mass @ (offsets + model.body_ipos[parts, 1]) / mass.sum() - 0.120) < 1e-12
    assert abs(model.body("rod31").mass[0] + model.body("tip31").mass[0] - 0.25) < 1e-12
    assert np.allclose(model.joint("q3").range, other.joint_range)
