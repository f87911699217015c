"""Units against their definitions, and the refusals of names that do not say what they mean."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcalib import units
from pcalib.errors import InputError

DEFINED = {  # what each spelling is in SI, from the definitions of the units and not from the table
    "um": 1 / 1_000_000, "mm": 1 / 1000, "cm": 1 / 100, "m": 1, "deg": math.pi / 180, "mrad": 1 / 1000,
    "urad": 1 / 1_000_000, "arcmin": math.pi / 10_800, "arcsec": math.pi / 648_000, "rev": math.tau, "rad": 1,
    "g": 1 / 1000, "kg": 1, "min": 60, "h": 3600, "s": 1, "degC": 1, "N_um": 1 / 1e-6, "N_mm": 1000, "kNm_rad": 1000,
    "um_N": 1e-6, "urad_Nm": 1e-6, "ppm_K": 1e-6, "um_h": 1e-6 / 3600, "mm_rev": 1e-3 / math.tau,
}  # fmt: skip


@pytest.mark.parametrize("suffix", DEFINED)
def test_factor_is_the_definition(suffix):
    assert units.UNITS[suffix].factor == pytest.approx(DEFINED[suffix], rel=1e-15)
    assert units.factor(suffix) == pytest.approx(DEFINED[suffix], rel=1e-15)


@pytest.mark.parametrize(
    ("name", "quantity", "suffix"),
    [
        ("base_radius_mm", "base_radius", "mm"), ("k_N_um", "k", "N_um"), ("alpha_ppm_K", "alpha", "ppm_K"),
        ("v_um_h", "v", "um_h"), ("g_m_s2", "g", "m_s2"), ("q1_rev", "q1", "rev"), ("plain", "plain", None),
        ("x_furlong", "x_furlong", None), ("_mm", "", "mm"),
    ],
)  # fmt: skip
def test_split_takes_the_longest_suffix(name, quantity, suffix):
    stem, unit = units.split(name)
    assert (stem, unit.suffix if unit else None) == (quantity, suffix)


@pytest.mark.parametrize("suffix", [*units.UNITS, "1"])
def test_si_has_the_dimension_and_no_factor(suffix):
    found = units.si(suffix)
    assert units.factor(found) == 1
    if found == "1":
        assert suffix in ("ppm", "1")
    else:
        assert units.UNITS[found].dimension == units.UNITS[suffix].dimension


def test_si_by_hand():
    given = ["mm", "arcmin", "urad_Nm", "ppm_K", "um_h", "per_rev", "mm_rev"]
    assert [units.si(s) for s in given] == ["m", "rad", "rad_Nm", "1_K", "m_s", "per_rev", "m_rad"]


def test_resolve_converts_and_ignores_others():
    found = units.resolve(["q1_deg", "x_um", "humidity"], {"q1": "angle", "x": "length", "y": "length"})
    assert found.keys() == {"q1", "x"}
    assert found["x"] == ("x_um", 1e-6)


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (["x"], "'x' has no unit"),
        (["x_deg"], "'deg' is not a unit of length"),
        (["x_kg"], "'kg' is not a unit of length"),
        (["x_inch"], "'inch' is not a known unit"),
        (["x_mm", "x_m"], "'x' is given twice"),
        (["x_mm", "x_mm"], "'x' is given twice"),
    ],
)
def test_resolve_refuses(names, problem):
    with pytest.raises(InputError) as caught:
        units.resolve(names, {"x": "length"}, where="column")
    assert problem in caught.value.problem
    if "twice" not in problem:
        assert "x_um, x_mm, x_cm, x_m" in caught.value.remedy


@given(
    st.lists(st.floats(-1e6, 1e6, allow_subnormal=False), min_size=1, max_size=5),
    st.sampled_from([u for u in units.UNITS.values() if u.dimension in ("length", "angle", "mass")]),
)
def test_parse_quantity_reads_what_was_written(values, unit):
    text = ",".join(repr(v) for v in values) + unit.suffix
    np.testing.assert_allclose(units.parse_quantity(text, unit.dimension), np.array(values) * unit.factor, rtol=1e-15)


@pytest.mark.parametrize(
    "text", ["", "mm", "1", "1,2", "1 2mm", "1,mm", "nanmm", "infmm", "1furlong", "1deg", "1_0mm", "1e999mm"]
)
def test_parse_quantity_refuses(text):
    with pytest.raises(InputError, match=r"unit|beyond"):
        units.parse_quantity(text, "length", option="--tool")


@pytest.mark.parametrize("dimension", sorted({u.dimension for u in units.UNITS.values()} - {"expansion"}))
def test_the_example_of_a_refusal_is_accepted(dimension):
    with pytest.raises(InputError) as caught:
        units.parse_quantity("28", dimension)
    example = caught.value.remedy.rpartition("e.g. ")[2]
    assert units.parse_quantity(example, dimension).shape == (1,)


def test_parse_quantity_by_hand():
    np.testing.assert_allclose(units.parse_quantity("0, 0, -300 mm", "length"), [0, 0, -0.3])
    np.testing.assert_allclose(units.parse_quantity("-.5e1deg", "angle"), [-5 * math.pi / 180])
