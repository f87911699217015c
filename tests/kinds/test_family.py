"""Every robot kind against central differences, round trips, its gauge freedoms and the ranks that follow from them."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from pcalib import kinds, prediction, rotation
from pcalib import robot as robots
from pcalib.errors import InputError
from pcalib.fitting.identifiability import THRESHOLD, priors, without
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.model import Model
from pcalib.prediction import Conditions
from pcalib.workspace import reachable

MODELS = Path(__file__).parents[2] / "models"
EVERY = {path.stem: robots.load(path) for path in sorted(MODELS.glob("*.toml"))}
NAMES = [name for name, robot in EVERY.items() if robot.mechanism.n_state > 3]
"""Robots that do not keep to a plane; what else is asked of those that do stands in their own tests."""
TOOL = np.array([0.03, -0.02, -0.3])
Z = np.array([0.0, 0.0, 1.0])
SIGMA = np.array([*[2e-5] * 3, *[np.radians(0.005)] * 3])
SIZE = {"m": 1e-3, "rad": 4e-3, "1": 1e-3}


load = EVERY.__getitem__


@lru_cache
def poses(name, n=40):
    return reachable(load(name), n, np.random.default_rng(3))


def perturbed(name, seed=0):
    mechanism = load(name).mechanism
    size = np.array([SIZE[unit] for unit in mechanism.units])
    return mechanism.nominal + size * np.random.default_rng(seed).standard_normal(len(size))


def solved(name, n=8, seed=0):
    """A perturbed robot with closed loops at n poses."""
    mechanism, k, q = load(name).mechanism, perturbed(name, seed), poses(name).q[:n]
    found = kinematics.forward(mechanism, k, q, poses(name).pose.take(slice(n)), tolerance=1e-14)
    assert (found.residual < 1e-14).all()
    return mechanism, k, q, found.pose


def differs(analytic, numeric):
    """Largest error of a Jacobian, relative to its largest entry."""
    return np.abs(analytic - numeric).max() / np.abs(analytic).max()


def central(function, n, h=5e-5):
    """∂function/∂(n unknowns) as the last axis, for steps given as an (n,) vector; central differences of 4th order."""

    def slope(step):
        return (8 * (function(step) - function(-step)) - (function(2 * step) - function(-2 * step))) / (12 * h)

    return np.stack([slope(step) for step in h * np.eye(n)], axis=-1)


@pytest.mark.parametrize("tool", [np.zeros(3), TOOL], ids=["no tool", "tool"])
@pytest.mark.parametrize("name", EVERY)
def test_closure_jacobians_against_differences(name, tool):
    mechanism, k, q, pose = solved(name)
    at = kinematics.closure(mechanism, k, q, pose, tool)

    def f(q=q, pose=pose, k=k):
        return kinematics.closure(mechanism, k, q, pose).f

    def moved(step):
        # A twist at the TCP, by hand: the TCP moves, then the plate turns about it.
        dofs, twist = list(mechanism.plate_dofs), np.zeros(6)
        twist[dofs] = step[: len(dofs)]
        turn = rotation.exp(np.broadcast_to(twist[3:], (len(q), 3)))
        R = turn @ pose.R
        return f(pose=Pose(pose.tcp(tool) + twist[:3] - (R @ tool), R, pose.phi + step[len(dofs) :]))

    J = kinematics.jacobian_state(mechanism, at, pose)
    assert differs(J, central(moved, mechanism.n_state)) < 1e-7
    J = kinematics.jacobian_actuators(mechanism, at)
    assert differs(J, central(lambda step: f(q=q + step), q.shape[1])) < 1e-7
    J = kinematics.jacobian_parameters(mechanism, k, q, at, pose)
    numeric = central(lambda step: f(k=k + step), len(k))
    for unit in set(mechanism.units):
        some = [u == unit for u in mechanism.units]
        assert differs(J[..., some], numeric[..., some]) < 1e-7


@pytest.mark.parametrize("name", EVERY)
def test_sensitivity_at_the_tool_against_forward_kinematics(name):
    mechanism, k, q, pose = solved(name, 4)
    S = kinematics.sensitivity(mechanism, k, q, pose, TOOL)

    def reading(step):
        found = kinematics.forward(mechanism, k + step, q, pose, tolerance=1e-15, max_iterations=6).pose
        turned = rotation.log(found.R @ np.swapaxes(pose.R, -1, -2))
        return np.concatenate([np.hstack([found.tcp(TOOL), turned])[:, mechanism.plate_dofs], found.phi], axis=-1)

    numeric = central(reading, len(k))
    places = sum(dof < 3 for dof in mechanism.plate_dofs)
    assert differs(S[:, :places], numeric[:, :places]) < 1e-7
    assert places == mechanism.n_state or differs(S[:, places:], numeric[:, places:]) < 1e-7


@pytest.mark.parametrize("name", EVERY)
def test_poses_ahead_are_right_to_first_order(name):
    """Where poses go when geometry changes, told by the derivatives at hand: half the change, a quarter of the miss."""
    robot = load(name)
    q = reachable(robot, 8, np.random.default_rng(3)).q
    tool = TOOL if robot.mechanism.n_state > 3 else np.zeros(3)
    model = Model.nominal(robot).with_geometry(perturbed(name))
    p = prediction.predict(model, q, Conditions.of(len(q), tool))
    at, JX = prediction.closure_of(model, p)
    fresh = kinematics.closure(robot.mechanism, model.k, q, p.pose, tool)
    for kept, made in ((at.f, fresh.f), (at.r, fresh.r), (at.n, fresh.n), (at.side.A, fresh.side.A)):
        assert np.abs(kept - made).max() < 1e-14
    motion = prediction.geometry_motion(model, p, at, JX)
    misses = []
    for size in (0.5, 0.25):
        step = size * (perturbed(name, 1) - robot.mechanism.nominal)
        guess = prediction.ahead(model, p, motion @ step)
        there = kinematics.forward(robot.mechanism, model.k + step, q, p.pose).pose
        misses.append(max(np.abs(guess.x - there.x).max(), np.abs(guess.R - there.R).max()))
    assert 3.5 < misses[0] / misses[1] < 4.5


@pytest.mark.parametrize("name", NAMES)
def test_inverse_undoes_forward(name):
    mechanism, k, q, pose = solved(name, 40)
    again = kinematics.inverse(mechanism, k, pose.tcp(TOOL), pose.R, TOOL, tolerance=1e-14, max_iterations=12)
    assert again.ok.all()
    assert np.abs(again.q - q).max() < 1e-12
    assert np.abs(again.pose.x - pose.x).max() < 1e-12
    assert np.abs(again.pose.R - pose.R).max() < 1e-12
    assert len(mechanism.hinges) == 0 or np.abs(again.pose.phi - pose.phi).max() < 1e-12


@pytest.mark.parametrize("name", EVERY)
def test_forward_finds_the_commanded_pose_from_its_own_start(name):
    """Over the whole workspace, at perturbed geometry: never another assembly, silently or not."""
    mechanism, k = load(name).mechanism, perturbed(name, 5)
    wanted = poses(name, 3000).pose
    there = kinematics.inverse(mechanism, k, wanted.x, wanted.R)
    assert there.ok.all()
    found = kinematics.forward(mechanism, k, there.q)
    assert found.ok.all()
    assert np.abs(found.pose.x - there.pose.x).max() < 1e-9
    assert np.abs(found.pose.R - there.pose.R).max() < 1e-9


@pytest.mark.parametrize("name", EVERY)
def test_planned_poses_keep_to_all_limits(name):
    robot = load(name)
    found = poses(name, 3000)
    turn = rotation.to_quaternion(found.pose.R)
    assert robot.workspace.contains(found.pose.x).all()
    assert (found.q >= robot.joint_min - 1e-9).all() and (found.q <= robot.joint_max + 1e-9).all()
    if 5 in robot.mechanism.task:
        yaw = 2 * np.arctan2(turn[:, 3], turn[:, 0])
        assert 0.95 * robot.workspace.yaw < np.abs(yaw).max() <= robot.workspace.yaw + 1e-9
    if 3 in robot.mechanism.task:
        tilt = np.arccos(found.pose.R[:, 2, 2])
        assert 0.95 * robot.workspace.tilt < tilt.max() <= robot.workspace.tilt + 1e-9


@pytest.mark.parametrize("name", EVERY)
def test_no_singular_pose_in_the_workspace(name):
    """One sign of det J_X throughout, and never near zero."""
    mechanism, found = load(name).mechanism, poses(name, 3000)
    at = kinematics.closure(mechanism, mechanism.nominal, found.q, found.pose)
    J = kinematics.jacobian_state(mechanism, at, found.pose)
    places = sum(dof < 3 for dof in mechanism.plate_dofs)
    J[..., places:] /= np.abs(at.r).max() or 1.0
    assert len(np.unique(np.sign(np.linalg.det(J)))) == 1
    assert np.linalg.svd(J, compute_uv=False)[:, -1].min() > 0.02


# Full poses with known frames; base frame and target place unknown; base and target frame unknown; position only with
# known frames; the same with three tools. Docs explain them: docs/robots.md.
RANKS = {
    "delta": (42, 36, 33, 38, 41),
    "hexa": (66, 57, 54, 63, 65),
    "hexa321": (66, 57, 54, 63, 65),
    "h4": (62, 54, 51, 59, 61),
    "linear_delta": (33, 27, 24, 30, 32),
    "hexapod": (48, 39, 36, 45, 47),
}


def readings(name, tool):
    """(N, 6, nk) prior-scaled, whitened S_C, and the columns of base (6) and target frame (6)."""
    mechanism = load(name).mechanism
    found = poses(name)
    S = kinematics.sensitivity(mechanism, mechanism.nominal, found.q, found.pose, tool)[:, :6]
    frames = np.zeros((len(S), 6, 12))
    frames[:, :3, :3] = np.eye(3)
    frames[:, :3, 3:6] = -rotation.hat(found.pose.tcp(tool))
    frames[:, 3:, 3:6] = np.eye(3)
    frames[:, :3, 6:9] = found.pose.R
    frames[:, 3:, 9:] = found.pose.R
    return S * priors(mechanism.units) / SIGMA[:, None], frames / SIGMA[:, None]


def rank(J, frames=None):
    J = J.reshape(-1, J.shape[-1])
    F = None if frames is None else frames.reshape(-1, frames.shape[-1])
    return int(np.sum(np.linalg.svd(without(J, F), compute_uv=False) > THRESHOLD))


def test_every_kind_has_its_ranks_stated(own_tests):
    assert set(RANKS) <= {load(name).kind for name in NAMES} and set(kinds.names()) <= {*RANKS, *own_tests}


@pytest.mark.parametrize("name", RANKS)
def test_ranks(name):
    J, frames = readings(name, np.zeros(3))
    tools = np.concatenate([readings(name, np.array([0, 0, -h]))[0][:, :3] for h in (0.0, 0.1, 0.3)])
    assert (rank(J), rank(J, frames[..., :9]), rank(J, frames), rank(J[:, :3]), rank(tools)) == RANKS[name]


def shifted(by):
    return lambda v: v + by


def turned(R, about=0.0):
    return lambda v: about + R @ (v - about)


def after(R):
    """A rotation vector followed by R."""
    return lambda v: rotation.log(R @ rotation.exp(v))


def before(R):
    """A rotation vector preceded by R."""
    return lambda v: rotation.log(rotation.exp(v) @ R)


def arm_gauges(mechanism, k):
    arms = mechanism.actuation
    E = rotation.exp(k[arms.beta]) @ rotation.about(Z, arms.azimuth)
    for i in (0, 1):
        rods = [r for r, arm in zip(mechanism.rods, arms.actuator, strict=True) if arm == i]
        u, x = E[i, :, 0], np.array([2e-3, 0, 0])
        yield {f"p{i + 1}": shifted(2e-3 * u)} | {f"a{r}": shifted(-x) for r in rods}
        yield {f"beta{i + 1}": after(rotation.exp(0.02 * u))} | {f"a{r}": turned(rotation.exp(-10 * x)) for r in rods}


def tower_gauges(mechanism, k):
    E, by, R = rotation.exp(k[mechanism.actuation.beta])[0], np.array([1e-3, -2e-3, 3e-3]), rotation.exp(0.03 * Z)
    yield {"p1": shifted(by), "a11": shifted(-E.T @ by), "a12": shifted(-E.T @ by)}
    yield {"beta1": before(R), "a11": turned(R.T), "a12": turned(R.T)}


def hinge_gauges(mechanism, k):
    hinge = mechanism.hinges[0].at(k)
    yield {"hinge1": shifted(5e-3 * hinge.axis)}
    yield {"tilt1": before(rotation.exp(0.1 * Z))}
    R, rods = rotation.exp(0.01 * hinge.axis), np.array(mechanism.rods)[mechanism.body == 1]
    yield {f"b{r}": turned(R, hinge.point) for r in rods}


GAUGES = [
    ("delta", arm_gauges),
    ("hexa", arm_gauges),
    ("hexa321", arm_gauges),
    ("h4", arm_gauges),
    ("h4", hinge_gauges),
    ("linear_delta", tower_gauges),
]


@pytest.mark.parametrize(("name", "gauges"), GAUGES)
def test_gauge_freedoms_are_exact(name, gauges):
    """Finite changes of parameters that no measurement of any kind can see."""
    mechanism, k, q = load(name).mechanism, perturbed(name, 2), poses(name).q
    there = kinematics.forward(mechanism, k, q, poses(name).pose, tolerance=1e-14).pose
    for changes in gauges(mechanism, k):
        other = k.copy()
        for symbol, change in changes.items():
            at = [mechanism.index(f"{symbol}.{axis}") for axis in "xyz"]
            other[at] = change(other[at])
            assert np.abs(other - k)[at].max() > 1e-5
        found = kinematics.forward(mechanism, other, q, there, tolerance=1e-14).pose
        assert np.abs(found.x - there.x).max() < 1e-12
        assert np.abs(found.R - there.R).max() < 1e-12


def test_start_of_the_321_hexa_is_exact_where_its_points_coincide():
    mechanism, found = load("hexa321").mechanism, poses("hexa321")
    start = mechanism.start(mechanism.nominal, found.q)
    assert np.abs(start.x - found.pose.x).max() < 1e-11
    assert np.abs(start.R - found.pose.R).max() < 1e-11


def test_h4_with_perfect_parallelograms_keeps_its_plate_level_and_its_sides_unturned():
    found = poses("h4")
    assert np.abs(found.pose.R[:, 2, 2] - 1).max() < 1e-14
    yaw = np.arctan2(found.pose.R[:, 1, 0], found.pose.R[:, 0, 0])
    assert np.abs(found.pose.phi + yaw[:, None]).max() < 1e-10


def test_a_fourfold_symmetric_h4_is_singular():
    """Why the arms of models/h4.toml are not equally spaced."""
    from pcalib.kinds.h4 import build

    dimensions = dict(load("h4").dimensions)
    at = {}
    for name, azimuth in (("file", dimensions["axis_azimuth"]), ("symmetric", np.radians([45, 135, 225, 315]))):
        mechanism = build(dimensions | {"axis_azimuth": azimuth, "base_spacing": dimensions["hinge_distance"]})
        found = kinematics.inverse(mechanism, mechanism.nominal, np.array([[0, 0, -0.42]]))
        J = kinematics.jacobian_state(
            mechanism, kinematics.closure(mechanism, mechanism.nominal, found.q, found.pose), found.pose
        )
        at[name] = np.linalg.cond(J[0])
    assert at["file"] < 1e3 and at["symmetric"] > 1e12


def test_hexapod_commands_in_revolutions_are_those_in_millimetres():
    text = (MODELS / "hexapod.toml").read_text()
    travel = np.array([5.0, 5.1, 4.9, 5.0, 5.05, 4.95])
    listed = ", ".join(map(str, travel))
    turns = robots.parse(
        text.replace("[joints] ", f"leg_travel_mm_rev = [{listed}]\n[joints] ")
        .replace("min_mm = -120.0", "min_rev = -24.0")
        .replace("max_mm = 120.0", "max_rev = 24.0")
    )
    assert turns.mechanism.actuator_dimension == "angle"
    assert turns.joint_max == pytest.approx(48 * np.pi)
    plain, q = load("hexapod").mechanism, poses("hexapod").q
    a = kinematics.forward(plain, plain.nominal, q).pose
    b = kinematics.forward(turns.mechanism, turns.mechanism.nominal, q / (travel * 1e-3 / (2 * np.pi))).pose
    assert np.abs(a.x - b.x).max() < 1e-12
    assert np.abs(a.R - b.R).max() < 1e-12


@pytest.mark.parametrize("name", EVERY)
def test_levels_say_what_they_let_vary_in_words_of_this_robot(name):
    levels = load(name).mechanism.levels
    assert all(level.text.endswith(".") for level in levels.values())
    if not load(name).kind.endswith("delta"):
        assert not any("parallelogram" in level.text for level in levels.values())


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("hexa", "[60.0, 180.0, 300.0]", "[60.0, 180.0]", "'axis_azimuth_deg' must be a list of 3 numbers"),
        ("hexapod", "min_mm", "min_deg", "'deg' is not a unit of length"),
        ("linear_delta", "rod_spacing_mm = 50.0", "", "'rod_spacing' is missing"),
        ("hexapod", "yaw_deg", "yaw_mm", "'mm' is not a unit of angle"),
    ],
)
def test_bad_robot_files_say_what_is_wrong(name, old, new, says):
    text = (MODELS / f"{name}.toml").read_text()
    assert old in text
    with pytest.raises(InputError, match=says):
        robots.parse(text.replace(old, new))
