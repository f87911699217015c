"""Faults in MuJoCo and effects of the same name in the core mean the same, in size and sign, on every robot."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from bench import faults
from bench import plan as plans
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import effects, prediction
from pcalib import robot as robots
from pcalib.errors import EffectError, InputError
from pcalib.model import FittedEffect, Model
from pcalib.prediction import Conditions

NAMES = sorted(path.stem for path in MODELS.glob("*.toml"))
SAME = {
    "arm_bending": ("vertical", "lateral"), "backlash": ("gap",), "base_drift": ("v", "w"),
    "drive_compliance": ("compliance",), "friction_hysteresis": ("per_load",), "gear_ratio": ("error",),
    "joint_clearance": ("gap",), "rod_compliance": ("compliance",), "thermal_arms": ("expansion",),
    "thermal_base": ("expansion",), "thermal_rods": ("expansion",), "tool_bending": ("compliance",),
}  # fmt: skip
"""Settings of the fault that are the effect's parameters."""
WAVES = {"encoder_eccentricity": (-1, 1), "encoder_ovality": (-1, 2), "gear_ripple": (1, 1)}
"""Sign, and multiple of the phase, of A·sin(n·q + φ)."""
ELSEWHERE = {"gravity_tilt", "tracker_scale"}
"""Felt through another effect; the instrument's."""


@lru_cache
def load(name):
    text = (MODELS / f"{name}.toml").read_text()
    robot = robots.parse(text, name)
    if "arm_com" not in robot.mass:
        return robot
    # How the arm's mass is spread is assumed on both sides, and differently where its centre is not in the middle.
    return replace(robot, mass={**robot.mass, "arm_com": 0.5 * robot.dimensions["arm_length"]})


@lru_cache
def rigid(name):
    """Commands, true geometry, and where the rigid robot stands by MuJoCo and by the core."""
    robot = load(name)
    tool = [0.03, -0.1, 0.0] if robot.mechanism.n_state == 3 else [0.03, 0.0, -0.1]
    commands = plans.make(robot, "rich", 30, tools=[np.array(tool)], seed=3).commands
    units = np.array(robot.mechanism.units)
    size = np.where(units == "rad", 1e-3, 3e-4)
    k = robot.mechanism.nominal + size * np.random.default_rng(0).standard_normal(len(size))
    landing = Machine(robot, k).run(commands)
    assert landing.ok.all()
    return commands, k, landing.tcp, predicted(robot, k, commands)


def predicted(robot, k, commands, *present):
    model = replace(Model.nominal(robot), k=k, effects=present)
    return prediction.predict(model, commands.q, Conditions(commands.tool, commands.payload, commands.columns)).position


def parameters(name, fault):
    if name in SAME:
        values = [fault.values[key] for key in SAME[name]]
        return np.concatenate(values if name == "base_drift" else [np.unique(value) for value in values])
    sign, multiple = WAVES[name]
    phase = multiple * fault.values["phase"][0]
    return sign * fault.values["amplitude"][0] * np.array([np.cos(phase), np.sin(phase)])


def test_every_effect_has_its_fault(own_tests):
    compared = {*SAME, *WAVES, *ELSEWHERE}
    assert compared <= set(effects.names()) <= compared | own_tests and compared <= set(faults.names())


@pytest.mark.parametrize("effect", [*SAME, *WAVES])
@pytest.mark.parametrize("name", NAMES)
def test_they_move_the_tcp_alike(name, effect):
    robot = load(name)
    commands, k, true, modelled = rigid(name)
    refused = []
    for make in (lambda: Machine(robot, k, [faults.typical(robot, effect)]), lambda: effects.get(effect, None, robot)):
        try:
            make()
        except (InputError, EffectError) as error:
            refused.append(error)
    if refused:  # arms that bend, on a robot without arms: neither side knows them
        assert len(refused) == 2, refused
        return
    fault = faults.typical(robot, effect)
    landing = Machine(robot, k, [fault]).run(commands)
    told = FittedEffect(effects.get(effect, None, robot), parameters(effect, fault))
    moved, expected = landing.tcp - true, predicted(robot, k, commands, told) - modelled
    size = np.sqrt(np.nanmean(np.sum(moved**2, axis=1)))
    assert landing.ok.mean() > 0.95 and size > 2e-7
    assert np.nanmax(np.linalg.norm(moved - expected, axis=1)) < 0.01 * size


def test_a_tilt_of_gravity_through_compliant_drives():
    robot = load("delta")
    commands, k, _, _ = rigid("delta")
    soft, tilt = faults.typical(robot, "drive_compliance"), faults.typical(robot, "gravity_tilt")
    compliance = FittedEffect(effects.get("drive_compliance", None, robot), soft.values["compliance"][:1])
    tilted = effects.get("gravity_tilt", None, robot)
    told = FittedEffect(tilted, np.array([tilt.values["x"], tilt.values["y"]]))
    moved = Machine(robot, k, [soft, tilt]).run(commands).tcp - Machine(robot, k, [soft]).run(commands).tcp
    expected = predicted(robot, k, commands, compliance, told) - predicted(robot, k, commands, compliance)
    size = np.sqrt(np.mean(np.sum(moved**2, axis=1)))
    assert size > 1e-8 and np.linalg.norm(moved - expected, axis=1).max() < 0.01 * size
