"""Files as spreadsheets and other programs write them: read as they are, or refused with the line that reads them."""

from pathlib import Path

import numpy as np
import pytest

from pcalib import inspection
from pcalib import robot as robots
from pcalib.data import measurement, spelling, targets
from pcalib.errors import InputError
from pcalib.fitting import mixups

CASES = Path(__file__).resolve().parents[1] / "cases"
ROBOT = robots.load(CASES / "own_delta" / "robot.toml")
PLAIN = measurement.load(CASES / "own_delta" / "plain.csv", ROBOT)
FILES = CASES / "own_delta_files"


@pytest.mark.parametrize(
    "name",
    [
        "brackets", "excel_semicolon_comma", "excel_semicolon_point", "latin1", "m_named", "quat_xyzw_names", "quoted",
        "tab", "utf16",
    ],
)  # fmt: skip
def test_the_same_measurements_in_another_form_are_the_same(name):
    found = measurement.load(FILES / f"{name}.csv", ROBOT)
    np.testing.assert_allclose(found.q, PLAIN.q, atol=2e-7)
    np.testing.assert_allclose(found.position, PLAIN.position, atol=1e-8)
    np.testing.assert_allclose(found.rotation, PLAIN.rotation, atol=2e-7)
    assert not found.columns and set(found.notes) <= {"note", "Bemerkung"}


def test_names_of_a_controller_are_refused_with_the_line_that_reads_them(tmp_path):
    with pytest.raises(InputError, match="without units") as refused:
        measurement.load(FILES / "SAnames.csv", ROBOT)
    line = refused.value.remedy.partition("header: ")[2]
    mended = tmp_path / "mended.csv"
    mended.write_text(f"{line}\n{(FILES / 'SAnames.csv').read_text()}")
    found = measurement.load(mended, ROBOT)
    np.testing.assert_allclose(found.rotation, PLAIN.rotation, atol=2e-7)


def test_euler_angles_so_small_that_they_are_a_rotation_vector_to_the_noise_change_nothing():
    """0.4° about three axes: the two readings differ by 10 µrad, where σ is 60 µrad."""
    found = measurement.load(FILES / "eulerZYX_as_rxyz.csv", ROBOT)
    assert np.abs(found.rotation - PLAIN.rotation).max() < PLAIN.sigma[0, 3] / 2
    assert not mixups.judge(found, ROBOT, always=True).readings
    note = next(f for f in inspection.inspect(found, ROBOT).findings if f.code == "rotation_vector")
    assert "less than σ" in note.message


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("# columns = q1_deg,q2_deg\n", "gives 2 names for 7 columns"),
        ("# columns = q1_deg,q1_deg,q3_deg,x_mm,y_mm,z_mm,note\n", "each of which needs one of its own"),
    ],
)
def test_a_line_of_names_gives_one_to_each_column(head, said, tmp_path):
    (tmp_path / "d.csv").write_text(f"{head}a,b,c,d,e,f,g\n1,2,3,4,5,-700,7\n")
    with pytest.raises(InputError, match=said):
        spelling.read(tmp_path / "d.csv")


def test_two_spellings_of_one_column_are_not_both_kept(tmp_path):
    (tmp_path / "d.csv").write_text("q1_deg,x_mm,X [mm]\n1,2,3\n")
    with pytest.raises(InputError, match="two columns are called 'x_mm'"):
        spelling.read(tmp_path / "d.csv")


def test_targets_with_decimal_commas(tmp_path):
    (tmp_path / "t.csv").write_text("x [mm];y [mm];z [mm]\n1,5;2;-500,25\n")
    assert targets.load_targets(tmp_path / "t.csv", ROBOT).position[0] == pytest.approx([1.5e-3, 2e-3, -0.50025])


def test_binary_files_are_no_text(tmp_path):
    (tmp_path / "d.csv").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="not UTF-8"):
        spelling.read(tmp_path / "d.csv")


def test_the_line_names_rotations_tools_and_replicates_of_other_programs(tmp_path):
    head = "A1 [°];A2 [°];A3 [°];X [mm];Y [mm];Z [mm];Roll [°];Pitch [°];Yaw [°];WZ_X [mm];WZ_Y [mm];WZ_Z [mm];"
    (tmp_path / "d.csv").write_text(head + "Pose;Satz\n" + ";".join(["1,5"] * 12) + ";;fit\n")
    with pytest.raises(InputError) as caught:
        measurement.load(tmp_path / "d.csv")
    line = "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg,tool_x_mm,tool_y_mm,tool_z_mm,pose_id,set"
    assert f"# columns = {line}; " in caught.value.remedy and "# euler = ZYX" in caught.value.remedy
