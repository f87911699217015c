"""Files of other people that were misread in silence, each with its right answer: tests/cases."""

import json
from pathlib import Path

import numpy as np
import pytest

from pcalib import cli, modelfile, rotation
from pcalib import robot as robots
from pcalib.data import measurement
from pcalib.fitting import identification, mixups
from pcalib.robot import Robot

CASES = Path(__file__).parent / "cases"
MISREAD = {
    ("own_delta", "robot", "rot_rad_mislabelled"): "the rotation is in radians, not degrees",
    ("delta_rotation_in_radians", "delta", "data"): "the rotation is in radians, not degrees",
    ("own_delta", "robot", "qneg"): "q1, q2, q3 have the wrong sign",
    ("euler_angles", "hexa", "hexa_xyz"): "rx, ry, rz are Euler angles (xyz,",
    ("euler_angles", "hexapod", "hexapod_xyz"): "rx, ry, rz are Euler angles (xyz,",
    ("euler_angles", "hexapod", "hexapod_zyx"): "rx, ry, rz are Euler angles (zyx,",
    ("inspect_silent", "delta", "delta_tool_z_sign"): "tool_z has the wrong sign",
    ("inspect_silent", "hexapod", "rx_ry_swapped"): "rx is what stands in ry, ry is what stands in rx",
    ("inspect_silent", "hexapod", "legs_shifted_by_one"): "q1 … q6 are those of drives q2, q3, q4, q5, q6, q1",
    ("inspect_silent", "delta_arm_rod_swapped", "delta_ok"): "arm length and rod length are exchanged",
    ("inspect_silent", "delta_base_plate_swapped", "delta_ok"): "base radius and plate radius are exchanged",
    ("leg_scale_absurd", "hexapod", "leg4_reversed"): "q4 has the wrong sign",
    ("leg_scale_absurd", "hexapod", "legs_in_cm"): "q1 … q6 are in cm, not mm",
}  # fmt: skip


def files(case: tuple[str, str, str]) -> tuple[Path, Path]:
    folder, robot, data = case
    return CASES / folder / f"{data}.csv", CASES / folder / f"{robot}.toml"


@pytest.mark.parametrize("case", MISREAD, ids="-".join)
def test_what_was_misread_is_named_and_not_fitted(case, tmp_path, monkeypatch, capfd):
    data, robot = files(case)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    assert cli.main(["inspect", str(data), "--robot", str(robot), "--json", "found.json"]) == 2
    first = json.loads(Path("found.json").read_text())["findings"][0]
    assert first["level"] == "error" and MISREAD[case] in first["message"].replace("the robot file's ", "")
    assert cli.main(["fit", str(data), "--robot", str(robot), "-o", "m.toml"]) == 2
    assert MISREAD[case] in capfd.readouterr().err.replace("the robot file's ", "") and not Path("m.toml").exists()


@pytest.mark.parametrize(
    ("folder", "robot", "data", "line", "rms"),
    [
        ("euler_angles", "hexa", "hexa_xyz", "# euler = xyz", 34e-6),
        ("euler_angles", "hexapod", "hexapod_xyz", "# euler = xyz", 34e-6),
        ("euler_angles", "hexapod", "hexapod_zyx", "# euler = zyx", 34e-6),
    ],
)
def test_the_edit_that_is_named_mends_the_file(folder, robot, data, line, rms, tmp_path):
    source, drawn = files((folder, robot, data))
    mended = tmp_path / "mended.csv"
    mended.write_text(f"{line}\n{source.read_text()}")
    loaded = robots.load(drawn)
    found = identification.fit(measurement.load(mended, loaded), loaded)
    assert found.accuracy.rms_pos == pytest.approx(rms, rel=0.1) and found.accuracy.at_the_noise


def test_a_motor_homed_two_degrees_off_is_one_number_in_words(tmp_path, capfd, monkeypatch):
    data, robot = files(("own_delta", "robot", "home_off_2deg"))
    monkeypatch.setenv("COLUMNS", "300")
    assert cli.main(["fit", str(data), "--robot", str(robot), "-o", str(tmp_path / "m.toml")]) == 0
    said = capfd.readouterr().out
    assert said.startswith("Far from the drawing") and "the zero of motor q2 is off by −2.00°" in said.splitlines()[0]


def test_the_robot_file_of_another_robot_writes_no_model_unless_asked(tmp_path, capfd, monkeypatch):
    data, robot = files(("own_delta", "robot", "plain"))
    other = tmp_path / "other.toml"
    other.write_text(robot.read_text().replace("arm_length_mm = 200", "arm_length_mm = 350"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    fit = ["fit", str(data), "--robot", "other.toml", "-o", "m.toml", "--json", "fit.json"]
    assert cli.main(fit) == 2 and not Path("m.toml").exists()
    assert "arm length is 150" in capfd.readouterr().err and json.loads(Path("fit.json").read_text())["status"] == "far"
    assert cli.main([*fit, "--far"]) == 0
    assert "is this the robot file of this robot?" in capfd.readouterr().out.splitlines()[0]
    model = modelfile.load("m.toml")
    moved = model.k - model.robot.mechanism.nominal
    assert np.abs(moved).max() > 0.1


@pytest.mark.parametrize(
    ("robot", "data", "turn", "rms"), [("hexapod", "hexapod_20deg", 20, 33.7e-6), ("delta", "delta_30deg", 30, 33.5e-6)]
)
def test_a_tracked_body_whose_axes_are_turned_is_estimated_with_the_frame(robot, data, turn, rms, tmp_path):
    """The same poses without the turn fit to these residuals."""
    source, drawn = files(("target_body_turned", robot, data))
    loaded = robots.load(drawn)
    found = identification.fit(measurement.load(source, loaded), loaded)
    assert found.accuracy.rms_pos == pytest.approx(rms, rel=0.01) and found.accuracy.at_the_noise
    frame = found.model.frame
    assert frame is not None and frame.turn is not None
    turned = np.degrees(rotation.log(frame.turn))
    assert turned == pytest.approx([0, 0, turn], abs=0.5)
    assert {"target.rx", "target.ry", "target.rz"} <= set(found.unknowns.names)
    modelfile.save(tmp_path / "m.toml", found.model)
    again = modelfile.load(tmp_path / "m.toml").frame
    assert again is not None and again.turn is not None and np.abs(again.turn - frame.turn).max() < 1e-12


@pytest.mark.parametrize("level", ["nominal", "firmware3", "classical", "model24"])
def test_levels_that_leave_rotations_out_take_a_body_whose_axes_are_turned(level):
    source, drawn = files(("target_body_turned", "delta", "delta_30deg"))
    loaded = robots.load(drawn)
    found = identification.fit(measurement.load(source, loaded), loaded, level)
    assert found.status == "converged" and found.accuracy.rms_pos < 1e-3


def test_a_probe_that_triggers_above_the_bed_has_its_height(tmp_path, monkeypatch, capfd):
    """The printer is as configured: 16.5 mm are the probe's."""
    monkeypatch.chdir(tmp_path)
    settings = ("steps_per_mm=100", "rod=280mm", "radius=140mm", "endstop=370mm", "contact_height=16.5mm")
    said = [word for setting in settings for word in ("--set", setting)]
    steps = str(CASES / "contact_height" / "steps.csv")
    assert cli.main(["import", "carriage-steps", steps, *said, "-o", "d.csv", "--robot-output", "r.toml"]) == 0
    assert cli.main(["fit", "d.csv", "--robot", "r.toml", "--level", "firmware6", "-o", "m.toml"]) == 0
    assert cli.main(["firmware", "m.toml", "--json", "f.json"]) == 0
    found = json.loads(Path("f.json").read_text())
    assert found["position_endstop_mm"] == pytest.approx([370.0] * 3, abs=0.02)
    assert found["delta_radius_mm"] == pytest.approx(140.0, abs=0.02)


def test_motion_capture_that_counts_from_the_home_height_is_in_a_frame_of_its_own(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    capture = str(CASES / "mocap_z_from_home" / "mocap.csv")
    assert cli.main(["import", "motion-capture", capture, "-o", "d.csv", "--robot-output", "r.toml"]) == 0
    assert "frame = tracker" in capfd.readouterr().out
    loaded = robots.load("r.toml")
    found = identification.fit(measurement.load("d.csv", loaded), loaded)
    assert found.status == "converged" and found.accuracy.at_the_noise
    assert found.model.frame is not None and found.model.frame.translation[2] == pytest.approx(-0.565, abs=2e-3)


def test_seven_contacts_of_a_rotary_delta_find_the_zero_that_is_off(tmp_path):
    data, robot = files(("rotary_contacts", "robot", "contacts"))
    loaded = robots.load(robot)
    found = identification.fit(measurement.load(data, loaded), loaded, "firmware3")
    sigmas = np.sqrt(np.diag(found.covariance))
    at = dict(zip(found.unknowns.names, zip(found.estimate, sigmas, strict=True), strict=True))
    value, sigma = at["q2.offset"]
    assert abs(value + np.radians(0.5)) < 2 * sigma < 2e-3
    assert all(abs(v) < 2 * s for name, (v, s) in at.items() if name != "q2.offset")


def test_a_bound_that_excludes_the_truth_is_said_to_be_active(capfd, monkeypatch):
    """l11 is 2 mm longer than drawn, where half a millimetre is allowed."""
    data, robot = files(("bound_excludes_truth", "delta", "data"))
    monkeypatch.setenv("COLUMNS", "300")
    assert cli.main(["fit", str(data), "--robot", str(robot), "--bound", "l11=-0.5,0.5mm"]) == 0
    said = capfd.readouterr().out
    assert "l11 lies at its bound" in said and said.splitlines()[-1].endswith("--bound l11=-0.5,0.5mm -o model.toml")


def test_right_files_of_the_same_robots_raise_no_doubt():
    for case in (("own_delta", "robot", "plain"), ("inspect_silent", "delta", "delta_ok")):
        data, robot = files(case)
        loaded: Robot = robots.load(robot)
        judged = mixups.judge(measurement.load(data, loaded), loaded, always=True)
        assert not (judged.readings or judged.numbers or judged.frame or judged.far)
