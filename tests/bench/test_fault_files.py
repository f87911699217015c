"""Faults as they stand in truth files: what is refused and why, what is sealed, and which robots can have them."""

import mujoco
import numpy as np
import pytest

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.commands import Commands
from bench.instrument import Instrument
from bench.kinds import MODELS
from bench.machine import Machine
from bench.plan import Plan
from pcalib import robot as robots
from pcalib.errors import InputError, ReachError

ROBOT = robots.load(MODELS / "delta.toml")
KINDS = sorted({robots.load(path).kind: path.stem for path in sorted(MODELS.glob("*.toml"))}.keys() - {"delta"})
N = 16
Q = np.random.default_rng(11).uniform(-0.85, 0.3, (N, 3))


def test_a_missing_column_is_named():
    bare = Commands.of(Q)
    with pytest.raises(InputError, match="'thermal_rods' needs a temperature history 'temp_rods'"):
        Machine(ROBOT, None, [faults.typical(ROBOT, "thermal_rods")]).run(bare)
    with pytest.raises(InputError, match="'base_drift' needs a column 'time'"):
        Machine(ROBOT, None, [faults.typical(ROBOT, "base_drift")]).run(bare)
    with pytest.raises(InputError, match="'friction_hysteresis' needs a column 'dir1'"):
        Machine(ROBOT, None, [faults.typical(ROBOT, "friction_hysteresis")]).run(bare)


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        ("drive_compliance", {"compliance_urad_Nm": 1e6}, "must be from 0 to 2000"),
        ("drive_compliance", {"compliance_urad_Nm": -1}, "must be from 0"),
        ("drive_compliance", {"compliance": 1}, "has no unit"),
        ("drive_compliance", {"compliance_um_N": 1}, "is not a unit of rotational_compliance"),
        ("drive_compliance", {"compliance_urad_Nm": [1, 2]}, "a list of 3 numbers"),
        ("backlash", {"gap_arcmin": 1, "side": "left"}, 'one of "direction", "load"'),
        ("hose", {}, "'stiffness' is missing"),
        ("rod_compliance", {"compliance_um_N": 1, "colour": "red"}, "unknown key 'colour'"),
    ],
)
def test_absurd_settings_are_refused(name, table, message):
    with pytest.raises(InputError) as caught:
        faults.make(ROBOT, name, table)
    assert message in str(caught.value) and f"[faults.{name}]" in str(caught.value)


def test_a_robot_that_falls_apart_says_so():
    truth = truths.parse(
        f'robot = "{MODELS / "delta.toml"}"\n[faults.drive_compliance]\ncompliance_mrad_Nm = 2\n'
        "[faults.rod_compliance]\ncompliance_mm_N = 0.1\n"
    )
    heavy = Commands.of(Q, [0.0, 0.02, -0.3], 300.0)
    with pytest.raises(ReachError, match="faults drive_compliance, rod_compliance may be too strong"):
        simulate.run(truth, Plan(heavy, np.full(N, -1), np.zeros(N, bool), "test"))


@pytest.mark.parametrize("name", faults.names())
def test_a_sealed_fault_is_the_same_fault(name):
    truth = truths.Truth(ROBOT, 0 * ROBOT.mechanism.nominal, Instrument(), (faults.typical(ROBOT, name, 0.7),))
    again = truths.parse(truths.dumps(truth)).faults[0]
    for key, value in truth.faults[0].values.items():
        assert np.array_equal(again.values[key], value), key


# -- other kinds of robots ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_faults_of_other_kinds(kind):
    """Drives give way by the change of MuJoCo's potential energy along them; what does not suit a kind says so."""
    robot = robots.load(MODELS / f"{kind}.toml")
    rigid = Machine(robot)
    model, data = rigid.model, rigid.loops.data
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    nq = rigid.rig.actuators
    q = plans.make(robot, "random", 4, seed=1).commands.q

    def energy(q):
        assert rigid.land(q[None]).ok.all()
        mujoco.mj_energyPos(model, data)
        return data.energy[0]

    load = np.array([[(energy(row - e) - energy(row + e)) / 2e-5 for e in 1e-5 * np.eye(nq)] for row in q])
    soft = faults.typical(robot, "drive_compliance")
    landing = Machine(robot, None, [soft]).land(q)
    expected = rigid.land(q + soft.values["compliance"] * load).tcp
    moved = landing.tcp - rigid.land(q).tcp
    assert landing.ok.all() and np.abs(moved).max() > 1e-8
    assert np.abs(landing.tcp - expected).max() < 0.01 * np.sqrt(np.mean(np.sum(moved**2, axis=1)))

    columns = {f"temp_{part}": 30.0 for part in ("arms", "rods", "base")} | {f"dir{i + 1}": 1.0 for i in range(nq)}
    busy = Commands.of(q, [0.03, 0, -0.05], 0.5, time=np.arange(len(q)) * 600.0, **columns)
    suited = 0
    for name in faults.names():
        try:
            machine = Machine(robot, None, [faults.typical(robot, name)])
        except InputError as error:
            assert robot.kind in str(error) and "leave this fault out" in str(error)
            continue
        assert machine.run(busy).ok.all()
        suited += 1
    assert suited >= 16
