"""What searching for a frequency costs."""

import numpy as np
import pytest

from pcalib.diagnosis.problem import problem
from pcalib.diagnosis.screen import Search


@pytest.mark.parametrize(("tries", "d"), [(1, 2), (40, 2), (40, 6)])
def test_independent_tries_are_counted(tries, d):
    best = np.random.default_rng(0).chisquare(d, (20_000, tries)).max(axis=1)
    found = Search.of(best, d)
    assert found.trials == pytest.approx(tries, rel=0.1)
    assert found.luck == pytest.approx(best.mean() - d, abs=0.02)


def test_neighbouring_frequencies_are_nearly_one(measured):
    data, model = measured()
    searched = {c.spec.partition("@")[0]: c.search for c in problem(model, data).candidates if c.name == "gear_ripple"}
    assert searched.keys() == {"gear_ripple", "gear_ripple:arm"}
    for search in searched.values():
        assert 20 < search.trials < 113 / 1.5  # of 113 cycles per turn
        assert 4 < search.luck < 15
    assert all(c.search.trials == 1 for c in problem(model, data).candidates if c.name != "gear_ripple")
