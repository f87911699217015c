"""A listed effect is not established where a law that nobody listed explains the data better."""

import numpy as np
import pytest

from bench.jobs.diagnosis_benchmark import rows
from pcalib.diagnosis import page, telling
from pcalib.diagnosis.diagnose import diagnose
from pcalib.diagnosis.verdict import Against, Doubt
from pcalib.laws.telling import section
from pcalib.laws.verdict import beside, both, chance


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


def test_a_law_that_no_effect_resembles_is_an_alarm(tmp_path):
    """The tool point follows a direction times a temperature: 12 noise units that no candidate and no pattern shows."""
    made = rows.replay("random_laws.rich/0#1", 0)
    found = diagnose(made.model, made.data)
    assert found.verdict == "nothing_missing"
    laws = beside(found)
    assert laws is not None and laws.found.verdict == "unexplained" and not laws.found.sets
    assert laws.found.given.against == (Against.LAW,)
    said = telling.sentence(laws.found)
    assert said == "Something is missing: no listed effect shows it, a law outside the library does (p < 0.001)."
    assert "the direction of motor 1 × the temperature of arms" in laws.sentence
    page.write_diagnosis(tmp_path / "r.html", made.model, laws.found, "m.toml", [section(laws.proposals)])
    written = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Laws that no library lists" in written and laws.proposals.families[0].first.words() in written


def test_noise_is_no_law():
    made = rows.replay("noise.white/0#0", 0)
    assert beside(diagnose(made.model, made.data)) is None


def test_two_p_values_together_are_uniform_where_nothing_is_missing():
    """Of pairs of uniform numbers the first of which is 0.05 or less, a share x of all has a joint p below x."""
    rng = np.random.default_rng(0)
    n = 100_000
    first, second = rng.uniform(0, 0.05, n), rng.uniform(0, 1, n)  # one pair of twenty has so small a first number
    joint = np.array([both(p, held) for p, held in zip(first, second, strict=True)])
    for level in (0.002, 0.005, 0.02):
        assert 0.05 * np.mean(joint < level) == pytest.approx(level, rel=0.05)
