"""A listed effect is not established where a law that nobody listed explains the data better."""

import pytest

from bench.jobs.diagnosis_benchmark import rows
from pcalib.diagnosis import telling
from pcalib.diagnosis.diagnose import diagnose
from pcalib.diagnosis.verdict import Doubt
from pcalib.laws.verdict import beside, chance


def test_a_law_of_one_joint_is_no_backlash():
    """A plate joint that follows one motor's direction, in a set that backlash alone explains within the noise."""
    made = rows.replay("random_laws.rich/2#1", 1)
    found = diagnose(made.model, made.data)
    assert found.established == ("backlash",)
    laws = beside(found)
    assert laws is not None and laws.found.verdict == "ambiguous" and not laws.found.established
    assert laws.found.sets[0].doubts[-1] is Doubt.LAW and "direction of motor 3" in laws.rivals[0]
    assert "a law that is no listed effect explains these data better" in telling.sentence(laws.found)


def test_an_effect_that_is_there_stays_established_beside_laws():
    made = rows.replay("hidden.single_rich/20#4", 1)
    found = diagnose(made.model, made.data)
    laws = beside(found)
    assert found.established == ("friction_hysteresis",)
    assert laws is not None and laws.found.established == found.established


def test_a_better_law_pays_for_the_search():
    assert chance(1) == 0 and chance(88_578) == pytest.approx(22.8, abs=0.1)
