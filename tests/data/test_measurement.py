"""Measurement files: what is written is read, and every wrong file is refused with line, column and remedy."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcalib import robot
from pcalib.data import joining, measurement, sigma
from pcalib.data.measurement import Measurements
from pcalib.errors import InputError

MODELS = Path(__file__).resolve().parents[2] / "models"

HEAD = "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm"
ROWS = ("0,0,0,0,0,-717.1", "10,-20,5,12.5,-40,-800", "-30,-30.5,-29,1,2,-900")
PLAIN = "\n".join([HEAD, *ROWS]) + "\n"
FULL = """\
# sigma_pos_mm = 0.02
# sigma_rot_deg = 0.005
# a comment without meaning
# frame = base
# robot = delta
q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg,tool_x_mm,tool_y_mm,tool_z_mm,payload_kg,temp_degC,time_s,dir1,dir2,dir3,pose_id,set
0,0,0,1,2,-817.1,0.1,0.2,-0.3,0,0,-100,0,20,0,1,-1,0,7,fit
10,-20,5,12.5,-40,-800,0,0,0,0,0,-100,1.5,21.5,60,-1,-1,+1,7,check
-30,-30.5,-29,,,,0.5,0,0,0,0,-100,0,22,120,0,0,0,,fit
-30,-30.5,-29,1,2,-900,,,,0,0,-100,0,22,120,0,0,0,9,fit
-30,-30.5,-29,,,-900,,,,0,0,-100,0,22,120,0,0,0,,check
"""


def write(tmp_path, text, name="data.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def same(a: Measurements, b: Measurements):
    for name in ("q", "position", "rotation", "tool", "payload", "sigma"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-13, atol=1e-15, err_msg=name)
    for name in ("mask", "check", "pose_id"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    for name in ("sigma_stated", "frame", "robot_name", "actuators", "actuator_dimension"):
        assert getattr(a, name) == getattr(b, name), name
    assert a.columns.keys() == b.columns.keys() and a.notes.keys() == b.notes.keys()
    for name, values in a.columns.items():
        np.testing.assert_allclose(values, b.columns[name], rtol=1e-13, atol=1e-15, err_msg=name)
    for name, values in a.notes.items():
        assert list(values) == list(b.notes[name])


@pytest.fixture(scope="module")
def delta():
    return robot.load(MODELS / "delta.toml")


def test_a_full_file_in_si(tmp_path, delta):
    data = measurement.load(write(tmp_path, FULL), delta)
    assert len(data) == 5
    np.testing.assert_allclose(data.q[1], np.deg2rad([10, -20, 5]))
    np.testing.assert_allclose(data.position[1], [0.0125, -0.04, -0.8])
    np.testing.assert_allclose(data.rotation[0], Rotation.from_rotvec([0.1, 0.2, -0.3], degrees=True).as_matrix())
    expected = [[1] * 6, [1] * 6, [0, 0, 0, 1, 1, 1], [1, 1, 1, 0, 0, 0], [0, 0, 1, 0, 0, 0]]
    np.testing.assert_array_equal(data.mask, np.array(expected, bool))
    assert np.isnan(data.position[2]).all() and np.isnan(data.position[4, :2]).all()
    assert np.isnan(data.rotation[3]).all()
    np.testing.assert_allclose(data.tool, np.tile([0, 0, -0.1], (5, 1)))
    np.testing.assert_allclose(data.payload, [0, 1.5, 0, 0, 0])
    for name in ("temp", "temp_arms", "temp_rods", "temp_base"):
        np.testing.assert_allclose(data.columns[name], [20, 21.5, 22, 22, 22])
    np.testing.assert_allclose(data.columns["time"], [0, 60, 120, 120, 120])
    np.testing.assert_array_equal(data.columns["dir3"], [0, 1, 0, 0, 0])
    np.testing.assert_array_equal(data.pose_id, [7, 7, -1, 9, -1])
    np.testing.assert_array_equal(data.check, [False, True, False, False, True])
    np.testing.assert_array_equal(data.fit_rows, [0, 2, 3])
    np.testing.assert_array_equal(np.flatnonzero(data.check), [1, 4])
    np.testing.assert_allclose(data.sigma, np.tile([2e-5] * 3 + [np.deg2rad(0.005)] * 3, (5, 1)))
    assert data.sigma_stated and data.frame == "base" and data.robot_name == "delta"
    np.testing.assert_array_equal(data.lines, [7, 8, 9, 10, 11])


def test_the_least_that_a_file_needs(tmp_path, delta):
    data = measurement.load(write(tmp_path, PLAIN), delta)
    assert not data.tool.any() and not data.payload.any() and not data.check.any() and (data.pose_id == -1).all()
    assert not data.mask[:, 3:].any() and data.mask[:, :3].all()
    assert not data.sigma_stated and data.frame == "base" and not data.columns
    np.testing.assert_allclose(data.sigma[:, :3], sigma.DEFAULT_SIGMA_POS)
    np.testing.assert_allclose(data.sigma[:, 3:], sigma.DEFAULT_SIGMA_ROT)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_round_trip(tmp_path, delta, suffix):
    data = measurement.load(write(tmp_path, FULL), delta)
    path = tmp_path / f"again.{suffix}"
    measurement.save(path, data)
    same(measurement.load(path, delta), data)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("stated", [(True, False), (False, True)])
def test_a_sigma_stated_alone_is_kept(tmp_path, delta, suffix, stated):
    """σ of positions without one of rotations, and the other way round, as one number or as a column."""
    name, unit, axis = ("sigma_pos_mm", 1e-3, 0) if stated[0] else ("sigma_rot_deg", np.deg2rad(1), 3)
    for values in ((0.1, 0.1), (0.1, 0.2)):
        rows = [f"{i},0,0,0,0,-900,0,0,0,{value}" for i, value in enumerate(values)]
        text = "\n".join([f"{HEAD},rx_deg,ry_deg,rz_deg,{name}", *rows]) + "\n"
        data = measurement.load(write(tmp_path, text), delta)
        assert data.stated == stated and not data.sigma_stated
        np.testing.assert_allclose(data.sigma[:, axis], np.array(values) * unit)
        path = tmp_path / f"again.{suffix}"
        for made, rows in ((data, [0, 1]), (joining.join([data, data]), [0, 1, 0, 1])):
            measurement.save(path, made)
            again = measurement.load(path, delta)
            assert again.stated == stated
            np.testing.assert_allclose(again.sigma, data.sigma[rows], rtol=1e-13)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_round_trip_of_own_columns_and_row_sigmas(tmp_path, delta, suffix):
    text = (
        f"# frame = tracker\nsigma_pos_um,{HEAD},operator,humidity,wind_m_s,temp_arms_degC,sigma_rot_mrad,qw,qx,qy,qz\n"
        '20,0,0,0,3000,0,900,"Doe, J.",0.30000000000000004,1e-7,25,0.1,1,0,0,0\n'
        "30,0,0,1,3000,0,900.5,,4,2,26,0.2,0.6,0,0.8,0\n"
    )
    data = measurement.load(write(tmp_path, text), delta)
    assert list(data.notes["operator"]) == ["Doe, J.", ""]
    np.testing.assert_array_equal(data.columns["humidity"], [0.30000000000000004, 4])
    np.testing.assert_array_equal(data.columns["wind_m_s"], [1e-7, 2])
    assert "temp" not in data.columns and "temp_rods" not in data.columns
    np.testing.assert_allclose(data.sigma[:, 0], [2e-5, 3e-5])
    np.testing.assert_allclose(data.sigma[:, 5], [1e-4, 2e-4])
    theirs = Rotation.from_quat([0.6, 0, 0.8, 0], scalar_first=True).as_matrix()
    np.testing.assert_allclose(data.rotation[1], theirs, atol=1e-15)
    path = tmp_path / f"again.{suffix}"
    measurement.save(path, data)
    same(measurement.load(path, delta), data)


@pytest.mark.parametrize("kind", ["hexapod", "planar", "h4", "linear_delta"])
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_round_trip_on_every_sort_of_robot(tmp_path, kind, suffix):
    described = robot.load(MODELS / f"{kind}.toml")
    rng = np.random.default_rng(1)
    q = rng.uniform(*described.joint_range, (6, len(described.mechanism.actuators)))
    w = described.workspace
    position = np.stack([*rng.uniform(-0.5, 0.5, (2, 6)) * w.radius, rng.uniform(w.z_min, w.z_max, 6)], axis=1)
    turn = Rotation.from_rotvec(rng.normal(0, 0.1, (6, 3))).as_matrix()
    turn[0], position[1, 2] = np.nan, np.nan
    columns = {"dir1": np.ones(6)}
    data = Measurements.create(described, q, position, turn, columns=columns, sigma_pos=1e-5, sigma_rot=1e-4)
    path = tmp_path / f"data.{suffix}"
    measurement.save(path, data)
    same(measurement.load(path, described), data)


def test_a_planar_robot_needs_no_more_than_its_plane(tmp_path):
    planar = robot.load(MODELS / "planar.toml")
    data = measurement.load(write(tmp_path, "q1_deg,x_mm,y_mm,rz_deg\n1,2,-950,0.5\n2,3,-951,\n"), planar)
    np.testing.assert_array_equal(data.mask[0], [True, True, False, True, True, True])
    np.testing.assert_array_equal(data.mask[1], [True, True, False, False, False, False])
    np.testing.assert_allclose(data.rotation[0], Rotation.from_rotvec([0, 0, 0.5], degrees=True).as_matrix())


def test_units_are_free(tmp_path, delta):
    text = "q1_rad,q2_rev,q3_arcmin,x_m,y_cm,z_um,payload_g,time_h\n0.1,-0.01,60,0.1,1,-800000,500,2\n"
    data = measurement.load(write(tmp_path, text), delta)
    np.testing.assert_allclose(data.q[0], [0.1, -0.02 * np.pi, np.deg2rad(1)])
    np.testing.assert_allclose(data.position[0], [0.1, 0.01, -0.8])
    assert data.payload[0] == 0.5 and data.columns["time"][0] == 7200


def test_without_a_robot_the_header_decides(tmp_path, delta):
    data = measurement.load(write(tmp_path, PLAIN))
    same(data, measurement.load(write(tmp_path, PLAIN), delta))
    legs = measurement.load(write(tmp_path, "q1_mm,q2_mm,x_mm,y_mm,z_mm\n1000,2,3,4,9e9\n"))
    assert legs.actuators == ("q1", "q2") and legs.actuator_dimension == "length"


def test_words_and_numbers_as_pose_id(tmp_path, delta):
    rows = [f"0,0,0,0,0,-717.1,{i}" for i in ("b", "a", "b", "")]
    data = measurement.load(write(tmp_path, "\n".join([HEAD + ",pose_id", *rows])), delta)
    np.testing.assert_array_equal(data.pose_id, [0, 1, 0, -1])


def test_line_endings_blank_lines_spaces_and_mark(tmp_path, delta):
    text = "\ufeff# frame = base \r\n\r\n" + PLAIN.replace(",", " , ").replace("\n", "\r\n") + "\r\n \r\n"
    data = measurement.load(write(tmp_path, text), delta)
    np.testing.assert_allclose(data.q, measurement.load(write(tmp_path, PLAIN), delta).q)
    np.testing.assert_array_equal(data.lines, [4, 5, 6])


def test_quaternions_are_normalised_within_a_thousandth(tmp_path, delta):
    text = HEAD + ",qw,qx,qy,qz\n0,0,0,0,0,-717.1,0.9995,0,0,0\n0,0,0,0,0,-717.1,,,,\n0,0,0,0,0,-717.1,-1,0,0,0\n"
    data = measurement.load(write(tmp_path, text), delta)
    np.testing.assert_array_equal(data.rotation[[0, 2]], np.tile(np.eye(3), (2, 1, 1)))
    assert not data.mask[1, 3:].any()


def test_take_keeps_everything_of_a_row(tmp_path, delta):
    data = measurement.load(write(tmp_path, FULL), delta)
    same(data.take(np.arange(5)), data)
    some = data.take(data.check)
    np.testing.assert_array_equal(some.lines, [8, 11])
    np.testing.assert_allclose(some.columns["temp"], [21.5, 22])
    assert len(data.take(slice(0, 0))) == 0


def test_one_temperature_stands_for_those_that_are_not_given(tmp_path, delta):
    text = HEAD + ",temp_degC,temp_rods_degC\n0,0,0,0,0,-717.1,20,30\n"
    path = write(tmp_path, text)
    data = measurement.load(path, delta)
    assert {n: v[0] for n, v in data.columns.items()} == {"temp": 20, "temp_arms": 20, "temp_rods": 30, "temp_base": 20}
    measurement.save(path, data)
    same(measurement.load(path, delta), data)


def test_tracker_positions_may_lie_anywhere(tmp_path, delta):
    far = PLAIN.replace("-900", "9000")
    with pytest.raises(InputError, match="far off the workspace"):
        measurement.load(write(tmp_path, far), delta)
    data = measurement.load(write(tmp_path, "# frame = tracker\n" + far), delta)
    assert data.frame == "tracker" and data.position[2, 2] == 9


def case(old, new, problem, line, column, remedy=""):
    return old, new, problem, line, column, remedy


WRONG = {
    # the table
    "short row": case(ROWS[1], "10,-20,5,12.5,-40", "5 fields where the header has 6", 3, None, "one field per column"),
    "decimal comma": case("12.5", "12,5", "7 fields", 3, None, "decimals are written with a point"),
    "quoted decimal comma": case("12.5", '"12,5"', "'12,5' is not a finite number", 3, "x_mm", "with a point"),
    "comment between rows": case(ROWS[1], "# frame = base", "1 fields", 3, None, "above the header"),
    "quotes": case("12.5", '"12.5"x', "not valid CSV", 3, None, "quotes"),
    "open quote": case("12.5", '"12.5', "not valid CSV", 4, None, "quotes"),
    "no row": case(PLAIN, HEAD + "\n", "no row", 1, None),
    "no header": case(PLAIN, "# frame = base\n", "no header", None, None),
    "nameless column": case(PLAIN, PLAIN.replace("\n", ",\n"), "column 7 has no name", 1, None),
    "twice": case("y_mm", "x_mm", "'x_mm' is given twice", 1, None),
    "twice in two units": case("y_mm,z_mm", "x_m,z_mm", "'x' is given twice", 1, None, "keep one"),
    # names
    "no unit": case("x_mm", "x", "'x' has no unit", 1, None, "x_um, x_mm, x_cm, x_m"),
    "unknown unit": case("x_mm", "x_inch", "'inch' is not a known unit", 1, None, "x_um, x_mm"),
    "wrong unit": case("q1_deg", "q1_mm", "not a unit of angle", 1, None, "q1_deg"),
    "missing actuator": case("q3_deg", "own", "column 'q3' is missing", 1, None, "q3_deg"),
    "missing position": case("z_mm", "own", "column 'z' is missing", 1, None, "z_mm"),
    "capitals": case("x_mm", "X_mm", "nearly a known one", 1, None, "write 'x_mm'"),
    # numbers
    "word": case("12.5", "abc", "'abc' is not a finite number", 3, "x_mm", "leave the field blank"),
    "nan": case("12.5", "nan", "'nan' is not a finite number", 3, "x_mm", "leave the field blank"),
    "inf": case("12.5", "-inf", "'-inf' is not a finite number", 3, "x_mm"),
    "huge": case("12.5", "1e999", "'1e999' is not a finite number", 3, "x_mm"),
    "underscore": case("12.5", "1_2", "'1_2' is not a finite number", 3, "x_mm"),
    "other digits": case("12.5", "١٢", "is not a finite number", 3, "x_mm"),
    "hex": case("12.5", "0x1p3", "is not a finite number", 3, "x_mm"),
    "blank actuator": case("10,-20,5", "10,,5", "blank", 3, "q2_deg"),
    "actuator nan": case("10,-20,5", "10,NaN,5", "'NaN' is not a finite number", 3, "q2_deg"),
    # suspicions
    "beyond the joints": case("10,-20,5", "10,-66,5", "-66° is outside the joint range -60…45°", 3, "q2_deg"),
    "degrees as rad": case("q2_deg", "q2_rad", "outside the joint range", 3, "q2_rad", "name the column q2_deg"),
    "all degrees as rad": case(
        HEAD, HEAD.replace("deg", "rad"), "outside the joint range", 3, "q1_rad", "look like deg: name the column q1_"
    ),
    "mm as m, all": case(HEAD, HEAD.replace("mm", "m"), "far off", 2, "z_m", "look like mm: name the columns x_mm"),
    "mm as m": case(PLAIN, HEAD + "\n0,0,0,0,0,-0.7171\n1,1,1,0.01,0,-0.72\n", "far off", 2, "z_mm", "look like m"),
    "z up": case("-900", "900", "far off the workspace", 4, "z_mm", "sign of z"),
    "x and z swapped": case(ROWS[1], "10,-20,5,-1900,-40,12.5", "far off the workspace", 3, "z_mm", "frame = tracker"),
    # metadata
    "unknown key": case(HEAD, "# sigma = 1\n" + HEAD, "metadata 'sigma'|metadata key 'sigma'", 1, None),
    "unknown key, accepted ones listed": case(
        HEAD, "# colour = red\n" + HEAD, "accepted: sigma_pos_mm, sigma_rot_deg, .*frame, robot", 1, None
    ),
    "key without unit": case(HEAD, "# sigma_pos = 1\n" + HEAD, "'sigma_pos' has no unit", 1, None, "sigma_pos_um"),
    "key with wrong unit": case(HEAD, "# sigma_pos_deg = 1\n" + HEAD, "not a unit of length", 1, None, "sigma_pos_um"),
    "key twice": case(HEAD, "# frame = base\n# frame = base\n" + HEAD, "'frame' is given twice", 2, None),
    "key in two units": case(HEAD, "# sigma_pos_mm = 1\n# sigma_pos_um = 1\n" + HEAD, "given twice", 2, None),
    "sigma zero": case(HEAD, "# sigma_pos_mm = 0\n" + HEAD, "must be a positive number, not '0'", 1, None),
    "sigma word": case(HEAD, "# sigma_rot_deg = small\n" + HEAD, "must be a positive number, not 'small'", 1, None),
    "sigma inf": case(HEAD, "# sigma_rot_deg = inf\n" + HEAD, "must be a positive number", 1, None),
    "no equals sign": case(HEAD, "# sigma_pos_mm 0.02\n" + HEAD, "'sigma_pos_mm' stands in a comment", 1, None),
    "colon": case(HEAD, "# frame: tracker\n" + HEAD, "'frame' stands in a comment", 1, None, "write # frame = …"),
    "frame": case(HEAD, "# frame = world\n" + HEAD, "frame 'world' is unknown", 1, None, "base, tracker"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files_are_refused(tmp_path, delta, name):
    old, new, problem, line, column, remedy = WRONG[name]
    assert old in PLAIN
    path = write(tmp_path, PLAIN.replace(old, new, 1))
    with pytest.raises(InputError, match=problem) as caught:
        measurement.load(path, delta)
    error = caught.value
    assert (str(error.file), error.line, error.column) == (str(path), line, column)
    assert remedy in error.remedy
    assert str(path) in str(error) and "\n" not in error.problem


WRONG_COLUMN = {
    "two thirds of a rotation": ("rx_deg,ry_deg", ("1,2", "1,2", "1,2"), "column 'rz' is missing", 1, None),
    "half a quaternion": ("qw,qx,qy,qz", ("1,0,0,0", "1,0,0,", ",,,"), "rotation is given in part", 3, "qz"),
    "three of a quaternion": ("qx,qy,qz", ("0,0,0", "0,0,0", "0,0,0"), "column 'qw' is missing", 1, None),
    "not a unit quaternion": ("qw,qx,qy,qz", ("1,0,0,0", "1.002,0,0,0", "0,1,0,0"), "length 1.002, not 1", 3, "qw"),
    "zero quaternion": ("qw,qx,qy,qz", ("1,0,0,0", "0,0,0,0", "0,1,0,0"), "length 0, not 1", 3, "qw"),
    "rotation twice": ("rx_deg,ry_deg,rz_deg,qw,qx,qy,qz", ("0,0,0,1,0,0,0",) * 3, "rotation is given twice", 1, None),
    "rotation without unit": ("rx,ry,rz", ("0,0,0",) * 3, "'rx' has no unit", 1, None),
    "direction": ("dir2", ("0", "2", "1"), "'2' is no direction", 3, "dir2"),
    "half a direction": ("dir2", ("0", "0.5", "1"), "'0.5' is no direction", 3, "dir2"),
    "blank direction": ("dir2", ("0", "", "1"), "blank", 3, "dir2"),
    "a fourth actuator": ("q4_deg", ("0",) * 3, "there is no actuator 4", 1, None),
    "a fourth direction": ("dir4", ("0",) * 3, "there is no actuator 4", 1, None),
    "set": ("set", ("fit", "Check", "fit"), "'Check' is no set", 3, "set"),
    "blank set": ("set", ("fit", "", "fit"), "'' is no set", 3, "set"),
    "negative payload": ("payload_kg", ("0", "1", "-1"), "cannot be negative", 4, "payload_kg"),
    "payload without unit": ("payload", ("0", "1", "1"), "'payload' has no unit", 1, None),
    "two of a tool": ("tool_x_mm,tool_y_mm", ("0,0",) * 3, "column 'tool_z' is missing", 1, None),
    "tool in the wrong unit": ("tool_x_m,tool_y_m,tool_z_m", ("0,0,-100",) * 3, "longer than the robot", 2, "tool_x_m"),
    "sigma negative": ("sigma_pos_mm", ("1", "1", "-1"), "σ must be positive", 4, "sigma_pos_mm"),
    "sigma zero": ("sigma_rot_deg", ("1", "0", "1"), "σ must be positive", 3, "sigma_rot_deg"),
    "sigma blank": ("sigma_pos_mm", ("1", "", "1"), "blank", 3, "sigma_pos_mm"),
    "temperature in K": ("temp_K", ("293",) * 3, "'K' is not a known unit", 1, None),
    "blank temperature": ("temp_degC", ("20", "", "20"), "blank", 3, "temp_degC"),
    "own column, one word": ("wind", ("1", "calm", "2"), "'calm' is not a finite number", 3, "wind"),
    "own column, nan": ("wind", ("1", "2", "nan"), "'nan' is not a finite number", 4, "wind"),
    "own column, blank": ("wind", ("1", "2", ""), "blank", 4, "wind"),
}


@pytest.mark.parametrize("name", WRONG_COLUMN)
def test_wrong_columns_are_refused(tmp_path, delta, name):
    header, cells, problem, line, column = WRONG_COLUMN[name]
    rows = [f"{row},{cell}" for row, cell in zip(ROWS, cells, strict=True)]
    path = write(tmp_path, "\n".join([f"{HEAD},{header}", *rows]))
    with pytest.raises(InputError, match=problem) as caught:
        measurement.load(path, delta)
    assert (caught.value.line, caught.value.column) == (line, column)


def test_a_blank_sigma_takes_that_of_the_metadata(tmp_path, delta):
    rows = [f"{row},{cell}" for row, cell in zip(ROWS, ("40", "", "40"), strict=True)]
    data = measurement.load(write(tmp_path, "\n".join(["# sigma_pos_mm = 0.02", HEAD + ",sigma_pos_um", *rows])), delta)
    np.testing.assert_allclose(data.sigma[:, 0], [4e-5, 2e-5, 4e-5])


def test_lengths_have_a_range_too(tmp_path):
    hexapod = robot.load(MODELS / "hexapod.toml")
    head = ",".join(f"q{i}_mm" for i in range(1, 7)) + ",x_mm,y_mm,z_mm\n"
    assert len(measurement.load(write(tmp_path, head + "131,0,0,0,0,-131,0,0,450\n"), hexapod)) == 1  # 5 % of 240 mm
    with pytest.raises(InputError, match="133 mm is outside the joint range -120…120 mm") as caught:
        measurement.load(write(tmp_path, head + "0,0,133,0,0,0,0,0,450\n"), hexapod)
    assert caught.value.column == "q3_mm"


def test_parquet_speaks_the_same_language(tmp_path, delta):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    path = tmp_path / "data.parquet"
    columns = {
        "q1_deg": pa.array([0, 10], pa.int32()), "q2_deg": [0.0, 1.0], "q3_deg": pa.array([0, 1], pa.float32()),
        "x_mm": [0.0, None], "y_mm": [1.0, float("nan")], "z_mm": [-700.0, -800.0],
        "set": pa.array(["fit", "check"]).dictionary_encode(), "pose_id": [3, None], "operator": ["a", None],
    }  # fmt: skip
    table = pa.table(columns).replace_schema_metadata({"sigma_pos_mm": "0.02", "pandas": "{}", "ARROW:x": "1"})
    pq.write_table(table, path)
    data = measurement.load(path, delta)
    np.testing.assert_array_equal(data.mask[:, :3], [[True, True, True], [False, False, True]])
    np.testing.assert_array_equal(data.pose_id, [3, -1])
    assert data.check[1] and data.sigma_stated and list(data.notes["operator"]) == ["a", ""]
    np.testing.assert_array_equal(data.lines, [1, 2])

    for name, values, problem in [
        ("q2_deg", [0.0, None], "blank"),
        ("q2_deg", [0.0, float("inf")], "'inf' is not a finite number"),
        ("q2_deg", [[0.0], [1.0]], "cannot be used"),
        ("q2_deg", ["0", "x"], "'x' is not a finite number"),
        ("q2", [0.0, 0.0], "'q2' has no unit"),
    ]:
        changed = {k: v for k, v in columns.items() if k != "q2_deg"} | {name: values}
        pq.write_table(pa.table(changed), path)
        with pytest.raises(InputError, match=problem):
            measurement.load(path, delta)
    pq.write_table(pa.table({"q1_deg": pa.array([], pa.float64())}), path)
    with pytest.raises(InputError, match="no row"):
        measurement.load(path, delta)
    for content in (b"", b"PAR1", PLAIN.encode()):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not a readable Parquet file"):
            measurement.load(path, delta)
    with pytest.raises(InputError, match="no such file"):
        measurement.load(tmp_path / "absent.parquet", delta)
    (tmp_path / "folder.parquet").mkdir()
    with pytest.raises(InputError, match="directory"):
        measurement.load(tmp_path / "folder.parquet", delta)


def test_a_parquet_file_by_another_name(tmp_path, delta):
    measurement.save(tmp_path / "a.parquet", measurement.load(write(tmp_path, PLAIN), delta))
    renamed = (tmp_path / "a.parquet").rename(tmp_path / "a.csv")
    with pytest.raises(InputError, match=r"Parquet file|not UTF-8"):
        measurement.load(renamed, delta)


def test_components_may_have_a_sigma_of_their_own(tmp_path, delta):
    data = measurement.load(write(tmp_path, FULL), delta)
    data.sigma[0, 1] *= 2
    measurement.save(tmp_path / "out.csv", data)
    again = measurement.load(tmp_path / "out.csv", delta)
    assert np.allclose(again.sigma[data.mask], data.sigma[data.mask], rtol=1e-12)
    text = (tmp_path / "out.csv").read_text()
    assert "sigma_y_mm" in text and "sigma_pos_mm" not in text


def test_the_depth_of_a_camera_is_stated_by_axis(tmp_path, delta):
    head = "# sigma_x_um = 20\n# sigma_z_um = 100\n# sigma_pos_um = 30\n"
    text = head + "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n0,0,0,0,0,-800\n"
    data = measurement.load(write(tmp_path, text), delta)
    assert np.allclose(data.sigma[0, :3], [20e-6, 30e-6, 100e-6]) and data.stated == (True, False)


SENSED = """# sigma_distance_um = 2
# surface_B = sphere
q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,distance_mm,station,tilt_x_mrad,tilt_y_mrad,probe_mm,surface,pose_id
0,0,0,1,2,-800,250,A,1,2,,,7
0,1,0,,,,251,A,,,,,7
0,0,1,,,,,,,,0.5,B,
0,0,2,,,,,,,,,,
"""


def test_what_sensors_read_is_a_row_of_its_own(tmp_path, delta):
    data = measurement.load(write(tmp_path, SENSED), delta)
    assert data.readings.sensor.tolist() == ["", "distance", "inclinometer", "distance", "probe", ""]
    assert data.readings.to.tolist() == ["", "A", "", "A", "B", ""] and data.lines.tolist() == [4, 4, 4, 5, 6, 7]
    assert data.mask.sum(axis=1).tolist() == [3, 1, 2, 1, 1, 0] and data.pose_id.tolist() == [7, 7, 7, 7, -1, -1]
    assert data.readings.value[1, 0] == 0.25 and data.readings.value[2, 3] == 1e-3
    assert data.sigma[1, 0] == 2e-6 and data.stated == (False, False)
    measurement.save(tmp_path / "out.csv", data)
    again = measurement.load(tmp_path / "out.csv", delta)
    assert again.readings.sensor.tolist() == data.readings.sensor.tolist()
    assert np.allclose(again.readings.value, data.readings.value, equal_nan=True)
    assert again.readings.options == {"surface_B": "sphere"}


@pytest.mark.parametrize(
    "old, new, problem",
    [
        ("250,A", "250,", "distance_mm is given and no station"),
        ("station,", "stn,", "column 'station' is missing"),
        ("surface_B = sphere", "surface_B = cube", "surface_B' is 'cube'"),
        ("sigma_distance_um = 2", "sigma_distance_um = 0", "must be a positive number"),
        ("distance_mm", "distance", "has no unit"),
    ],
)
def test_sensors_that_are_not_described_are_refused(tmp_path, delta, old, new, problem):
    assert old in SENSED
    with pytest.raises(InputError, match=problem):
        measurement.load(write(tmp_path, SENSED.replace(old, new, 1)), delta)


def test_single_components_of_a_rotation_are_read(tmp_path, delta):
    head = "# sigma_rot_urad = 50\nq1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n"
    rows = "0,0,0,1,2,-800,0.1,0.2,0.3\n0,1,0,,,,0.1,,\n0,0,1,1,2,-800,,0.2,\n"
    data = measurement.load(write(tmp_path, head + rows), delta)
    assert data.readings.sensor.tolist() == ["", "rotation_component", "", "rotation_component"]
    assert data.turned.tolist() == [True, False, False, False] and data.mask[:, 3:].sum(axis=1).tolist() == [3, 1, 0, 1]
    assert data.readings.value[3, 4] == pytest.approx(np.radians(0.2)) and np.allclose(data.sigma[:, 3], 50e-6)
    measurement.save(tmp_path / "out.csv", data)
    again = measurement.load(tmp_path / "out.csv", delta)
    assert again.mask.tolist() == data.mask.tolist() and np.allclose(again.sigma[data.mask], data.sigma[data.mask])


def test_half_a_rotation_means_nothing_in_the_frame_of_a_tracker(tmp_path, delta):
    rows = [f"{row},{cell}" for row, cell in zip(ROWS, ("1,2,3", "1,,3", ",,"), strict=True)]
    path = write(tmp_path, "\n".join(["# frame = tracker", f"{HEAD},rx_deg,ry_deg,rz_deg", *rows]))
    with pytest.raises(InputError, match="rotation is given in part") as caught:
        measurement.load(path, delta)
    assert (caught.value.line, caught.value.column) == (4, "ry_deg")


def test_an_artefact_stands_anywhere(tmp_path, delta):
    assert measurement.load(write(tmp_path, "# frame = artefact\n" + PLAIN), delta).frame == "tracker"


def test_shapes_must_agree(delta):
    with pytest.raises(ValueError, match="shape"):
        Measurements.create(delta, np.zeros((3, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="actuators"):
        Measurements.create(delta, np.zeros((2, 4)), np.zeros((2, 3)))


def test_a_hundred_thousand_rows(tmp_path, delta):
    n = 100_000
    rng = np.random.default_rng(0)
    q, position = rng.uniform(-1, 0.7, (n, 3)), rng.uniform(-0.3, 0.3, (n, 3)) + [0, 0, -0.8]
    columns = {"temp": np.full(n, 20.0), "time": np.arange(n) * 1.0}
    path = tmp_path / "large.csv"
    measurement.save(path, Measurements.create(delta, q, position, columns=columns, sigma_pos=1e-5))
    data = measurement.load(path, delta)
    np.testing.assert_allclose(data.q, q, rtol=1e-13, atol=1e-15)
