"""What neighbours share: a standard variable where nothing is missing, and seen where χ² sees nothing."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import effects
from pcalib.fitting import identification
from pcalib.model import FittedEffect, Model
from pcalib.uncertainty import neighbours

TOOLS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.1], [0.0, 0.0, -0.3]])


def found(delta, perturb, measure, seed: int, soft: float = 0.0, **options):
    effect = effects.parse("drive_compliance", delta)
    truth = replace(Model.nominal(delta), k=perturb(seed), effects=(FittedEffect(effect, np.array([soft]), "x"),))
    payload = np.array([0.0, 1.0, 2.0])[np.random.default_rng(seed).integers(0, 3, 60)]
    fit = identification.fit(measure(truth, 60, seed, tools=TOOLS, payload=payload, **options), delta)
    return fit, neighbours.shared(fit, fit.noise, np.ones(60, bool))


def test_noise_alone_makes_a_standard_variable(delta, perturb, measure):
    z = np.array([found(delta, perturb, measure, s)[1].errors for s in range(50)])
    assert abs(z.mean()) < 3 / np.sqrt(50) and 0.7 < z.std() < 1.35
    assert np.mean(z > 2.5) <= 0.06


def test_a_small_missing_effect_is_seen_and_measured(delta, perturb, measure):
    """Drives so stiff that χ² of positions shows them in few fits, and neighbours in most."""
    fits, alike = zip(*(found(delta, perturb, measure, s, 1.6e-5) for s in range(12)), strict=True)
    over = [(np.sqrt(f.accuracy.chi2_dof) - 1) * np.sqrt(2 * f.accuracy.dof) for f in fits]
    assert np.mean([a.errors for a in alike]) > 2 * max(np.mean(over), 0.5)
    assert 1e-6 < np.median([a.sigma for a in alike]) < 2e-5


def test_gross_and_few_rows_say_nothing(delta, perturb, measure):
    fit, _ = found(delta, perturb, measure, 1)
    few = np.arange(60) < neighbours.FEWEST - 1
    assert neighbours.shared(fit, fit.noise, few) == neighbours.Shared(0.0, 0.0)
    gross = replace(fit, error=fit.error + 1e-3 * (np.arange(60) == 7)[:, None])
    usable = np.arange(60) != 7
    assert neighbours.shared(gross, fit.noise, usable).errors == pytest.approx(
        neighbours.shared(fit, fit.noise, usable).errors
    )
