"""The minimisation where a model misses something: it ends, and geometry does not run away to make it good."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import effects, identification
from pcalib.model import FittedEffect, Model


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
