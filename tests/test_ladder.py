"""Figures of a ladder against hand-computed ones."""

import numpy as np
import pytest

from pcalib import ladder as ladders
from pcalib.ladder import ErrorMap, Ladder, Step
from pcalib.model import Model


def error_map(tool=(0.0, 0.0, -0.3)) -> ErrorMap:
    errors = np.zeros((2, 3, 3))
    errors[0, :, 0] = [3e-3, 4e-3, 9e-3]
    errors[1, :, 1] = [3e-6, 4e-6, np.nan]
    status = np.array([["ok", "ok", "ok"], ["ok", "ok", "unreachable"]])
    return ErrorMap(np.array(tool), np.zeros((3, 3)), errors, status)


def make(delta, *maps) -> Ladder:
    model = Model.nominal(delta)
    return Ladder(delta, (Step("a", "Before", model, "none"), Step("b", "After", model)), maps)


def test_figures_are_over_the_targets_that_every_step_reached():
    m = error_map()
    assert m.reached.tolist() == [True, True, False]
    assert m.rms == pytest.approx([np.sqrt(12.5) * 1e-3, np.sqrt(12.5) * 1e-6])
    assert m.max == pytest.approx([4e-3, 4e-6])


def test_nothing_reached_is_no_number():
    m = error_map()
    none = ErrorMap(m.tool, m.targets, m.errors, np.full((2, 3), "unreachable"))
    assert np.isnan(none.rms).all() and np.isnan(none.max).all()


def test_sentence_and_table_lead_with_the_tool_that_suffered_most(delta):
    small = error_map((0.0, 0.0, 0.0))
    small = ErrorMap(small.tool, small.targets, 0.1 * small.errors, small.status)
    what = make(delta, small, error_map())
    assert what.worst_tool == 1
    assert ladders.sentence(what) == (
        "With a 300 mm tool the TCP missed its targets by 3.54 mm RMS; after calibration it misses them by 3.5 µm "
        "(0.4 µm without a tool)."
    )
    header, rows = ladders.table(what)
    assert header == ["model", "commands", "tool 0 mm RMS", "max", "tool 300 mm RMS", "max"]
    assert rows[0] == ["Before", "as drawn", "354 µm", "400 µm", "3.54 mm", "4.00 mm"]
    assert rows[1][-2:] == ["3.5 µm", "4.0 µm"]


@pytest.mark.parametrize(
    ("tool", "label"),
    [
        ((0, 0, 0), "tool 0 mm"), ((0, 0, -0.3), "tool 300 mm"), ((0, 0, -0.0125), "tool 12.5 mm"),
        ((0.01, 0, -0.3), "tool (10, 0, -300) mm"), ((0, 0, 0.3), "tool (0, 0, 300) mm"),
    ],
)  # fmt: skip
def test_tool_label(tool, label):
    assert ladders.tool_label(np.array(tool, float)) == label


def test_shapes_are_held(delta):
    m = error_map()
    with pytest.raises(ValueError, match="do not agree"):
        ErrorMap(m.tool, m.targets[:2], m.errors, m.status)
    with pytest.raises(ValueError, match="one error field per step"):
        Ladder(delta, (Step("a", "Before", Model.nominal(delta)),), (m,))
