"""Looking again and again: later rounds ask for more, so that ten of them together raise few false alarms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pcalib.data import measurement
from pcalib.data.joining import join
from pcalib.diagnosis import adequacy, results, rounds, telling
from pcalib.diagnosis.diagnose import diagnose
from pcalib.errors import InputError


def _smallest(first: int, more: int, rng: np.random.Generator) -> np.ndarray:
    """(20000, 10) p of the best of 60 groups of noise, corrected for their number, in rounds of growing data."""
    rows = first + more * np.arange(10)
    step = np.sqrt(np.diff(np.r_[0, rows]))
    sums = [np.cumsum(rng.standard_normal((2000, 60, 10)) * step, axis=2) for _ in range(10)]
    z = np.concatenate([np.abs(s / np.sqrt(rows)).max(axis=1) for s in sums])
    return -np.expm1(60 * np.log1p(-2 * stats.norm.sf(z)))


@pytest.mark.parametrize(("first", "more", "unspent"), [(120, 30, 0.14), (40, 40, 0.18)])
def test_ten_rounds_of_noise_raise_few_alarms(first, more, unspent):
    p = _smallest(first, more, np.random.default_rng(first))
    level = adequacy.SEARCH * np.array([rounds.share(k) for k in range(1, 11)])
    assert (p < adequacy.SEARCH).any(axis=1).mean() > unspent  # what it is for
    assert 0.04 < (p < level).any(axis=1).mean() < 0.06


def test_the_first_round_is_as_without_any():
    assert rounds.share(1) == 1.0


def test_limits_far_out_follow_those_of_few_draws():
    # The smallest of 50 uniform p has the limit 1 − (1 − level)^(1/50).
    null = np.sort(np.random.default_rng(1).random((4096, 50)).min(axis=1))
    for level in (0.04, 0.01, 4e-4):
        assert adequacy.limit(null, level) == pytest.approx(-np.expm1(np.log1p(-level) / 50), rel=0.3)


def test_a_file_says_its_round_and_joining_counts(measured, tmp_path):
    data, model = measured()
    both = join([data, data, replace(data, rounds=2)])
    assert both.rounds == 4
    measurement.save(tmp_path / "all.csv", both)
    assert measurement.load(tmp_path / "all.csv").rounds == 4
    measurement.save(tmp_path / "one.csv", data)
    assert "rounds" not in (tmp_path / "one.csv").read_text()
    first, third = diagnose(model, data, n_draws=1024), diagnose(model, replace(data, rounds=3), n_draws=1024)
    assert third.critical < first.critical / 5
    assert results.diagnosis_json(third)["round"] == 3
    assert any(line.startswith("Round 3 of measuring") and "0.44 %" in line for line in telling.details(third))
    assert not any("Round" in line for line in telling.details(first))


@pytest.mark.parametrize("text", ["0", "two", "1.5", "-1", "99999", "³"])
def test_a_wrong_number_of_rounds_is_refused(measured, tmp_path, text):
    measurement.save(tmp_path / "d.csv", measured()[0])
    written = (tmp_path / "d.csv").read_text()
    (tmp_path / "d.csv").write_text(f"# rounds = {text}\n{written}")
    with pytest.raises(InputError, match="no number of rounds") as error:
        measurement.load(tmp_path / "d.csv")
    assert error.value.line == 1
