"""The virtual robot against itself (two models), against pcalib's kinematics, and where it must refuse."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench import kinds
from bench.kinds import MODELS
from bench.machine import Machine, parameter_vector
from pcalib import robot as robots
from pcalib import rotation
from pcalib.errors import InputError, ReachError
from pcalib.mechanics import kinematics

ROBOT = robots.load(MODELS / "delta.toml")
MECHANISM = ROBOT.mechanism
TOOL = np.array([0.02, -0.01, -0.3])


def perturbed(seed, length=0.5e-3, degrees=0.2):
    sigma = np.where(np.array(MECHANISM.units) == "rad", np.radians(degrees), length)
    return MECHANISM.nominal + sigma * np.random.default_rng(seed).standard_normal(len(sigma))


def commands(seed, n):
    return np.random.default_rng(seed).uniform(*ROBOT.joint_range, (n, 3))


@pytest.mark.parametrize("seed", range(5))
def test_both_models_close_and_agree_with_the_core(seed):
    k, q = perturbed(seed), commands(seed, 2000)
    rods, tendons = Machine(ROBOT, k), Machine(ROBOT, k, variant="tendons")
    worst = 0.0
    landings = []
    for machine in (rods, tendons):
        data, close = machine.loops.data, machine.loops.close

        def watched(data=data, close=close):
            nonlocal worst
            closed = close()
            if closed.ok:
                worst = max(worst, np.abs(data.efc_pos).max())
            return closed

        machine.loops.close = watched
        landings.append(machine.land(q, TOOL))
    core = kinematics.forward(MECHANISM, k, q)
    a, b = landings
    assert worst <= 1e-12
    assert a.ok.all() and b.ok.all() and core.ok.all()
    assert np.abs(a.tcp - b.tcp).max() <= 1e-10 and np.abs(rotation.log(a.R @ np.swapaxes(b.R, 1, 2))).max() <= 1e-10
    assert np.abs(a.x - core.pose.x).max() <= 1e-10
    assert np.abs(a.tcp - core.pose.tcp(TOOL)).max() <= 1e-10
    assert np.abs(rotation.log(a.R @ np.swapaxes(core.pose.R, 1, 2))).max() <= 1e-10


@pytest.mark.parametrize("variant", ["rods", "tendons"])
def test_writing_in_place_equals_compiling_anew(variant):
    """Parameter by parameter: the model with one parameter in its MjSpec against the same value written in place."""
    maker = kinds.get("delta").variants[variant]
    k = perturbed(7, 2e-3, 1.0)
    written = Machine(ROBOT, k, variant=variant).model
    spec = maker.spec(ROBOT)
    for i in (1, 2, 3):
        spec.frame(f"axis{i}").quat = spec.frame(f"side{i}").quat = [1, 0, 0, 0]
    value = {name: k[i] for i, name in enumerate(MECHANISM.parameters)}

    def vector(stem):
        return np.array([value[f"{stem}.{axis}"] for axis in "xyz"])

    for i, azimuth in enumerate(ROBOT.dimensions["axis_azimuth"], 1):
        arm = spec.body(f"arm{i}")
        arm.pos = vector(f"p{i}")
        turn = rotation.exp(vector(f"beta{i}")) @ rotation.about(np.array([0, 0, 1.0]), azimuth)
        arm.quat = rotation.to_quaternion(turn)
    for pair in MECHANISM.rods:
        spec.site(f"b{pair}").pos = vector(f"b{pair}")
        if variant == "rods":
            inner = spec.body(f"beam{pair[0]}").pos + spec.body(f"elbow{pair[0]}").pos
            spec.body(f"rod{pair}").pos = vector(f"a{pair}") - inner
            spec.body(f"tip{pair}").pos = [0, 0, -value[f"l{pair}"]]
        else:
            spec.site(f"a{pair}").pos = vector(f"a{pair}")
    for key in spec.keys:
        spec.delete(key)
    compiled = spec.compile()
    data = mujoco.MjData(compiled), mujoco.MjData(written)
    joints = np.random.default_rng(1).standard_normal(compiled.nv)
    for model, d in zip((compiled, written), data, strict=True):
        mujoco.mj_integratePos(model, d.qpos, joints, 1.0)
        mujoco.mj_fwdKinematics(model, d)
    for name in ("xpos", "xmat", "site_xpos", "xaxis", "ten_length"):
        assert np.abs(getattr(data[0], name) - getattr(data[1], name)).max(initial=0.0) < 1e-14, name
    if variant == "tendons":
        held = [written.tendon_length0[written.tendon(f"rod{pair}").id] for pair in MECHANISM.rods]
        assert held == [value[f"l{pair}"] for pair in MECHANISM.rods] and not written.eq_data[:, 0].any()


@pytest.mark.parametrize("variant", ["rods", "tendons"])
def test_every_parameter_counts(variant):
    """Each of the 60 parameters, alone, moves the robot just as the core says; none is ignored."""
    q = np.array([[0.2, -0.5, -0.1]])
    for i, name in enumerate(MECHANISM.parameters):
        k = MECHANISM.nominal.copy()
        k[i] += 1e-3
        landing = Machine(ROBOT, k, variant=variant).land(q, TOOL)
        pose = kinematics.forward(MECHANISM, k, q).pose
        rest = kinematics.forward(MECHANISM, MECHANISM.nominal, q).pose
        assert np.abs(landing.tcp - pose.tcp(TOOL)).max() <= 1e-10, name
        turn = np.abs(rotation.log(pose.R @ np.swapaxes(rest.R, 1, 2))).max()
        assert np.abs(pose.tcp(TOOL) - rest.tcp(TOOL)).max() + turn > 1e-7, name


def test_wrong_branch_is_refused():
    """A plate pushed above the elbows closes just as well, but is not taken."""
    machine = Machine(ROBOT, perturbed(0))
    loops, data = machine.loops, machine.loops.data
    rods = [machine.model.joint(f"rod{r}.x").qposadr[0] for r in MECHANISM.rods]
    plate = machine.model.joint("plate").qposadr[0]
    data.qpos[:] = machine._home
    data.qpos[rods] = np.pi - machine._home[rods] - 2 * data.qpos[loops.driven_qpos[0]]
    data.qpos[plate + 2] += 1.2
    closed = loops.close()
    assert closed.ok and data.xpos[machine._plate, 2] > -0.2
    assert not machine.fits(closed)


def test_a_pose_only_reached_on_another_branch_says_so():
    machine = Machine(ROBOT)
    machine._home_sign *= -1  # as if the robot had been assembled the other way
    assert machine.land(commands(0, 3)).status.tolist() == ["wrong_branch"] * 3


def test_unreachable_and_limits_have_a_status():
    # With these rods the arms can be let down, but not held level: then the elbows are too far apart.
    k = parameter_vector(ROBOT, {f"l{pair}": 0.49 for pair in MECHANISM.rods})
    q = np.array([[-0.5, -0.5, -0.5], [0.0, 0.0, 0.0], [0.9, 0, 0], [np.nan, 0, 0]])
    landing = Machine(ROBOT, k).land(q)
    assert landing.status.tolist() == ["ok", "not_converged", "joint_limit", "not_converged"]
    assert np.isnan(landing.tcp[1:]).all() and np.isfinite(landing.tcp[0]).all()


def test_a_robot_that_cannot_be_assembled():
    with pytest.raises(ReachError, match="cannot be assembled in its home pose"):
        Machine(ROBOT, {f"l{pair}": 0.4 for pair in MECHANISM.rods})


def test_names_and_shapes_are_checked():
    with pytest.raises(InputError, match="did you mean 'l11'"):
        Machine(ROBOT, {"l111": 0.8})
    with pytest.raises(InputError, match="59 parameter values for a robot that has 60"):
        Machine(ROBOT, np.zeros(59))
    with pytest.raises(InputError, match="unknown variant 'ball'"):
        Machine(ROBOT, variant="ball")


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_no_pose_depends_on_the_others(seed, n):
    machine = Machine(ROBOT, perturbed(1))
    q = commands(seed, n)
    together = machine.land(q, TOOL).tcp
    one_by_one = np.concatenate([machine.land(row[None], TOOL).tcp for row in q[::-1]])[::-1]
    assert (together == one_by_one).all()


@pytest.mark.parametrize("file", ["delta_small", "delta_large"])
def test_other_deltas(file):
    other = robots.load(MODELS / f"{file}.toml")
    low, high = other.joint_range
    q = np.random.default_rng(3).uniform(low, high, (200, 3))
    core = kinematics.forward(other.mechanism, other.mechanism.nominal, q)
    landing = Machine(other).land(q)
    assert (landing.ok == core.ok).mean() > 0.99 and landing.ok.mean() > 0.5
    both = landing.ok & core.ok
    assert np.abs(landing.x - core.pose.x)[both].max() <= 1e-10
