"""The same identification by MuJoCo's own toolbox, `mujoco.sysid`, as a general tool does it.

The toolbox knows no closed loops, no priors and no analytic derivatives. It is given the same unknowns in units of
their priors, the same priors as further residuals, and one of two residuals:

* the closure at the measured poses, by the same function that serves pcalib, evaluated for all its columns;
* the readings of a simulation whose loops have settled, which is how the toolbox is meant to be used. All choices
  favour it: rods as tendons (the fastest model), no gravity (no sag), starts at the nominal poses, as few steps as
  bring the reading to within a micrometre, stiff servos, models kept between calls.
"""

from __future__ import annotations

import copy
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO

import mujoco
import numpy as np

from bench import kinds
from bench.geometry import Geometry
from bench.machine import Machine
from pcalib import rotation
from pcalib.data.measurement import Measurements
from pcalib.fitting.identifiability import priors
from pcalib.mechanics import kinematics
from pcalib.mechanics.mechanism import Pose
from pcalib.robot import Robot

RANGE = 50.0
"""Bounds of every unknown, in units of its prior; the toolbox requires bounds, and these are never reached."""
STEP, STIFFNESS, SERVO = 1e-3, 4e-3, 1e6
"""[s] time step; [s] time constant of the loops; [N·m/rad] of the motors' position servos."""
STEPS = 60
"""After which readings are within a micrometre of rest."""


@dataclass(frozen=True)
class ToolboxFit:
    """What the toolbox found."""

    k: np.ndarray
    """(nk,) geometric parameters."""
    evaluations: int
    """The number of geometries at which the toolbox evaluated the residual."""


def missing() -> str:
    """Why the toolbox cannot be used; empty where it can."""
    from mujoco import sysid

    return "" if hasattr(sysid, "optimize") else "mujoco.sysid is not installed: pip install 'mujoco-core[sysid]'"


def by_closure(robot: Robot, data: Measurements, optimizer: str = "mujoco") -> ToolboxFit:
    """Fit all raw parameters to full poses, residual: apparent rod-length errors at the measured poses."""
    mechanism = robot.mechanism
    prior, sigma = priors(mechanism.units), data.sigma[:, :1]
    measured = Pose(data.position, data.rotation, np.zeros((len(data), 0)))

    def whitened(z: np.ndarray) -> np.ndarray:
        return (kinematics.closure(mechanism, mechanism.nominal + prior * z, data.q, measured).f / sigma).ravel()

    return _optimize(robot, whitened, optimizer)


def by_settling(robot: Robot, data: Measurements, optimizer: str = "mujoco", steps: int = STEPS) -> ToolboxFit:
    """Fit all raw parameters to full poses, residual: readings of a simulation that has come to rest."""
    from mujoco import sysid

    mechanism, prior = robot.mechanism, priors(robot.mechanism.units)
    spec, model = _simulation(robot)
    maker = kinds.get(robot.kind).variants["tendons"]
    times = STEP * np.arange(steps + 1)
    reading = {
        "x": (sysid.SignalType.MjSensor, np.arange(3)),
        "R": (sysid.SignalType.MjSensor, np.arange(3, 7)),
    }
    nominal = Machine(robot, variant="tendons")
    states, controls, sensors = [], [], []
    for n, q in enumerate(data.q):
        nominal.land(q[None])
        scratch = mujoco.MjData(model)
        scratch.qpos[:], scratch.ctrl[:] = nominal.loops.data.qpos, q
        states.append(_state(model, scratch))
        controls.append(sysid.TimeSeries.from_control_names(times, np.tile(q, (len(times), 1)), model))
        row = np.r_[data.position[n], rotation.to_quaternion(data.rotation[n])]
        sensors.append(sysid.TimeSeries(times, np.tile(row, (len(times), 1)), reading))
    sequences = sysid.ModelSequences("delta", spec, [f"pose{n}" for n in range(len(data))], states, controls, sensors)
    kept: dict[bytes, mujoco.MjModel] = {}

    def build(params, _spec) -> mujoco.MjModel:
        z = params.as_vector()
        if z.tobytes() not in kept:
            if len(kept) > 2 * len(z):
                kept.clear()
            changed = copy.copy(model)
            Geometry(changed, mechanism.parameters, maker.places(robot)).write(mechanism.nominal + prior * z)
            kept[z.tobytes()] = changed
        return kept[z.tobytes()]

    def last(params, predicted, measured, model, return_all, **_):
        del params, model, return_all
        want, got = measured.data[-1], predicted.data[-1]
        turned = rotation.log(rotation.from_quaternion(want[3:]) @ rotation.from_quaternion(got[3:]).T)
        return np.r_[want[:3] - got[:3], turned] / data.sigma[0], measured, measured

    residual = sysid.build_residual_fn(
        models_sequences=[sequences], build_model=build, modify_residual=last, n_threads=1, resample_true=False
    )
    return _run(robot, residual, optimizer)


def _optimize(robot: Robot, whitened, optimizer: str) -> ToolboxFit:
    def residual(x: np.ndarray, _params):
        columns = np.stack([whitened(z) for z in x.reshape(len(x), -1).T], axis=1)
        return [columns if x.ndim > 1 else columns[:, 0]], [], []

    return _run(robot, residual, optimizer)


def _run(robot: Robot, residual, optimizer: str) -> ToolboxFit:
    """The toolbox on a residual (M,) or (M, columns), with the priors as further residuals."""
    from mujoco import sysid

    prior = priors(robot.mechanism.units)
    n, count = len(prior), 0

    def with_priors(x: np.ndarray, params):
        nonlocal count
        count += 1 if x.ndim == 1 else x.shape[1]
        parts, predicted, measured = residual(x, params)
        return [*parts, x], predicted, measured

    unknowns = sysid.ParameterDict({"z": sysid.Parameter("z", np.zeros(n), np.full(n, -RANGE), np.full(n, RANGE))})
    with redirect_stdout(StringIO()):  # its optimisers print every iteration
        _, result = sysid.optimize(unknowns, with_priors, optimizer=optimizer, verbose=False)
    return ToolboxFit(robot.mechanism.nominal + prior * result.x, count)


def _simulation(robot: Robot) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """The robot as a user of the toolbox would simulate it: servos on the motors, a sensor on the plate."""
    spec = kinds.get(robot.kind).variants["tendons"].spec(robot)
    for key in spec.keys:
        spec.delete(key)
    spec.option.timestep = STEP
    spec.option.gravity = (0.0, 0.0, 0.0)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name in robot.mechanism.actuators:
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=SERVO, dampratio=1.0)
    for equality in spec.equalities:
        equality.solref[:] = (STIFFNESS, 1.0)
    for name, kind in (("x", mujoco.mjtSensor.mjSENS_FRAMEPOS), ("R", mujoco.mjtSensor.mjSENS_FRAMEQUAT)):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname="plate")
    return spec, spec.compile()


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    what = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
    state = np.empty(mujoco.mj_stateSize(model, what))
    mujoco.mj_getState(model, data, state, what)
    return state
