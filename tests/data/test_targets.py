"""Target and command files."""

from pathlib import Path

import numpy as np
import pytest

from pcalib import robot
from pcalib.data.targets import load_commands, load_targets, save_commands
from pcalib.errors import InputError

MODELS = Path(__file__).resolve().parents[2] / "models"
TARGETS = """\
x_mm,y_mm,z_mm,payload_kg,temp_degC,dir1,tool_x_mm,tool_y_mm,tool_z_mm,station
0,0,-800,0,20,1,0,0,-100,bin A
10.25,-20,-850.5,1.5,25,-1,0,0,-100,"bin B, left"
900,0,-800,0,25,0,0,0,-100,
"""


def load(tmp_path, text, kind="delta", name="targets.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return load_targets(path, robot.load(MODELS / f"{kind}.toml"))


def test_targets_in_si(tmp_path):
    targets = load(tmp_path, TARGETS)
    np.testing.assert_allclose(targets.position[1], [0.01025, -0.02, -0.8505])
    assert targets.tool is not None
    np.testing.assert_allclose(targets.tool, np.tile([0, 0, -0.1], (3, 1)))
    np.testing.assert_allclose(targets.payload, [0, 1.5, 0])
    np.testing.assert_allclose(targets.columns["temp_rods"], [20, 25, 25])
    np.testing.assert_array_equal(targets.columns["dir1"], [1, -1, 0])
    np.testing.assert_array_equal(targets.rotation, np.tile(np.eye(3), (3, 1, 1)))
    assert len(targets) == 3 and list(targets.lines) == [2, 3, 4]
    assert load(tmp_path, "x_m,y_m,z_m\n0,0,-0.8\n").tool is None


def test_orientation_where_a_robot_commands_it(tmp_path):
    six = load(tmp_path, "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n0,0,450,1,2,3\n", "hexapod")
    np.testing.assert_allclose(six.orientation, np.deg2rad([[1, 2, 3]]))
    four = load(tmp_path, "x_mm,y_mm,z_mm,rz_deg\n0,0,-400,30\n", "h4")
    np.testing.assert_allclose(four.rotation[0, :2, :2], [[3**0.5 / 2, -0.5], [0.5, 3**0.5 / 2]])
    assert not load(tmp_path, "x_mm,y_mm,z_mm,rx_deg\n0,0,-800,0\n").orientation.any()
    with pytest.raises(InputError, match="robot 'delta' commands x y z only") as caught:
        load(tmp_path, "x_mm,y_mm,z_mm,rx_deg\n0,0,-800,1\n")
    assert "rx_deg" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem", "line", "column"),
    [
        ("x_mm,y_mm\n0,0\n", "column 'z' is missing", 1, None),
        ("x_mm,y_mm,z_mm\n0,,-800\n", "blank", 2, "y_mm"),
        ("x_mm,y_mm,z_mm\n0,nan,-800\n", "'nan' is not a finite number", 2, "y_mm"),
        ("x_mm,y_mm,z\n0,0,-800\n", "'z' has no unit", 1, None),
        ("x_m,y_m,z_m\n0,0,-800\n1,1,-850\n", "far off", 2, "z_m"),
        ("x_mm,y_mm,z_mm\n0,0,-0.8\n", "far off", 2, "z_mm"),
        ("x_mm,y_mm,z_mm,payload_kg\n0,0,-800,-1\n", "negative", 2, "payload_kg"),
        ("x_mm,y_mm,z_mm,dir1\n0,0,-800,3\n", "no direction", 2, "dir1"),
        ("x_mm,y_mm,z_mm,Payload_kg\n0,0,-800,3\n", "nearly a known one", 1, None),
        ("# frame = tracker\nx_mm,y_mm,z_mm\n0,0,-800\n", "base frame", 1, None),
        ("# sigma_pos_mm = 1\nx_mm,y_mm,z_mm\n0,0,-800\n", "accepted: robot, frame", 1, None),
        ("x_mm,y_mm,z_mm\n", "no row", 1, None),
    ],
)
def test_wrong_targets_are_refused(tmp_path, text, problem, line, column):
    with pytest.raises(InputError, match=problem) as caught:
        load(tmp_path, text)
    assert (caught.value.line, caught.value.column) == (line, column)
    assert "targets.csv" in str(caught.value)


def test_units_are_guessed_in_the_remedy(tmp_path):
    with pytest.raises(InputError) as caught:
        load(tmp_path, "x_m,y_m,z_m\n0,0,-800\n1,1,-850\n")
    assert "look like mm: name the columns x_mm, y_mm, z_mm" in caught.value.remedy


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_commands_stand_beside_their_targets(tmp_path, suffix):
    delta = robot.load(MODELS / "delta.toml")
    targets = load(tmp_path, TARGETS)
    q = np.deg2rad([[1.0, 2.0, 3.0], [-10.5, 0.0, 20.25], [np.nan, 9.0, 9.0]])
    path = tmp_path / f"commands.{suffix}"
    save_commands(path, delta, targets, q, ["ok", "ok", "out_of_reach"])
    if suffix == "csv":
        assert path.read_text(encoding="utf-8") == (
            "# robot = delta\n"
            "q1_deg,q2_deg,q3_deg,status,x_mm,y_mm,z_mm,payload_kg,temp_degC,dir1,tool_x_mm,tool_y_mm,tool_z_mm,station\n"
            "1,2,3,ok,0,0,-800,0,20,1,0,0,-100,bin A\n"
            '-10.5,0,20.25,ok,10.25,-20,-850.5,1.5,25,-1,0,0,-100,"bin B, left"\n'
            ",,,out_of_reach,900,0,-800,0,25,0,0,0,-100,\n"
        )
    back, status = load_commands(path, delta)
    np.testing.assert_allclose(back[:2], q[:2], rtol=1e-14)
    assert np.isnan(back[2]).all() and list(status) == ["ok", "ok", "out_of_reach"]

    # A command file is a target file, too: its commands are written anew.
    again = load_targets(path, delta)
    np.testing.assert_allclose(again.position, targets.position, rtol=1e-14)
    second = tmp_path / f"again.{suffix}"
    save_commands(second, delta, again, q, ["ok", "ok", "out_of_reach"])
    if suffix == "csv":
        assert second.read_bytes() == path.read_bytes()


def test_a_command_without_its_values_is_refused(tmp_path):
    path = tmp_path / "commands.csv"
    path.write_text("q1_deg,q2_deg,q3_deg,status\n1,2,3,ok\n,,,ok\n")
    with pytest.raises(InputError, match="status is ok, but the command is blank") as caught:
        load_commands(path, robot.load(MODELS / "delta.toml"))
    assert caught.value.line == 3
