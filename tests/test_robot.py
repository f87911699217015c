"""Robot files: what the default says, and a clear message for every way to get one wrong."""

import re
from pathlib import Path

import numpy as np
import pytest

from pcalib import kinds, robot, workspace
from pcalib.errors import InputError

MODELS = Path(__file__).resolve().parents[1] / "models"
DELTA = (MODELS / "delta.toml").read_text(encoding="utf-8")


def test_the_default_is_a_flexpicker_in_si():
    delta = robot.load(MODELS / "delta.toml")
    assert delta.joint_range == pytest.approx((-np.pi / 3, np.pi / 4))
    assert delta.dimensions["rod_length"] == pytest.approx(0.8)
    assert delta.mass == pytest.approx({"arm": 1.0, "arm_com": 0.175, "rod": 0.1, "plate": 0.5})
    w = delta.workspace
    assert (w.radius, w.z_min, w.z_max) == pytest.approx((0.4, -0.925, -0.675))
    np.testing.assert_array_equal(delta.gravity, [0, 0, -9.81])
    mechanism = delta.mechanism
    assert len(mechanism.parameters) == 60 and mechanism.rods == ("11", "12", "21", "22", "31", "32")
    # By docs/robots.md: p_i = R_base·(−sin θ, cos θ, 0), θ = 60°, and a_11 = (−w/2, L, 0).
    p1 = mechanism.nominal[[mechanism.index(f"p1.{c}") for c in "xyz"]]
    np.testing.assert_allclose(p1, [-0.2 * np.sqrt(3) / 2, 0.1, 0], atol=1e-15)
    a11 = mechanism.nominal[[mechanism.index(f"a11.{c}") for c in "xyz"]]
    np.testing.assert_allclose(a11, [-0.05, 0.35, 0], atol=1e-15)


@pytest.mark.parametrize("path", sorted(MODELS.glob("*.toml")), ids=lambda p: p.stem)
def test_every_model_file_loads(path):
    loaded = robot.load(path)
    assert loaded.kind in kinds.names()
    assert loaded.text == path.read_text(encoding="utf-8")
    assert len(loaded.mechanism.nominal) == len(loaded.mechanism.parameters) == len(loaded.mechanism.units)


def test_robots_are_found_by_name_and_files_before_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert robot.load("hexapod").text == (MODELS / "hexapod.toml").read_text(encoding="utf-8")
    (tmp_path / "hexapod").write_text(DELTA, encoding="utf-8")
    assert robot.load("hexapod").kind == "delta"
    with pytest.raises(InputError, match=r"unknown robot 'dleta' \(did you mean 'delta'"):
        robot.load("dleta")
    with pytest.raises(InputError, match="no such file"):
        robot.load("delta/none.toml")


def test_any_unit_gives_the_same_robot():
    other = DELTA.replace("base_radius_mm = 200.0", "base_radius_m = 0.2")
    other = other.replace("min_deg = -60.0", "min_arcmin = -3600")
    a, b = robot.parse(DELTA), robot.parse(other)
    assert a.joint_min == pytest.approx(b.joint_min, rel=1e-15)
    np.testing.assert_allclose(a.mechanism.nominal, b.mechanism.nominal, rtol=1e-15)


def test_gravity_and_missing_masses():
    text = DELTA.split("[mass]")[0] + "[workspace]" + DELTA.split("[workspace]")[1]
    bare = robot.parse(text + "\n[gravity]\nvector_m_s2 = [0.0, 9.81, 0.0]\n[drive]\nripple_per_turn = [24]\n")
    assert bare.mass == {}
    np.testing.assert_array_equal(bare.gravity, [0, 9.81, 0])
    assert list(bare.drive["ripple_per_turn"]) == [24]


WRONG = {
    "no TOML": ("[geometry]", "[geometry", "not valid TOML", None),
    "no name": ('name = "delta"', "", "'name' is missing", None),
    "name no text": ('name = "delta"', "name = 3", "'name' is missing or not text", 2),
    "kind": ('kind = "delta"', 'kind = "detla"', "did you mean 'delta'", None),
    "section unknown": ("[joints]", "[jonts]", "did you mean 'joints'", None),
    "section missing": ("[workspace]", "[gravity]", "unknown key|workspace", None),
    "section no table": ("[mass]", "[[mass]]", r"section \[mass\] must be a section", 17),
    "key unknown": ("rod_kg = 0.10", "rope_kg = 0.10", "unknown key 'rope_kg'", 20),
    "key missing": ("rod_length_mm = 800.0", "", "'rod_length' is missing", None),
    "no unit": ("rod_length_mm", "rod_length", "'rod_length' has no unit", None),
    "unknown unit": ("rod_length_mm", "rod_length_inch", "'inch' is not a known unit", None),
    "wrong unit": ("rod_length_mm", "rod_length_deg", "'deg' is not a unit of length", None),
    "joint unit": ("max_deg", "max_mm", "'mm' is not a unit of angle", None),
    "twice": ("rod_length_mm = 800.0", "rod_length_mm = 800.0\nrod_length_m = 0.8", "given twice", None),
    "twice the same": ("rod_kg = 0.10", "rod_kg = 0.10\nrod_kg = 0.10", "not valid TOML", None),
    "text": ("rod_length_mm = 800.0", 'rod_length_mm = "800"', "must be a number", 8),
    "bool": ("rod_length_mm = 800.0", "rod_length_mm = true", "must be a number", 8),
    "list": ("rod_length_mm = 800.0", "rod_length_mm = [800.0]", "must be a number", 8),
    "nan": ("rod_length_mm = 800.0", "rod_length_mm = nan", "must be a number", 8),
    "inf": ("max_deg = 45.0", "max_deg = inf", "must be a number", 15),
    "huge": ("rod_length_mm = 800.0", f"rod_length_mm = {'9' * 400}", "must be a number", 8),
    "no list": ("[60.0, 180.0, 300.0]", "60.0", "must be a list", 11),
    "short list": ("[60.0, 180.0, 300.0]", "[60.0, 180.0]", "axis_azimuth.*3 numbers", 11),
    "long list": ("[60.0, 180.0, 300.0]", "[0.0, 60.0, 180.0, 300.0]", "axis_azimuth.*3 numbers", 11),
    "nested list": ("[60.0, 180.0, 300.0]", "[[60.0], 180.0, 300.0]", "must be a list", 11),
    "range": ("min_deg = -60.0", "min_deg = 50.0", "min must be below max", 14),
    "negative length": ("rod_length_mm = 800.0", "rod_length_mm = -800.0", "must be from 0.1 to 100000", 8),
    "negative mass": ("plate_kg = 0.5", "plate_kg = -0.5", "'plate_kg' must be from 0 to 10000", 21),
    "workspace": ("z_min_mm = -925.0", "z_min_mm = -25.0", "z_min must be below z_max", 25),
    "radius": ("radius_mm = 400.0", "radius_mm = 0.0", "'radius_mm' must be from 0.1", 24),
    "gravity": ("[workspace]", "[gravity]\nvector_m_s2 = [0.0, -9.81]\n[workspace]", "list of 3 numbers", 24),
    "drive key": ("[workspace]", "[drive]\nripple = [24]\n[workspace]", "ripple_per_turn", None),
    "drive no table": ('name = "delta"', 'name = "delta"\ndrive = 3', "drive", None),
    "drive no numbers": ("[workspace]", '[drive]\nripple_per_turn = ["x"]\n[workspace]', "ripple_per_turn", None),
    "nesting": ('name = "delta"', "name = " + "[" * 5000 + "]" * 5000, "TOML", None),
    "empty": (DELTA, "\n", "empty", None),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_refused_with_file_and_reason(tmp_path, case):
    old, new, problem, line = WRONG[case]
    assert old in DELTA
    path = tmp_path / "robot.toml"
    path.write_text(DELTA.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=problem) as caught:
        robot.load(path)
    assert str(path) in str(caught.value)
    if line is not None:
        assert caught.value.line == line


def test_messages_list_what_is_accepted(tmp_path):
    with pytest.raises(InputError) as caught:
        robot.parse(DELTA.replace("rod_length_mm", "rod_length"))
    assert "rod_length_um, rod_length_mm, rod_length_cm, rod_length_m" in str(caught.value)


@pytest.mark.parametrize("name", ["delta", "linear_delta", "hexapod", "planar"])
def test_a_workspace_that_is_left_out_is_found_from_the_joints(name):
    """It overlaps the one that the file states, and the robot reaches it."""
    text = (MODELS / f"{name}.toml").read_text(encoding="utf-8")
    stated = robot.parse(text)
    start = text.index("[workspace]")
    end = text.find("\n[", start + 1)
    found = robot.parse(text[:start] + (text[end:] if end > 0 else ""))
    a, b = stated.workspace, found.workspace
    assert 0.3 * a.radius < b.radius < 3 * a.radius and max(a.z_min, b.z_min) < min(a.z_max, b.z_max)
    assert len(workspace.reachable(found, 20, np.random.default_rng(1)).q) == 20


NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?=[\s,\]]|$)")
NONSENSE = [
    (path.stem, number, value)
    for path in sorted(MODELS.glob("*.toml"))
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines())
    for value in ("3.5e27", "-1e29")
    if re.match(r"\w+_(mm|deg|kg|m_s2) = ", line)
]


@pytest.mark.parametrize("name, number, value", NONSENSE)
def test_no_kind_takes_nonsense(name, number, value):
    """Arms of 3.5e27 mm, azimuths of 1e29° and masses below zero: every number of every robot file has a range."""
    lines = (MODELS / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    key, _, numbers = lines[number].partition(" = ")
    lines[number] = f"{key} = {NUMBER.sub(value, numbers.partition('#')[0])}"
    with pytest.raises(InputError, match=key.rpartition("_")[0].removesuffix("_m")):
        robot.parse("\n".join(lines))


@pytest.mark.parametrize(("low", "high"), [(700, 900), (900, 700)])
def test_a_workspace_above_a_robot_that_hangs_is_refused_with_the_right_numbers(low, high):
    text = (MODELS / "delta.toml").read_text()
    text = re.sub(r"z_min_mm = .*", f"z_min_mm = {low}", text)
    text = re.sub(r"z_max_mm = .*", f"z_max_mm = {high}", text)
    with pytest.raises(InputError, match="lies above the base") as error:
        robot.parse(text)
    assert "z_min_mm = -900 and z_max_mm = -700" in error.value.remedy
