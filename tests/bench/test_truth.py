"""Truth files: read strictly, sealed without loss."""

import numpy as np
import pytest

from bench import truth as truths
from bench.kinds import MODELS
from pcalib.errors import InputError

HEAD = f'robot = "{MODELS / "delta.toml"}"\n'


def parse(text):
    return truths.parse(HEAD + text, "t.toml")


def error_of(truth, name):
    return truth.errors[truth.robot.mechanism.index(name)]


def test_listed_errors_in_any_spelling_of_the_key():
    truth = parse('[geometry.errors]\nl11_um = 30\np1.x_mm = -0.2\n"beta2.z_mrad" = 1.5\n')
    assert np.isclose(error_of(truth, "l11"), 30e-6) and np.isclose(error_of(truth, "p1.x"), -2e-4)
    assert np.isclose(error_of(truth, "beta2.z"), 1.5e-3) and np.count_nonzero(truth.errors) == 3
    assert np.array_equal(truth.values, truth.robot.mechanism.nominal + truth.errors)


def test_drawn_errors_have_the_sigma_of_their_kind_and_add_to_listed_ones():
    text = "[geometry]\nsigma_length_mm = 0.5\nsigma_angle_deg = 0.2\nseed = {}\n"
    draws = np.array([parse(text.format(seed)).errors for seed in range(200)])
    angles = np.array(parse("").robot.mechanism.units) == "rad"
    for part, sigma in ((~angles, 0.5e-3), (angles, np.radians(0.2))):
        values = draws[:, part]
        assert abs(values.std() / sigma - 1) < 4 / np.sqrt(2 * values.size)
        assert abs(values.mean()) < 4 * sigma / np.sqrt(values.size)
        assert np.abs(np.corrcoef(values.T) - np.eye(values.shape[1])).max() < 0.35
    both = parse(text.format(5) + "[geometry.errors]\nl32_mm = 7\n")
    assert np.isclose(error_of(both, "l32"), draws[5, -10] + 7e-3)
    assert both.robot.mechanism.parameters[-10] == "l32"


def test_a_sealed_truth_is_the_same_robot_to_the_last_bit():
    truth = parse(
        "[geometry]\nsigma_length_mm = 0.1\nsigma_angle_deg = 0.05\nseed = 9\n"
        '[instrument]\nkind = "position"\nsigma_pos_um = 17\nsigma_distance_ppm = 6.3\nposition_mm = [1.1, 2, 3]\n'
        'frame = "tracker"\n'
    )
    again = truths.parse(truths.dumps(truth, {"plan": "random", "seed": 1}), "elsewhere/data.truth.toml")
    assert np.array_equal(again.errors, truth.errors) and again.robot.joint_range == truth.robot.joint_range
    for name, value in truth.instrument.values.items():
        assert np.array_equal(again.instrument.values[name], value), name
    q = np.array([[0.1, -0.4, -0.2]])
    assert np.array_equal(again.machine().land(q).tcp, truth.machine().land(q).tcp)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nonsense = 1\n", "unknown key 'nonsense'"),
        ("[geometri]\n", "did you mean 'geometry'"),
        ("[geometry]\nsigma_length = 0.1\n", "'sigma_length' has no unit"),
        ("[geometry]\nsigma_length_deg = 0.1\n", "is not a unit of length"),
        ("[geometry]\nsigma_length_mm = -0.1\n", "from 0 to 50"),
        ("[geometry]\nseed = 1.5\n", "must be a whole number"),
        ("[geometry.errors]\nl11 = 0.1\n", "'l11': has no unit"),
        ("[geometry.errors]\nl11_deg = 0.1\n", "'deg' is not a unit of length"),
        ("[geometry.errors]\nl41_mm = 0.1\n", "unknown parameter 'l41'"),
        ("[geometry.errors]\nl11_mm = nan\n", "must be a number"),
        ("[geometry.errors]\nl11_mm = 1\nl11_um = 2\n", "given twice"),
        ("[instrument]\nsigma_pos_mm = true\n", "must be a number"),
        ('[instrument]\nkind = "laser"\n', 'one of "pose", "position", "probe"'),
        ("[instrument]\nposition_mm = [1, 2]\n", "a list of 3 numbers"),
        ("[instrument]\nsigma_pos_mm = 1\nsigma_pos_um = 1\n", "given twice"),
        ("[faults.gremlins]\nsize = 1\n", "unknown fault 'gremlins'"),
        ("faults = 3\n", "'faults' must be a section"),
        ("[geometry\n", "not valid TOML"),
        ('schema = "other/1"\n', "schema is 'other/1'"),
    ],
)
def test_bad_files_are_refused_with_file_and_reason(text, message):
    with pytest.raises(InputError) as caught:
        parse(text)
    assert message in str(caught.value) and str(caught.value).startswith("t.toml")


def test_the_line_is_named():
    with pytest.raises(InputError, match=r"t\.toml:4: "):
        parse("\n[geometry.errors]\nl99_mm = 1\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[faults.backlash]\n", r"t\.toml:2: \[faults.backlash\] 'gap' is missing"),
        ("[faults.backlash]\ngap = 3\n", r"t\.toml:3: \[faults.backlash\] key 'gap' has no unit"),
        ("[faults]\nbacklash = { gap_mm = 1 }\n", r"'mm' is not a unit of angle"),
        (f"[faults.backlash]\ngap_urad = 1{400 * '0'}\n", r"t\.toml:3: .*'gap_urad' must be a number"),
        (f"[geometry.errors]\nl11_mm = 1{400 * '0'}\n", r"t\.toml:3: .*'l11_mm' must be a number"),
        ("[faults.backlish]\n", r"t\.toml:2: unknown fault 'backlish' \(did you mean 'backlash'"),
        ("[geometry]\nsigma_lenght_mm = 1\n", "did you mean 'sigma_length_mm'"),
    ],
)
def test_mistakes_are_found_where_they_stand(text, message):
    with pytest.raises(InputError, match=message):
        parse(text)


@pytest.mark.parametrize(
    ("kind", "name", "table"),
    [
        ("hexapod", "arm_bending", "vertical_um_N = 1"),
        ("linear_delta", "thermal_arms", "expansion_ppm_K = 1"),
        ("planar", "plate_flexing", "compliance_um_N = 1"),
        ("linear_delta", "encoder_eccentricity", "amplitude_urad = 1"),
        ("planar", "thermal_arms", "expansion_ppm_K = 1"),
    ],
)
def test_faults_that_a_robot_cannot_have_are_refused_when_read(kind, name, table):
    text = f'robot = "{MODELS / kind}.toml"\n[faults.{name}]\n{table}\n'
    with pytest.raises(InputError, match=rf"t\.toml:2: fault '{name}'.*{kind}"):
        truths.parse(text, "t.toml")


def test_no_robot():
    with pytest.raises(InputError, match="'robot' is missing"):
        truths.parse("[geometry]\n")
    with pytest.raises(InputError, match="relative to the truth file"):
        truths.parse('robot = "nowhere.toml"\n')
