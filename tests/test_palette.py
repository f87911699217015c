"""Colours of error sizes: one fixed logarithmic scale, monotonic, with whole decades as its ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcalib.palette import NO_VALUE, LogScale


@pytest.mark.parametrize(
    ("values", "ends"),
    [
        ([12e-6, 6e-3], (1e-5, 1e-2)),
        ([1e-5, 1e-3], (1e-5, 1e-3)),
        ([2e-5, 3e-5], (1e-5, 1e-4)),
        ([1e-4], (1e-4, 1e-3)),
        ([0.0, np.nan, -1.0], (1e-6, 1e-3)),
    ],
)
def test_ends_are_the_decades_around_the_values(values, ends):
    scale = LogScale.of(np.array(values))
    assert (scale.low, scale.high) == pytest.approx(ends, rel=1e-12)


def test_decades():
    assert LogScale(1e-5, 1e-2).decades == pytest.approx([1e-5, 1e-4, 1e-3, 1e-2])


@given(st.floats(1e-9, 1.0), st.floats(1e-9, 1.0))
def test_larger_errors_stand_higher(a, b):
    scale = LogScale(1e-6, 1e-2)
    low, high = scale.share(np.array([min(a, b), max(a, b)]))
    assert 0 <= low <= high <= 1
    inside = 1e-6 < a < 1e-2
    assert not inside or scale.share(np.array(a)) == pytest.approx((np.log10(a) + 6) / 4)


def test_a_decade_is_another_colour_and_no_value_is_grey():
    scale = LogScale(1e-6, 1e-2)
    colours = scale.rgb(np.array([*scale.decades, np.nan]))
    assert colours.dtype == np.uint8 and len({tuple(c) for c in colours.tolist()}) == 6
    assert tuple(colours[-1]) == NO_VALUE
    # Readable on black and on white: never nearly one of them.
    light = scale.rgb(np.geomspace(1e-6, 1e-2, 50)) @ [0.2126, 0.7152, 0.0722]
    assert light.min() > 25 and light.max() < 232
