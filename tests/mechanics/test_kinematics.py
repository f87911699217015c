"""Kinematics of the Delta against closed forms, differences and symmetry, and the statuses of poses that cannot be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcalib import effects, planning, prediction, rotation
from pcalib import kinds as robot_kinds
from pcalib.mechanics import kinematics
from pcalib.mechanics.kinematics import Deviation
from pcalib.mechanics.mechanism import Pose
from pcalib.model import FittedEffect, Frame, Model
from pcalib.prediction import Conditions

TOOLS = {"none": np.zeros(3), "300 mm": np.array([0, 0, -0.3]), "skew": np.array([0.05, -0.08, -0.2])}


@pytest.fixture(scope="module")
def q(delta):
    return planning.reachable(delta, 12, np.random.default_rng(5)).q


def central(function, n, h):
    """∂function/∂(n unknowns) as the last axis, central differences of 4th order."""
    steps = h * np.eye(n)
    return np.stack(
        [(8 * (function(s) - function(-s)) - (function(2 * s) - function(-2 * s))) / (12 * h) for s in steps], axis=-1
    )


def relative(analytic, numeric):
    assert analytic.shape == numeric.shape
    assert np.abs(numeric).max() > 1e-3
    return np.abs(analytic - numeric).max() / np.abs(numeric).max()


# --- derivatives ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_task_jacobian(delta, perturb, q, tool):
    """dx/dq at the TCP of a perturbed robot, and the paper's J_S^m (eq. 32), its inverse at nominal."""
    mechanism = delta.mechanism
    for k in (perturb(2, 0.5, 0.2), mechanism.nominal):
        pose = kinematics.forward(mechanism, k, q).pose
        J = kinematics.task_jacobian(mechanism, kinematics.closure(mechanism, k, q, pose, tool), pose)

        def tcp(step, k=k):
            found = kinematics.forward(mechanism, k, q + step, tolerance=1e-15, max_iterations=8)
            return found.pose.tcp(tool)

        assert relative(J, central(tcp, 3, 1e-4)) < 1e-7
    x = pose.tcp(tool)
    inverse = central(lambda s: literal_inverse(delta, x + s - tool), 3, 1e-5)
    assert relative(np.linalg.inv(J), inverse) < 1e-7


FRAME = Frame(rotation.exp(np.array([0.4, -0.8, 2.0])), np.array([1.5, -2.0, 0.7]), np.array([4e-3, -2e-3, 1e-3]))


def reading_of(model, q, conditions, reference):
    """Readings as (N, 6): position and rotation vector from `reference`."""
    p = prediction.predict(model, q, conditions)
    return np.hstack([p.position, rotation.log(p.rotation @ np.swapaxes(reference, -1, -2))])


TURNED = replace(FRAME, turn=rotation.exp(np.array([0.2, -0.4, 1.5])))


@pytest.mark.parametrize("frame", [None, FRAME, TURNED], ids=["base", "tracker", "turned target"])
@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_prediction_columns_of_geometry_and_frame(delta, perturb, q, tool, frame):
    model = replace(Model.nominal(delta), k=perturb(3, 0.5, 0.2), frame=frame)
    conditions = Conditions.of(len(q), tool)
    p = prediction.predict(model, q, conditions)
    at, JX = prediction.closure_of(model, p)
    for level in ("model24", "complete"):
        basis = delta.mechanism.levels[level].basis
        columns = prediction.geometry_columns(model, p, at, JX, basis)
        numeric = central(
            lambda z, basis=basis: reading_of(replace(model, k=model.k + basis @ z), q, conditions, p.rotation),
            basis.shape[1], 5e-5,
        )  # fmt: skip
        assert relative(columns[:, :3], numeric[:, :3]) < 1e-7
        assert relative(columns[:, 3:], numeric[:, 3:]) < 1e-7
    if frame is None:
        return

    def displaced(s):
        body = None if frame.turn is None else rotation.exp(s[9:]) @ frame.turn
        there = Frame(rotation.exp(s[3:6]) @ frame.rotation, frame.translation + s[:3], frame.offset + s[6:9], body)
        return reading_of(replace(model, frame=there), q, conditions, p.rotation)

    numeric = central(displaced, 9 if frame.turn is None else 12, 1e-4)
    assert relative(prediction.frame_columns(model, p), numeric) < 1e-7


COLUMNS = {"temp": np.linspace(18, 31, 12), "time": np.linspace(0, 3600, 12), "dir1": np.tile([1.0, -1.0], 6)}
COLUMNS |= {"dir2": np.tile([-1.0, -1.0, 1.0], 4), "dir3": np.ones(12)}


@pytest.mark.parametrize("frame", [None, FRAME], ids=["base", "tracker"])
@pytest.mark.parametrize("name", effects.names())
def test_prediction_columns_of_effects(delta, perturb, q, name, frame, monkeypatch):
    """Columns by the parameters of each effect and of a compliance and a tilt beside it, which goes by both; the loads
    held as the effects see them (their change is of second order)."""
    beside = [other for other in ("drive_compliance", "base_drift", "gravity_tilt") if other != name]
    chosen = [effects.get(each, robot=delta) for each in (name, *beside)]
    sizes = [np.array([p.prior for p in effect.parameters]) for effect in chosen]
    ends, usual = np.cumsum([len(size) for size in sizes])[:-1], np.concatenate(sizes)
    fitted = tuple(FittedEffect(effect, 0.5 * size) for effect, size in zip(chosen, sizes, strict=True))
    model = replace(Model.nominal(delta), k=perturb(4, 0.5, 0.2), effects=fitted, frame=frame)
    conditions = Conditions(np.tile([0.05, -0.02, -0.2], (12, 1)), np.linspace(0, 2, 12), COLUMNS)
    p = prediction.predict(model, q, conditions)
    at, JX = prediction.closure_of(model, p)
    assert p.situation is not None
    columns = prediction.effect_columns(model, p, at, JX, prediction.unit_contributions(model, p.situation)) * usual
    seen = p.situation

    def held(model, *_):
        return replace(seen, partners=tuple((f.effect, f.theta) for f in model.effects))

    monkeypatch.setattr(Model, "situation", held)

    def reading(z):
        steps = np.split(usual * z, ends)
        changed = tuple(replace(f, theta=f.theta + step) for f, step in zip(fitted, steps, strict=True))
        return reading_of(replace(model, effects=changed), q, conditions, p.rotation)

    numeric = central(reading, len(usual), 0.1)  # larger ones turn signs of rod forces
    size = np.abs(numeric).max(axis=(0, 1))
    assert size[: len(sizes[0])].max() > 1e-7
    off = np.abs(columns - numeric).max(axis=(0, 1))
    assert (off < 1e-6 * size + 1e-11).all()  # 1e-11 m or rad is what the step leaves of forward kinematics' rounding


def test_columns_of_deviations(delta, perturb, q):
    """Every channel inside the loops: actuator, rods, elbows, plate."""
    mechanism, k = delta.mechanism, perturb(5, 0.5, 0.2)
    rng = np.random.default_rng(0)
    n = len(q)
    parts = {
        "actuator": rng.standard_normal((n, 3)),
        "rod": rng.standard_normal((n, 6)),
        "elbow": rng.standard_normal((n, 6, 3)),
        "plate": rng.standard_normal((n, 6, 3)),
    }
    base = Deviation(**{c: 1e-4 * v for c, v in parts.items()})
    pose = kinematics.forward(mechanism, k, q, deviation=base).pose
    at = kinematics.closure(mechanism, k, q, pose, deviation=base)
    JX = kinematics.jacobian_state(mechanism, at, pose)
    for channel, values in parts.items():
        df = prediction.closure_change(mechanism, at, pose, effects.Contribution(**{channel: values}))
        twist = -np.linalg.solve(JX, df[..., None])[..., 0]

        def reading(s, channel=channel, values=values):
            moved = replace(base, **{channel: getattr(base, channel) + s * values})
            there = kinematics.forward(mechanism, k, q, pose, moved, tolerance=1e-15, max_iterations=5).pose
            return np.hstack([there.x, rotation.log(there.R @ np.swapaxes(pose.R, -1, -2))])

        assert relative(twist, central(lambda s, f=reading: f(s[0]), 1, 2e-5)[..., 0]) < 1e-7


# --- closed forms and round trips -----------------------------------------------------------------------------------


def literal_inverse(robot, x):
    """The textbook inverse of the nominal Delta, arm by arm in the plane of its arm, (N, 3) [rad]."""
    d = robot.dimensions
    q = []
    for theta in d["axis_azimuth"]:
        u = np.array([np.cos(theta), np.sin(theta), 0])
        v = np.array([-np.sin(theta), np.cos(theta), 0])
        along, across, z = x @ v, x @ u, x[..., 2]
        y = along + d["plate_radius"] - d["base_radius"]  # wrist seen from the motor axis, outwards
        reach2 = y**2 + z**2
        cosine = (d["arm_length"] ** 2 + reach2 - (d["rod_length"] ** 2 - across**2)) / (
            2 * d["arm_length"] * np.sqrt(reach2)
        )
        q.append(np.arctan2(z, y) + np.arccos(cosine))
    return np.stack(q, axis=-1)


def test_closed_forms_of_the_nominal_delta(delta):
    mechanism = delta.mechanism
    found = planning.reachable(delta, 500, np.random.default_rng(6))
    pose = mechanism.start(mechanism.nominal, found.q)
    newton = kinematics.forward(mechanism, mechanism.nominal, found.q, replace_start(pose))
    assert newton.ok.all() and newton.iterations > 0
    assert np.abs(pose.x - newton.pose.x).max() < 1e-12  # FPR_S
    assert np.abs(newton.pose.R - np.eye(3)).max() < 1e-12
    assert np.abs(literal_inverse(delta, pose.x) - found.q).max() < 1e-12  # IPR_S
    again = kinematics.initial_actuators(mechanism, mechanism.nominal, pose)
    assert np.abs(again - found.q).max() < 1e-12


def replace_start(pose):
    """A start 5 mm and 2° off, so that Newton has something to do."""
    turn = rotation.exp(np.array([0.03, -0.01, 0.02]))
    return Pose(pose.x + np.array([3e-3, 2e-3, -4e-3]), turn @ pose.R, pose.phi)


def test_turning_the_robot_by_120_degrees_renames_its_arms(delta, perturb, q):
    """Symmetry knows nothing of the formulas: arm i with the errors of arm i−1 moves as the first robot, turned."""
    mechanism, k = delta.mechanism, perturb(7, 1.0, 0.3)
    turn = rotation.exp(np.array([0, 0, 2 * np.pi / 3]))
    other = k.copy()
    for i in range(3):
        to = (i + 1) % 3
        for block in ("p", "beta"):
            into, out = ([mechanism.index(f"{block}{j + 1}.{c}") for c in "xyz"] for j in (to, i))
            other[into] = turn @ k[out]
        for j in (1, 2):
            a_into, a_out = ([mechanism.index(f"a{m + 1}{j}.{c}") for c in "xyz"] for m in (to, i))
            b_into, b_out = ([mechanism.index(f"b{m + 1}{j}.{c}") for c in "xyz"] for m in (to, i))
            other[a_into], other[b_into] = k[a_out], turn @ k[b_out]
            other[mechanism.index(f"l{to + 1}{j}")] = k[mechanism.index(f"l{i + 1}{j}")]
    first = kinematics.forward(mechanism, k, q).pose
    second = kinematics.forward(mechanism, other, np.roll(q, 1, axis=1)).pose
    assert np.abs(second.x - first.x @ turn.T).max() < 1e-12
    assert np.abs(second.R - turn @ first.R @ turn.T).max() < 1e-12


def test_rod_lengths_at_the_pose_found(delta, perturb, q):
    """The closure in the words of docs/robots.md, with nothing of the solver in it."""
    mechanism, k = delta.mechanism, perturb(8, 1.0, 0.3)
    value = dict(zip(mechanism.parameters, k, strict=True))
    pose = kinematics.forward(mechanism, k, q).pose

    def vector(name):
        return np.array([value[f"{name}.{c}"] for c in "xyz"])

    for i, azimuth in enumerate(delta.dimensions["axis_azimuth"], 1):
        for j in (1, 2):
            turn = rotation.exp(np.array([0, 0, azimuth])) @ rotation.about(np.array([1.0, 0, 0]), q[:, i - 1])
            A = vector(f"p{i}") + (rotation.exp(vector(f"beta{i}")) @ turn) @ vector(f"a{i}{j}")
            B = pose.x + pose.R @ vector(f"b{i}{j}")
            np.testing.assert_allclose(np.linalg.norm(A - B, axis=1), value[f"l{i}{j}"], atol=1e-12)


# --- batches and statuses -------------------------------------------------------------------------------------------


def test_a_batch_is_its_rows_one_by_one(delta, perturb, monkeypatch):
    mechanism, k = delta.mechanism, perturb(9)
    q = planning.reachable(delta, 30, np.random.default_rng(1)).q
    tools = np.random.default_rng(2).uniform(-0.3, 0.1, (30, 3))
    whole = kinematics.forward(mechanism, k, q)
    back = kinematics.inverse(mechanism, k, whole.pose.tcp(tools), tool=tools)
    monkeypatch.setattr(kinematics, "CHUNK", 7)
    parts = kinematics.forward(mechanism, k, q)
    for n in range(30):
        one = kinematics.forward(mechanism, k, q[n])
        for found, row in ((whole, n), (parts, n)):
            # Newton stops at 1e-12 m of closure error; a batch may go one step further for another of its poses.
            assert np.abs(found.pose.x[row] - one.pose.x[0]).max() < 1e-11
            assert np.abs(found.pose.R[row] - one.pose.R[0]).max() < 1e-11
        alone = kinematics.inverse(mechanism, k, whole.pose.tcp(tools)[n], tool=tools[n])
        assert np.abs(back.q[n] - alone.q[0]).max() < 1e-11


def test_unreachable_poses_have_a_status_and_spoil_no_other(delta, perturb, q):
    mechanism, k = delta.mechanism, perturb(10)
    good = kinematics.forward(mechanism, k, q)
    wild = np.vstack([q, np.radians([[90.0, -100, 0], [0, 0, np.nan]])])
    found = kinematics.forward(mechanism, k, wild)
    assert found.ok[: len(q)].all() and not found.ok[len(q) :].any()
    assert np.abs(found.pose.x[: len(q)] - good.pose.x).max() < 1e-11
    targets = np.vstack([good.pose.x, [[3.0, 0, -0.8]], [[0, 0, -5.0]], [[np.nan, 0, -0.8]]])
    back = kinematics.inverse(mechanism, k, targets)
    assert back.ok[: len(q)].all() and not back.ok[len(q) :].any()
    assert np.abs(back.q[: len(q)] - q).max() < 1e-11


def test_the_other_assembly_is_told_apart(delta, perturb, q):
    """From a start above the base, Newton finds the plate on top of its arms: closed, and not the robot meant."""
    mechanism, k = delta.mechanism, perturb(11)
    start = kinematics.forward(mechanism, k, q).pose
    above = Pose(start.x * [1, 1, -1], start.R, start.phi)
    found = kinematics.forward(mechanism, k, q, above)
    closed = found.residual < 1e-9
    assert closed.sum() >= len(q) // 2
    assert (found.status[closed] == "wrong_branch").all()


def hanging(delta):
    """A Delta whose rods are all parallel at q = −90°: base and plate of one size, so that J_X loses rank there."""
    dimensions = dict(delta.dimensions) | {"base_radius": 0.1, "plate_radius": 0.1}
    return robot_kinds.get("delta").build(dimensions)


def test_singular_poses_raise_nothing_and_stay_alone(delta):
    mechanism = hanging(delta)
    k = mechanism.nominal
    q = np.radians([[-20.0, -30, -25], [-90, -90, -90], [10, 0, 5]])
    x = np.array([[0, 0, 0], [0, 0, -1.15], [0, 0, 0]])
    regular = kinematics.forward(mechanism, k, q[[0, 2]])
    x[[0, 2]] = regular.pose.x
    pose = Pose(x, np.broadcast_to(np.eye(3), (3, 3, 3)), np.zeros((3, 0)))
    at = kinematics.closure(mechanism, k, q, pose)
    assert np.abs(at.f).max() < 1e-12
    assert np.linalg.matrix_rank(kinematics.jacobian_state(mechanism, at, pose)[1]) < 6

    found = kinematics.forward(mechanism, k, q)  # closed form and Newton
    assert found.ok[[0, 2]].all() and np.abs(found.pose.x[[0, 2]] - regular.pose.x).max() < 1e-12
    S = kinematics.sensitivity(mechanism, k, q, pose)
    J = kinematics.task_jacobian(mechanism, at, pose)
    for values in (S, J):
        assert np.isfinite(values[[0, 2]]).all() and not np.isfinite(values[1]).any()
    nudged = Pose(x + 1e-3, pose.R, pose.phi)
    again = kinematics.forward(mechanism, k, q, nudged)
    assert again.ok[[0, 2]].all()
    S_regular = kinematics.sensitivity(mechanism, k, q[[0, 2]], pose.take(np.array([0, 2])))
    assert np.abs(S[[0, 2]] - S_regular).max() < 1e-9


@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_jacobians_of_the_closure(delta, perturb, q, tool):
    mechanism, k = delta.mechanism, perturb(0, 0.5, 0.2)
    pose = kinematics.forward(mechanism, k, q).pose
    at = kinematics.closure(mechanism, k, q, pose, tool)

    def turned(step):
        # The definition of a twist at the TCP, written out: the TCP goes by v, and the plate turns by ω about it.
        R = rotation.exp(step[3:]) @ pose.R
        return kinematics.closure(mechanism, k, q, Pose(pose.tcp(tool) + step[:3] - R @ tool, R, pose.phi)).f

    assert relative(kinematics.jacobian_state(mechanism, at, pose), central(turned, 6, 1e-4)) < 1e-7
    Jq = kinematics.jacobian_actuators(mechanism, at)
    assert relative(Jq, central(lambda s: kinematics.closure(mechanism, k, q + s, pose).f, 3, 1e-4)) < 1e-7
    Jk = kinematics.jacobian_parameters(mechanism, k, q, at, pose)
    assert relative(Jk, central(lambda s: kinematics.closure(mechanism, k + s, q, pose).f, 60, 1e-4)) < 1e-7


@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_sensitivity_of_the_tcp(delta, perturb, q, tool):
    mechanism, k = delta.mechanism, perturb(1, 0.5, 0.2)
    pose = kinematics.forward(mechanism, k, q).pose

    def reading(step):
        there = kinematics.forward(mechanism, k + step, q, pose, tolerance=1e-15, max_iterations=5).pose
        return np.hstack([there.tcp(tool), rotation.log(there.R @ np.swapaxes(pose.R, -1, -2))])

    S, numeric = kinematics.sensitivity(mechanism, k, q, pose, tool), central(reading, 60, 2e-5)
    assert relative(S[:, :3], numeric[:, :3]) < 1e-7
    assert relative(S[:, 3:], numeric[:, 3:]) < 1e-7


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.1, 0.5, 2.0]),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.4, 0.1)),
)
def test_inverse_undoes_forward(delta, seed, size, tool):
    mechanism = delta.mechanism
    rng = np.random.default_rng(seed)
    k = mechanism.nominal + size * 1e-3 * rng.standard_normal(60)
    q = planning.reachable(delta, 6, rng).q
    there = kinematics.forward(mechanism, k, q, tolerance=1e-14, max_iterations=12)
    back = kinematics.inverse(mechanism, k, there.pose.tcp(np.array(tool)), tool=np.array(tool))
    assert there.ok.all() and back.ok.all()
    for R in (there.pose.R, back.pose.R):
        assert np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < 1e-12
    assert np.abs(back.q - q).max() < 1e-11
    assert np.abs(back.pose.x - there.pose.x).max() < 1e-11
    assert np.abs(back.pose.R - there.pose.R).max() < 1e-11
