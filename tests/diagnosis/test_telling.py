"""What is said: figures that stand side by side measure the same, and first sentences are plain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcalib.diagnosis import telling
from pcalib.diagnosis.compare import compare
from pcalib.diagnosis.diagnose import diagnose
from pcalib.effects import Contribution, EffectParameter, get
from pcalib.fitting import identification


class TestComparison:
    def test_both_sets_are_judged_alike_and_rows_set_aside_are_named(self, measured):
        data, _ = measured()
        odd = np.flatnonzero(~data.check)[[5, 40, 60]]
        position = data.position.copy()
        position[odd, 2] += 2e-3
        spoiled = replace(data, position=position)
        found = compare(identification.fit(spoiled, measured()[1]).model, spoiled, n_draws=256)
        for a, times in zip((found.fit, found.check), found.times_noise, strict=True):
            assert times**2 * 6 > 0.9 * (a.rms_pos / found.noise.sigma_pos) ** 2
        said = " ".join(telling.comparison_details(found))
        assert all(str(int(line)) in said for line in data.lines[odd]) and "3 rows far from everything" in said
        assert "Without them, and with the geometry refitted, 1.0 times the noise is left" in said

    def test_nothing_is_added_where_a_fit_would_change_nothing(self, measured):
        data, model = measured()
        found = compare(model, data, n_draws=256)
        assert telling.comparison_details(found) == [found.noise.sentence()]
        assert "µrad" not in telling.comparison_sentence(found) and not telling.hot_cells(found.cells)

    def test_rotations_are_named_where_they_make_the_figure(self, measured, robot):
        data, _ = measured(seed=3)
        found = compare(identification.fit(data, robot, "model24").model, data, n_draws=256)
        error = np.hstack([1e-3 * found.error[:, :3], found.error[:, 3:]])
        assert telling.comparison_sentence(replace(found, fit=_judged(found, data, error))).count("µrad") == 2


def _judged(found, data, error):
    return identification.accuracy(error[~data.check], data.sigma[~data.check], data.mask[~data.check], 0.0)


class Wave:
    """An effect of the user's own that is not there."""

    name = "wave"
    parameters = (EffectParameter("size", "urad", 1e-4),)
    needs = ()

    def contribution(self, at, theta):
        return Contribution(actuator=theta[0] * np.sin(7 * at.q))


class TestCandidates:
    def test_rows_fall_in_p_and_the_users_own_are_listed_in_any_case(self, measured):
        data, model = measured((("drive_compliance", 1.0),))
        found = diagnose(model, data, [Wave()], n_draws=256)
        every = telling.one_per_effect(found)
        assert [(f.p, -f.s) for f in every] == sorted((f.p, -f.s) for f in every)
        rows = telling.candidate_rows(found, 3)
        assert len(rows) == 4 and rows[-1][0] == "wave" and all(len(row) == len(telling.CANDIDATES) for row in rows)
        listed = telling.candidate_rows(found, None)
        assert telling.candidates_left(found, 3).startswith(f"… and {len(listed) - 4} more")
        assert telling.candidates_left(found, len(listed) - 3).endswith("more, all p > 0.99.")
        assert telling.candidates_left(found, None) == ""

    def test_a_compliance_that_cannot_be_has_no_stiffness(self, robot):
        said = get("arm_bending", None, robot).describe(np.array([5e-6, -8e-7]))
        assert said == "vertical 5 µm/N (elbow stiffness 0.2 N/µm); lateral -0.8 µm/N (not physical)"
        assert get("arm_bending", None, robot).describe(np.array([5e-6, 0.0])).endswith("lateral 0 µm/N (rigid)")
