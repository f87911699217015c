"""Plans that tell effects apart: their figures are those that a diagnosis of simulated data then finds."""

from pathlib import Path

import numpy as np
import pytest

from bench import faults, simulate
from bench import plan as plans
from bench import truth as truths
from bench.instrument import Instrument
from pcalib import effects, planning
from pcalib import robot as robots
from pcalib.data import table as tables
from pcalib.diagnosis.diagnose import diagnose
from pcalib.diagnosis.separation import AtHand, plan
from pcalib.errors import EffectError, InputError
from pcalib.fitting import identification

ROBOT = robots.load(Path(__file__).parents[2] / "models" / "delta.toml")
SIGMA = np.r_[np.full(3, 15e-6), np.full(3, 60e-6)]
AT_HAND = AtHand(temperatures=(16.0, 28.0), tools=np.array([[0.0, 0, 0], [0, 0, -0.2], [0.12, 0, -0.1]]))


@pytest.fixture(scope="module")
def found():
    return plan(ROBOT, 60, SIGMA, at_hand=AT_HAND)


def test_what_is_left_is_never_more_than_what_there_was(found):
    own = np.diag(found.matrix)
    assert np.all(found.matrix <= own[:, None] * (1 + 1e-9))
    assert set(found.names) | set(found.hidden) == set(effects.names())
    assert ("arm_bending", "drive_compliance") in [tuple(sorted(pair)) for pair in found.aliases]
    assert "gravity_tilt" in found.hidden  # seen only through a compliance


def test_replicates_are_alike_and_apart(found):
    for number in range(int(found.pose_id.max()) + 1):
        first, second = np.flatnonzero(found.pose_id == number)
        assert np.array_equal(found.q[first], found.q[second])
        assert found.conditions.payload[first] == found.conditions.payload[second]
        assert second - first > 5
    assert (found.pose_id >= 0).sum() == 20


def test_the_rows_beat_random_ones(found):
    rng = np.random.default_rng(3)
    random = plan(ROBOT, 60, SIGMA, at_hand=AT_HAND, seed=int(rng.integers(99)))
    assert np.median(found.matrix) == pytest.approx(np.median(random.matrix), rel=0.5)  # two pools, one answer


@pytest.mark.parametrize("name", ["drive_compliance", "backlash", "thermal_rods"])
def test_predicted_sizes_are_those_that_a_diagnosis_finds(found, name, tmp_path):
    effect = effects.get(name, None, ROBOT)
    size = effect.parameters[0].prior
    columns = planning.table(ROBOT, found.q, found.conditions, found.position)
    columns["pose_id"] = [str(i) if i >= 0 else "" for i in found.pose_id]
    tables.write(tmp_path / "plan.csv", columns, {})
    typical = faults.typical(ROBOT, name, 1.0)
    fault = faults.typical(ROBOT, name, size / np.atleast_1d(typical.values[typical.SETTINGS[0].name])[0])
    errors = truths.draw_errors(ROBOT, 1e-4, np.radians(0.05), 5)
    truth = truths.Truth(ROBOT, errors, Instrument(sigma_pos=15e-6, sigma_rot=60e-6), (fault,))
    data = simulate.run(truth, plans.make(ROBOT, tmp_path / "plan.csv", 60), 5).measurements
    seen = diagnose(identification.fit(data, ROBOT).model, data, n_draws=512)
    mine = next(f for f in seen.findings if f.candidate.spec == name)
    i = found.names.index(name)
    # The diagnosis counts in the noise that it estimates, the plan in the stated one; noise adds a unit of its own.
    assert mine.s * np.mean(seen.noise.ratio) == pytest.approx(found.matrix[i, i], rel=0.1, abs=2.0)


def test_what_cannot_be_planned_is_said():
    with pytest.raises(InputError, match="rows cannot tell"):
        plan(ROBOT, 3, SIGMA)
    with pytest.raises(EffectError, match="unknown effect"):
        plan(ROBOT, 30, SIGMA, ["drive_complience"])
    with pytest.raises(InputError, match="fewer than two effects"):
        plan(ROBOT, 30, SIGMA, ["thermal_rods", "thermal_base"])
