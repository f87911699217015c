"""The points of a cell show what is hidden there."""

from __future__ import annotations

import numpy as np
import pytest

from pcalib.cli import main
from pcalib.diagnosis import page
from pcalib.diagnosis.compare import compare, points_of
from pcalib.errors import InputError


@pytest.fixture(scope="module")
def found(measured):
    data, model = measured((("gear_ratio", 3.0),))
    return model, data, compare(model, data)


def test_every_cell_of_the_map_is_drawn_or_says_why_not(found):
    for cell in found[2].cells:
        try:
            drawn = points_of(found[2], f"{cell.channel}:{cell.variable}")
        except InputError as refused:
            assert "by itself" in refused.problem
            continue
        assert drawn.x.shape == drawn.y.shape == drawn.series.shape and np.isfinite(drawn.x).all()
        assert 0 <= drawn.series.min() and drawn.series.max() < len(drawn.names)


def test_points_follow_what_is_hidden(measured):
    data, model = measured((("thermal_rods", 3.0),))
    found = compare(model, data)
    drawn = points_of(found, "actuator:temp_rods")
    assert drawn.angle and drawn.axis == "temperature of rods [°C]" and drawn.names == ("q1", "q2", "q3")
    for i in range(3):
        mine = drawn.series == i
        assert abs(np.corrcoef(drawn.x[mine], drawn.y[mine])[0, 1]) > 0.6


def test_a_report_begins_with_the_points(found, tmp_path):
    model, data, compared = found
    cell = f"{compared.cells[0].channel}:{compared.cells[0].variable}"
    page.write_comparison(tmp_path / "r.html", model, data, compared, points_of(compared, cell))
    text = (tmp_path / "r.html").read_text()
    assert text.index("apparent error of") < text.index("How far apart")


def test_an_unknown_cell_lists_those_that_there_are(found):
    with pytest.raises(InputError, match=r"accepted: .*actuator:q"):
        points_of(found[2], "motor:heat")


def test_a_cell_needs_a_report(capsys):
    assert main("compare d.csv --model m.toml --cell actuator:q".split()) == 2
    assert "--report" in capsys.readouterr().err
