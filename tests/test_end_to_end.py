"""The core against MuJoCo: exact data come from it, and what is made of them goes back to it.

Nothing passes but commands, readings and the numbers that perturb the robot.
"""

from dataclasses import replace

import numpy as np
import pytest

from bench import faults
from bench.batch import BatchMachine
from bench.machine import Machine
from pcalib import compensation, effects, modelfile, prediction, rotation
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.fitting import identification
from pcalib.mechanics import kinematics
from pcalib.model import FittedEffect, Frame, Model
from pcalib.prediction import Conditions
from pcalib.workspace import reachable

TOOLS = np.array([[0, 0, 0], [0, 0, -0.1], [0, 0, -0.3], [0.05, -0.08, -0.2]])
LEVEL = np.eye(3)


@pytest.fixture(scope="module")
def machine(delta):
    return BatchMachine(delta)


@pytest.fixture(scope="module")
def fresh(delta):
    """Commands and plate positions that no fit has seen."""
    return reachable(delta, 150, np.random.default_rng(7))


def exact(machine, n=60, tools=TOOLS[:1], rotations=True, seed=0, **options) -> Measurements:
    """What a perfect instrument, said to be good to 0.2 nm, reads of the machine."""
    q = reachable(machine.robot, n, np.random.default_rng(seed)).q
    tool = np.resize(tools, (n, 3))
    landing = machine.land(q, tool)
    assert landing.ok.all()
    return Measurements.create(
        machine.robot, q, landing.tcp, landing.R if rotations else None, tool=tool, sigma_pos=2e-10,
        sigma_rot=np.radians(5e-8), **options,
    )  # fmt: skip


def miss(machine, model, tool, centres, method="exact"):
    """Largest TCP error [m] where the machine is sent to targets by a model."""
    wanted = centres + tool
    commands = compensation.compensate(model, wanted, tool, method=method, limits=False)
    landing = machine.land(commands.q, tool, near=(centres, np.broadcast_to(LEVEL, (len(centres), 3, 3))))
    reached = landing.status != "joint_limit"
    assert reached.mean() > 0.9 and landing.ok[reached].all()
    return np.linalg.norm(landing.tcp - wanted, axis=1)[reached].max()


@pytest.mark.parametrize("tool", TOOLS, ids=str)
def test_true_parameters_and_exact_inverse_land_on_target(machine, delta, perturb, fresh, tool):
    k = perturb(210, 0.5, 0.2)
    machine.become(k)
    assert miss(machine, Model.nominal(delta).with_geometry(k), tool, fresh.pose.x) < 1e-12  # 1e-9 mm


def test_first_order_leaves_the_second_in_mujoco(machine, delta, perturb, fresh):
    off = []
    for size in (0.1, 0.5):
        k = perturb(212, size, 0.4 * size)
        machine.become(k)
        model = Model.nominal(delta).with_geometry(k)
        off.append(miss(machine, model, TOOLS[2], fresh.pose.x, "first-order"))
    assert off[1] / off[0] == pytest.approx(25, rel=0.25)


@pytest.mark.parametrize(
    "options",
    [{}, {"tools": TOOLS[:3], "rotations": False, "n": 90}],
    ids=["full poses", "positions with three tools"],
)
def test_exact_readings_of_mujoco_give_the_robot_back(machine, perturb, fresh, options):
    """Every identifiable combination to a nanometre: readings at new poses, and landings with tools never measured."""
    machine.become(perturb(213, 0.3, 0.1))
    found = identification.fit(exact(machine, **options), machine.robot).model
    for tool in (TOOLS[1], TOOLS[3]) if not options else TOOLS[:3]:
        predicted = kinematics.forward(machine.robot.mechanism, found.k, fresh.q).pose.tcp(tool)
        assert np.linalg.norm(predicted - machine.land(fresh.q, tool).tcp, axis=1).max() < 1e-9
        assert miss(machine, found, tool, fresh.pose.x) < 1e-9


def test_a_tracker_that_nobody_has_registered(machine, perturb, fresh):
    """Readings in a frame of the tracker's own, the target beside the stated point: all is found."""
    machine.become(perturb(214, 0.3, 0.1))
    frame = Frame(rotation.exp(np.array([0.3, -0.5, 2.6])), np.array([2.5, -1.0, 0.8]), np.array([3e-3, -4e-3, 2e-3]))

    def seen(q):
        landing = machine.land(q, frame.offset)
        return landing.tcp @ frame.rotation.T + frame.translation, frame.rotation @ landing.R

    data = exact(machine, 80, frame="tracker")
    position, turn = seen(data.q)
    found = identification.fit(replace(data, position=position, rotation=turn), machine.robot).model
    predicted = identification.residuals(
        found,
        Measurements.create(machine.robot, fresh.q, *seen(fresh.q), sigma_pos=1e-9, sigma_rot=1e-9, frame="tracker"),
    )[0]
    assert np.abs(predicted).max() < 1e-8
    # Of what the frame leaves open, the stated place of the target and the drawing decide: distances are right.
    model, centres = replace(found, frame=None), fresh.pose.x[:40]
    commands = compensation.compensate(model, centres, limits=False)
    tcp = machine.land(commands.q).tcp
    reached = np.isfinite(tcp).all(axis=1)
    apart = np.linalg.norm(tcp[reached][:, None] - tcp[reached], axis=-1)
    wanted = np.linalg.norm(centres[reached][:, None] - centres[reached], axis=-1)
    assert np.abs(apart - wanted).max() < 2e-5


def test_through_files(machine, perturb, fresh, tmp_path):
    """Data file, model file, command: nothing is lost on the way."""
    machine.become(perturb(215, 0.3, 0.1))
    measurement.save(tmp_path / "data.csv", exact(machine))
    data = measurement.load(tmp_path / "data.csv", machine.robot)
    found = identification.fit(data, machine.robot)
    modelfile.save(tmp_path / "m.toml", found.model)
    model = modelfile.load(tmp_path / "m.toml")
    assert miss(machine, model, TOOLS[2], fresh.pose.x) < 1e-9


def test_held_out_rows_tell_the_truth(machine, perturb, fresh):
    """The check figure of a noisy fit is the error that MuJoCo then shows at new poses, and noise."""
    machine.become(perturb(216, 0.3, 0.1))
    rng, sigma = np.random.default_rng(0), 2e-5
    data = exact(machine, 120, check=np.arange(120) >= 60)
    noisy = replace(
        data,
        position=data.position + sigma * rng.standard_normal((120, 3)),
        rotation=rotation.exp(np.radians(0.005) * rng.standard_normal((120, 3))) @ data.rotation,
        sigma=np.tile([sigma] * 3 + [np.radians(0.005)] * 3, (120, 1)),
    )
    found = identification.fit(noisy, machine.robot)
    predicted = kinematics.forward(machine.robot.mechanism, found.model.k, fresh.q).pose.x
    true = np.sqrt(np.mean(np.sum((predicted - machine.land(fresh.q).tcp) ** 2, axis=1)))
    assert found.check is not None
    assert true < 3e-5
    assert found.check.rms_pos == pytest.approx(np.hypot(true, np.sqrt(3) * sigma), rel=0.2)


def test_rods_that_hang_between_the_ends_of_their_play(delta):
    """A gap that the load shuts from either side has no pose, for MuJoCo as for pcalib; the others agree."""
    gap = effects.get("joint_clearance", None, delta)
    model = replace(Model.nominal(delta), effects=(FittedEffect(gap, np.array([1e-4])),))
    q, tool = reachable(delta, 3000, np.random.default_rng(1)).q, np.array([0.06, 0, -0.2])
    p = prediction.predict(model, q, Conditions.of(len(q), tool))
    assert p.situation is not None and p.unsettled is not None
    least = np.argsort(np.abs(p.situation.tension).min(axis=1))[:40]  # elsewhere the side is beyond doubt
    rows = np.union1d(least, np.flatnonzero(p.status != "ok"))
    landing = Machine(delta, faults=(faults.typical(delta, "joint_clearance", 10.0),)).land(q[rows], tool)
    assert (p.status[rows] == landing.status).all() and 3 < np.sum(~landing.ok) < 15
    assert (p.unsettled == (p.status == "not_converged")).all() and p.reached.all()
    assert np.abs(p.position[rows] - landing.tcp)[landing.ok].max() < 1e-11
    back = compensation.compensate(model, p.position, tool, limits=False)
    assert (back.status[p.status == "not_converged"] == "not_converged").all()
    assert np.isnan(back.q[back.status != "ok"]).all()


@pytest.mark.parametrize("seed", range(3))
def test_forward_kinematics_agree(machine, perturb, fresh, seed):
    k = perturb(200 + seed, 0.5, 0.2)
    machine.become(k)
    pose = kinematics.forward(machine.robot.mechanism, k, fresh.q).pose
    landing = machine.land(fresh.q)
    assert landing.ok.all()
    assert np.abs(landing.x - pose.x).max() < 1e-11
    assert np.abs(rotation.log(landing.R @ np.swapaxes(pose.R, -1, -2))).max() < 1e-10


def test_rod_bodies_agree_too(delta, perturb, fresh):
    """The other model of the bench: rods as bodies with joints."""
    k = perturb(211, 0.5, 0.2)
    tool = TOOLS[3]
    commands = compensation.compensate(
        Model.nominal(delta).with_geometry(k), fresh.pose.x[:30] + tool, tool, limits=False
    )
    landing = Machine(delta, k, variant="rods").land(commands.q, tool)
    reached = landing.ok
    assert reached.sum() > 20
    assert np.abs(landing.tcp - fresh.pose.x[:30] - tool)[reached].max() < 1e-12
