"""Numbers as people write them."""

import numpy as np
import pytest

from pcalib import wording


@pytest.mark.parametrize(
    ("metres", "text"),
    [
        (20.5e-6, "20.5 µm"), (0.0, "0.0 µm"), (142e-6, "142 µm"), (999.4e-6, "999 µm"), (999.6e-6, "1.00 mm"),
        (3.3166e-3, "3.32 mm"), (4e-13, "4.0e-07 µm"), (np.nan, "–"), (99.44e-6, "99.4 µm"), (99.6e-6, "100 µm"),
    ],
)  # fmt: skip
def test_size(metres, text):
    assert wording.size(metres) == text


def test_round_size():
    assert [wording.round_size(10.0**n) for n in range(-6, 0)] == ["1 µm", "10 µm", "100 µm", "1 mm", "10 mm", "100 mm"]


@pytest.mark.parametrize(
    ("value", "sign", "text"),
    [(-1.2346, "-", "−1.235"), (1.0, "+", "+1.000"), (-1e-9, "-", "0.000"), (np.inf, "-", "–")],
)
def test_number(value, sign, text):
    assert wording.number(value, 3, sign) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(-1060.0, "-1060"), (2.97e3, "2970"), (999.7, "1000"), (80.0, "80"), (0.01234, "0.0123"), (2.5e9, "2.5e+09")],
)
def test_figures_are_written_out(value, text):
    assert wording.figure(value) == text


def test_small_quantities_have_a_prefix_that_fits():
    assert [wording.small(x, "rad") for x in (1.5e-5, 9.99e-4, 2.97e-3)] == ["15 µrad", "999 µrad", "2.97 mrad"]
    assert wording.deviation(0.0141543, "rad") == "14.15 mrad" and wording.deviation(5e-3, "rad", "+") == "+5000.0 µrad"


def test_effects_write_their_sizes_out():
    from pcalib import effects

    assert effects.get("gear_ratio").describe(np.array([-1.06e-3])) == "ratio error -1060 ppm"


def test_rotations_have_a_unit_that_fits():
    assert [wording.angle(x) for x in (2.04e-5, 2.647e-3, 0.0213, float("nan"))] == [
        "20.4 µrad", "2647 µrad", "21.3 mrad", "–",
    ]  # fmt: skip


def test_lists_of_sizes_are_cut_behind_a_whole_one():
    assert wording.clipped("vx 1 µm/h; vy 2 µm/h; wx 3 µrad/h", 25) == "vx 1 µm/h; vy 2 µm/h; …"
    assert wording.clipped("q1 1, q2 2", 25) == "q1 1, q2 2" and wording.clipped("nothing to cut at", 8) == "nothing…"
