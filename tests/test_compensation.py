"""Compensation: the exact inverse lands where it is told, the first order is the paper's, effects included."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import effects, planning, prediction, rotation
from pcalib import robot as robots
from pcalib.compensation import METHODS, compensate
from pcalib.errors import EffectError, InputError
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions

TOOLS = {"none": np.zeros(3), "300 mm": np.array([0, 0, -0.3]), "skew": np.array([0.05, -0.08, -0.2])}


@pytest.fixture(scope="module")
def centres(delta):
    """Nominal plate positions over the workspace."""
    return planning.reachable(delta, 60, np.random.default_rng(4)).pose.x


@pytest.fixture(scope="module")
def model(delta, perturb):
    return Model.nominal(delta).with_geometry(perturb(30, 0.5, 0.2))


def landed(model, commands, conditions):
    """TCP positions that the model predicts for commands."""
    return prediction.predict(model, commands.q, conditions).position


@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_exact_lands_on_target(model, centres, tool):
    targets = centres + tool
    commands = compensate(model, targets, tool, limits=False)
    assert (commands.status == "ok").all()
    pose = kinematics.forward(model.robot.mechanism, model.k, commands.q).pose
    assert np.abs(pose.tcp(tool) - targets).max() < 1e-12


@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_first_order_is_the_papers(model, centres, tool):
    """Eqs (29)–(33) step by step: q = IPR_S(x), δX = S_C·δk at the tool, its translation δx, δq = J_S^m·δx, q − δq."""
    mechanism = model.robot.mechanism
    commands = compensate(model, centres + tool, tool, method="first-order", limits=False)
    n = len(centres)
    pose = Pose(centres, np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 0)))
    q = kinematics.initial_actuators(mechanism, mechanism.nominal, pose)
    S = kinematics.sensitivity(mechanism, mechanism.nominal, q, pose, tool)
    dx = S[:, :3] @ (model.k - mechanism.nominal)
    at = kinematics.closure(mechanism, mechanism.nominal, q, pose, tool)
    J = np.linalg.inv(kinematics.task_jacobian(mechanism, at, pose))
    dq = (J @ dx[..., None])[..., 0]
    assert np.abs(dq).max() > 1e-3
    assert np.abs(commands.q - (q - dq)).max() < 1e-13


@pytest.mark.parametrize("tool", TOOLS.values(), ids=TOOLS)
def test_first_order_leaves_the_second(delta, perturb, centres, tool):
    """What it leaves grows 25-fold when the errors grow fivefold."""
    residual = {}
    for size in (0.02, 0.1, 0.5):
        model = Model.nominal(delta).with_geometry(perturb(31, size, 0.4 * size))
        commands = compensate(model, centres + tool, tool, method="first-order", limits=False)
        off = landed(model, commands, Conditions.of(len(centres), tool)) - centres - tool
        residual[size] = np.sqrt(np.mean(np.sum(off**2, axis=1)))
    assert residual[0.1] / residual[0.02] == pytest.approx(25, rel=0.05)
    assert residual[0.5] / residual[0.1] == pytest.approx(25, rel=0.2)


def test_first_order_of_small_errors_is_exact(delta, perturb, centres):
    model = Model.nominal(delta).with_geometry(perturb(32, 1e-4, 1e-4))
    exact, first = (compensate(model, centres, method=method, limits=False).q for method in METHODS)
    nominal = compensate(Model.nominal(delta), centres, limits=False).q
    assert np.abs(exact - first).max() < 1e-5 * np.abs(exact - nominal).max()


def test_nominal_model_needs_no_correction(delta, centres):
    q = kinematics.inverse(delta.mechanism, delta.mechanism.nominal, centres).q
    for method in METHODS:
        assert np.abs(compensate(Model.nominal(delta), centres, method=method, limits=False).q - q).max() < 1e-12


def test_every_target_has_its_own_tool(model, centres):
    rng = np.random.default_rng(0)
    tools = rng.uniform(-0.3, 0.05, (len(centres), 3))
    for method in METHODS:
        mixed = compensate(model, centres + tools, tools, method=method, limits=False)
        for n in range(0, len(centres), 7):
            one = compensate(model, centres[n] + tools[n], tools[n], method=method, limits=False)
            assert np.abs(one.q[0] - mixed.q[n]).max() < 1e-11


def test_long_lists_go_in_batches(model, centres, monkeypatch):
    whole = [compensate(model, centres, TOOLS["skew"], method=method, limits=False).q for method in METHODS]
    monkeypatch.setattr(kinematics, "CHUNK", 9)
    for method, q in zip(METHODS, whole, strict=True):
        assert np.abs(compensate(model, centres, TOOLS["skew"], method=method, limits=False).q - q).max() < 1e-12


# --- effects ----------------------------------------------------------------------------------------------------------

N = 60
COLUMNS = {
    "temp": np.linspace(15, 35, N), "time": np.linspace(0, 7200, N),
    **{f"dir{i}": np.resize([1.0, -1.0, 1.0, 1.0][i:], N) for i in (1, 2, 3)},
}  # fmt: skip


def conditions(tool):
    return Conditions(np.broadcast_to(tool, (N, 3)), np.linspace(0, 3, N), COLUMNS)


def with_effects(model, *names, share=1.0):
    chosen = [effects.get(name, robot=model.robot) for name in names]
    return replace(
        model, effects=tuple(FittedEffect(e, share * np.array([p.prior for p in e.parameters])) for e in chosen)
    )


EVERY = [[name] for name in effects.names() if name not in ("tracker_scale", "gravity_tilt")]


@pytest.mark.parametrize(
    "names",
    [
        *EVERY,
        ["drive_compliance", "gravity_tilt"],
        ["drive_compliance", "rod_compliance", "tool_bending", "base_drift"],
    ],
    ids="+".join,
)
def test_predict_undoes_compensate(model, centres, names):
    """With every effect, payload, temperature, time and direction: the predicted TCP is the target."""
    tool = TOOLS["skew"]
    loaded = with_effects(model, *names)
    commands = compensate(loaded, centres + tool, conditions=conditions(tool), limits=False)
    assert (commands.status == "ok").all()
    assert np.abs(landed(loaded, commands, conditions(tool)) - centres - tool).max() < 1e-11
    plain = compensate(model, centres + tool, tool, limits=False)
    assert np.abs(plain.q - commands.q).max() > 1e-7  # the effect is there


def test_first_order_takes_effects_along(delta, centres):
    """To first order: the residual of effects ten times smaller is far more than ten times smaller."""
    tool = TOOLS["300 mm"]
    residual = []
    for share in (1.0, 0.1):
        loaded = with_effects(Model.nominal(delta), "drive_compliance", "thermal_rods", "tool_bending", share=share)
        commands = compensate(loaded, centres + tool, conditions=conditions(tool), method="first-order", limits=False)
        plain = compensate(Model.nominal(delta), centres + tool, tool, limits=False)
        off = [np.abs(landed(loaded, c, conditions(tool)) - centres - tool).max() for c in (commands, plain)]
        assert off[0] < 0.05 * off[1]
        residual.append(off[0])
    assert residual[0] > 50 * residual[1]


def test_targets_are_in_the_base_frame_whatever_the_tracker_saw(model, centres):
    from pcalib.model import Frame

    seen = replace(model, frame=Frame(rotation.exp(np.array([0.1, 2.0, 0.3])), np.ones(3), np.full(3, 1e-3)))
    seen = replace(seen, effects=with_effects(model, "tracker_scale").effects)
    for method in METHODS:
        a, b = (compensate(m, centres, method=method, limits=False).q for m in (model, seen))
        assert np.abs(a - b).max() < 1e-13


def test_an_effect_without_its_column_is_said(model, centres):
    with pytest.raises(EffectError, match="column 'temp_rods' is needed and not in the data"):
        compensate(with_effects(model, "thermal_rods"), centres)


# --- statuses ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_statuses(model, centres, method):
    """Each bad target for itself: outside the cylinder, past a joint limit, unreachable, not a number."""
    tool = np.array([0, 0, -0.3])
    low = model.robot.workspace.z_min
    odd = np.array([[0.5, 0, -0.8], [0, 0, -1.9], [np.nan, 0, -0.8], [0, 0, -0.5], [0.39, 0.05, low + 0.001]])
    targets = np.vstack([centres[:5], odd, centres[5:10]]) + tool
    commands = compensate(model, targets, tool, method=method)
    assert commands.status[5:10].tolist() == ["outside_workspace"] * 4 + ["outside_joint_range"]
    good = np.r_[0:5, 10:15]
    assert (commands.status[good] == "ok").all()
    assert np.isnan(commands.q[5:10]).all() and np.isfinite(commands.q[good]).all()
    alone = compensate(model, targets[good], tool, method=method)
    assert np.abs(alone.q - commands.q[good]).max() < 1e-11
    free = compensate(model, targets, tool, method=method, limits=False)
    assert free.status[5] == "ok" and free.status[9] == "ok"
    assert free.status[6] == "unreachable" and free.status[7] == "unreachable"
    assert np.isnan(free.q[6:8]).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_target_mirrored_above_the_robot_is_unreachable(model, centres, method):
    """Arms can meet it only upwards, which is another branch."""
    targets = np.vstack([[[0, 0, 0.8]], centres[:1] * [1, 1, -1], centres[:1]])
    commands = compensate(model, targets, method=method, limits=False)
    assert commands.status.tolist() == ["unreachable", "unreachable", "ok"]
    assert np.isnan(commands.q[:2]).all()


def test_statuses_with_effects(model, centres):
    loaded = with_effects(model, "drive_compliance", "base_drift")
    targets = np.vstack([centres[:3], [[0, 0, -3.0]], [[np.nan, 0, -0.8]], centres[3:6]])
    under = Conditions(np.zeros((8, 3)), np.ones(8), {"time": np.zeros(8)})
    commands = compensate(loaded, targets, conditions=under, limits=False)
    assert (commands.status == ["ok"] * 3 + ["unreachable"] * 2 + ["ok"] * 3).all()
    good = commands.status == "ok"
    there = prediction.predict(loaded, commands.q[good], under.take(good)).position
    assert np.abs(there - targets[good]).max() < 1e-11


def test_unknown_method(model, centres):
    with pytest.raises(InputError, match=r"unknown method 'exakt' .did you mean 'exact'"):
        compensate(model, centres, method="exakt")


@pytest.mark.parametrize("method", METHODS)
def test_orientations_beyond_the_workspace_are_refused(method):
    """Tilt and yaw of the workspace bound what is commanded, like its cylinder does."""
    h4 = robots.load(Path(__file__).parents[1] / "models" / "h4.toml")
    middle = np.array([[0.0, 0.0, 0.5 * (h4.workspace.z_min + h4.workspace.z_max)]] * 3)
    yaw = np.array([0.9, 1.1, -1.3]) * h4.workspace.yaw
    turned = rotation.about(np.array([0.0, 0.0, 1.0]), yaw)
    status = compensate(Model.nominal(h4), middle, rotation_matrix=turned, method=method).status
    assert status[0] == "ok" and (status[1:] == "outside_workspace").all()
