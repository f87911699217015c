"""The study of uncertainty, in small: a few robots of each part, landed in MuJoCo."""

import numpy as np
import pytest

from bench.jobs import uncertainty_study as study


@pytest.fixture(scope="module")
def cells() -> dict[tuple[str, str], study.Cell]:
    some = [study.Trial("nothing", "delta pose", s) for s in range(6)]
    some += [study.Trial(part, "drive_compliance", s) for part in ("hidden", "added") for s in range(2)]
    some += [study.Trial("accept", "pose", s) for s in range(6)]
    return {(c.part, c.cell): c for c in study.gather([(t, study.run(t)) for t in some])}


def test_landings_lie_inside_of_what_is_stated(cells):
    for part, cell in (("nothing", "delta pose"), ("hidden", "drive_compliance"), ("added", "drive_compliance")):
        found = cells[part, cell]
        assert found.coverage > 0.85 and found.ratio < 3 and found.refused == 0
    assert cells["hidden", "drive_compliance"].mean_um > 1.3 * cells["added", "drive_compliance"].mean_um
    assert 0.9 < cells["nothing", "delta pose"].sigma_coverage < 0.99


def test_robots_that_are_not_good_enough_do_not_pass(cells):
    assert cells["accept", "pose"].coverage >= 5 / 6


def test_plans_say_beforehand_what_is_reached():
    trials = [study.Trial("within", "delta pose", s) for s in range(6)]
    [cell, every] = study.gather([(t, study.run(t)) for t in trials])
    assert cell.robots == 6 and cell.refused == 0 and every.ratio == cell.ratio
    assert abs(cell.ratio - 1) < 0.1 + 4 * cell.error < 0.6


def test_a_cell_holds_within_its_bounds():
    def cell(coverage: float, mean: float) -> study.Cell:
        return study.Cell("nothing", "delta pose", 100, 0, coverage, 0.005, mean, 20.0, np.nan)

    assert cell(0.95, 22).holds and not cell(0.90, 22).holds and not cell(0.99, 22).holds and not cell(0.95, 40).holds
