"""The minimisation where a model misses something: it ends, and geometry does not run away to make it good."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import effects
from pcalib.data.noise import Noise
from pcalib.fitting import evidence, identification, minimisation
from pcalib.fitting.linearisation import residuals
from pcalib.fitting.unknowns import unknowns_of
from pcalib.model import FittedEffect, Frame, Model


@pytest.mark.parametrize("compliance", [1e-4, 2e-4, 4e-4])
def test_what_a_model_misses_does_not_widen_the_priors(delta, perturb, measure, compliance):
    """Positions with one tool know many directions hardly at all; soft drives would hide there as millimetres."""
    drive = FittedEffect(effects.get("drive_compliance", robot=delta), np.array([compliance]))
    for seed in range(4):
        truth = replace(Model.nominal(delta), k=perturb(seed), effects=(drive,))
        data = measure(truth, 120, seed, tools=(0.2,), rotations=False)
        found = identification.fit(data, delta)
        assert found.status == "converged"
        assert found.prior_scale < 3


def test_an_effect_far_larger_than_usual_is_not_shrunk(delta, perturb, measure):
    """A metre that is 300 ppm off, thirty times what is usual, seen to some 20 ppm: the prior must not pull it back."""
    scale = effects.get("tracker_scale", robot=delta)
    tools = np.array([[0, 0, 0], [0, 0, -0.3], [0.2, 0, -0.1]])
    off = []
    for seed in range(12):
        truth = replace(Model.nominal(delta), k=perturb(seed), effects=(FittedEffect(scale, np.array([3e-4])),))
        data = measure(truth, 120, 5000 + seed, tools=tools)
        found = identification.fit(data, delta, effects=[FittedEffect(scale, np.zeros(1))])
        fitted = found.model.effects[0]
        assert fitted.sigma is not None and 5e-6 < fitted.sigma[0] < 5e-5
        off.append((fitted.theta[0] - 3e-4) / fitted.sigma[0])
    assert abs(np.mean(off)) < 3 / np.sqrt(len(off))
    assert 0.4 < np.std(off) < 1.7


def test_the_prior_of_the_targets_place_is_not_widened_as_an_effects(delta, perturb, measure, monkeypatch):
    """Only effects are given more room; without priors on them there is none to widen, though the target has one."""
    widened = []

    def widths(u, variance, width, least):
        widened.append(len(u))
        return width

    monkeypatch.setattr(evidence, "effect_room", widths)
    ratio = FittedEffect(effects.get("gear_ratio", "arm", delta), np.zeros(3))
    frame = Frame(np.eye(3), np.array([1.0, 2.0, 0.5]), np.array([0.0, 0.0, -0.04]))
    data = measure(replace(Model.nominal(delta), k=perturb(3), frame=frame), 60)
    for method, sizes in (("base", set()), ("map", {3})):
        widened.clear()
        identification.fit(data, delta, method=method, effects=[ratio])
        assert set(widened) == sizes


@pytest.fixture(scope="module")
def beside_a_cliff(delta, perturb, measure):
    """Data of a large ripple, and effects that would take it up by the signs of loads: χ² jumps where one changes."""
    ripple = FittedEffect(effects.get("gear_ripple", None, delta), np.array([1e-2, 0.0]))
    tools = np.array([[0, 0, 0], [0.06, 0, -0.2]])
    data = measure(replace(Model.nominal(delta), k=perturb(2), effects=(ripple,)), 120, 2, tools=tools)
    return data, [FittedEffect(effects.get(name, None, delta), np.zeros(1)) for name in ("joint_clearance", "backlash")]


def test_steps_that_only_damping_keeps_short_are_no_minimum(delta, beside_a_cliff):
    data, signs = beside_a_cliff
    found = identification.fit(data, delta, effects=signs)
    assert found.status == "not_converged" and found.iterations < 60
    assert "sign of a load" in found.remedy


@pytest.mark.parametrize("most", [8, 12, 60])
def test_damping_is_no_information(delta, beside_a_cliff, most):
    """RᵀR − JᵀJ is what the priors say and no more."""
    data, signs = beside_a_cliff
    start = replace(Model.nominal(delta), level="complete", effects=tuple(signs))
    unknowns = unknowns_of(start, "complete", signs)
    task = minimisation.Task(data, Noise.of(data), unknowns, np.arange(len(unknowns.names)), max_iterations=most)
    state = minimisation.minimise(task, start, residuals(start, data))
    J = state.begun.triangle[:, :-1] * unknowns.scale
    said = np.diag(state.R.T @ state.R) - np.sum(J**2, axis=0)
    most_said = (unknowns.scale / unknowns.prior) ** 2
    assert (said < 1.01 * most_said + 1e-9 * np.sum(J**2, axis=0)).all()
