"""Static equilibrium against time-stepping, and its forces against virtual work."""

import mujoco
import numpy as np
import pytest

from bench import faults
from bench.commands import Commands
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import robot as robots

ROBOT = robots.load(MODELS / "delta.toml")
TOOL = np.array([0.0, 0.0, -0.1])


def fault(name, **table):
    return faults.make(ROBOT, name, table)


SPRINGS = (fault("drive_compliance", compliance_urad_Nm=[200, 150, 250]), fault("rod_compliance", compliance_um_N=3))


def test_equals_time_stepping_to_rest():
    """The same model released from the rigid pose, heavily damped and stepped until it hangs still."""
    machine = Machine(ROBOT, None, SPRINGS)
    q = np.array([[0.1, -0.6, -0.3]])
    rest = machine.run(Commands.of(q, TOOL, 2.0)).tcp[0]
    rigid = Machine(ROBOT).land(q, TOOL).tcp[0]
    model = machine.model
    data = mujoco.MjData(model)
    machine.go_home()
    machine.loops.drive(machine.rig.driven)
    machine.loops.close()
    data.qpos[:] = machine.loops.data.qpos
    model.opt.timestep = 5e-4
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.iterations, model.opt.tolerance = 200, 1e-12
    model.eq_solref[:] = (2.5e-3, 1.0)
    model.eq_solimp[:, :2] = 0.9999
    model.dof_damping[:] = 2.0
    model.dof_armature[:] = 1.0
    for name in machine.rig.equilibrium.springs:
        joint = model.joint(name)
        model.dof_damping[joint.dofadr[0]] = 0.02 * joint.stiffness[0]
    model.dof_armature[machine.loops.driven_dof[:3]] = 1e12  # the motors stand
    mujoco.mj_setConst(model, mujoco.MjData(model))
    tool, stepped = data.body("tool"), []
    for _ in range(10000):
        mujoco.mj_step(model, data)
        stepped.append(tool.xpos + tool.xmat.reshape(3, 3) @ TOOL)
    stepped = np.array(stepped[5000:])
    moved = np.linalg.norm(rest - rigid)
    assert moved > 5e-4
    # Stiff, soft constraints leave a tremor of a micrometre about the place of rest.
    assert np.linalg.norm(stepped.std(axis=0)) < 2e-3 * moved
    assert np.linalg.norm(stepped.mean(axis=0) - rest) < 5e-4 * moved


def test_loops_and_forces_balance_to_rounding():
    machine = Machine(ROBOT, None, SPRINGS)
    q = np.random.default_rng(0).uniform(-0.9, 0.6, (100, 3))
    eq, worst = machine.rig.equilibrium, []
    settle = eq.settle

    def watched(again):
        rest = settle(again)
        free = np.isin(np.arange(machine.model.nv), eq.free)
        worst.append((rest.residual, np.abs(eq.reaction[free]).max()))
        return rest

    eq.settle = watched
    assert machine.run(Commands.of(q, TOOL, 1.0)).ok.all()
    residual, force = np.max(worst, axis=0)
    assert residual <= 1e-12 and force < 1e-8


def test_soft_springs_need_the_exact_tangent_and_get_it():
    """A drive so soft that the arm sags by degrees: the spring alone is no good tangent any more."""
    machine = Machine(ROBOT, None, [fault("drive_compliance", compliance_mrad_Nm=2.0)])
    q = np.array([[-0.2, -0.1, -0.3]])
    landing = machine.run(Commands.of(q, TOOL, 3.0))
    rigid = Machine(ROBOT).land(q, TOOL)
    assert landing.ok.all() and 2e-3 < np.linalg.norm(landing.tcp - rigid.tcp) < 5e-2


@pytest.mark.parametrize("payload", [0.0, 2.5])
def test_load_on_a_rigid_drive_is_the_change_of_potential_energy(payload):
    """dU/dq by central differences of MuJoCo's potential energy along the closed motion, against the reaction."""
    gap = fault("backlash", gap_arcmin=1e-9, side="load")
    machine = Machine(ROBOT, None, [gap])
    model, data = machine.model, machine.rig.data
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    for q in np.random.default_rng(1).uniform(-0.8, 0.5, (5, 3)):

        def energy(q):
            machine.run(Commands.of(q[None], TOOL, payload))
            mujoco.mj_energyPos(model, data)
            return data.energy[0]

        slope = [(energy(q + e) - energy(q - e)) / 2e-5 for e in 1e-5 * np.eye(3)]
        machine.run(Commands.of(q[None], TOOL, payload))
        load = [machine.rig.load(f"q{i}") for i in (1, 2, 3)]
        assert np.allclose(load, -np.array(slope), rtol=1e-6, atol=1e-6)


def test_over_stiff_springs_are_rigid_beside_soft_ones():
    soft = SPRINGS[1]
    stiff = fault("drive_compliance", compliance_urad_Nm=1e-300)
    commands = Commands.of(np.random.default_rng(3).uniform(-0.8, 0.3, (10, 3)), TOOL, 1.0)
    both, alone = (Machine(ROBOT, None, present).run(commands) for present in ((soft, stiff), (soft,)))
    assert both.ok.all() and np.abs(both.tcp - alone.tcp).max() < 1e-11


def test_absurd_springs_say_so():
    machine = Machine(ROBOT, None, [fault("rod_compliance", compliance_mm_N=0.1)])
    machine.model.jnt_stiffness[:] *= 1e-4  # rods of rubber bands: beyond what a file may ask for
    landing = machine.run(Commands.of(np.zeros((1, 3)), TOOL, 5.0))
    assert landing.status[0] in ("not_converged", "wrong_branch") and np.isnan(landing.tcp).all()
