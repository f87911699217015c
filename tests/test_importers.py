"""Readers of other origin, on files made here and, where it is there, on the real ones."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcalib import firmware, importers, rotation
from pcalib import robot as robots
from pcalib.cli import main
from pcalib.data import measurement
from pcalib.errors import FitError, InputError
from pcalib.fitting import crossvalidation, identification, trust
from pcalib.mechanics import kinematics

DATA = Path(__file__).parents[1] / ".." / "shared" / "data"
STEPS, CAPTURE = DATA / "linear_delta41" / "steps.csv", DATA / "hexapod108" / "measurements.csv"
real = pytest.mark.skipif(not (STEPS.exists() and CAPTURE.exists()), reason=f"no real measurements at {DATA}")
TOWERS = np.radians([210.0, 330.0, 90.0])


def bed_points(n, radius):
    """Points (n, 2) spread evenly over a disc."""
    i = np.arange(n)
    r, turn = radius * np.sqrt((i + 0.5) / n), 2.399963 * i
    return np.stack([r * np.cos(turn), r * np.sin(turn)], axis=-1)


def contact_steps(points, height, *, rod=288.0, radius=140.0, endstop=300.0, per_mm=80.0):
    """Steps at contacts of a perfect printer, by Pythagoras; all in mm."""
    towers = radius * np.stack([np.cos(TOWERS), np.sin(TOWERS)], axis=-1)
    carriage = height[:, None] + np.sqrt(rod**2 - np.sum((points[:, None] - towers) ** 2, axis=-1))
    return (endstop + np.sqrt(rod**2 - radius**2) - carriage) * per_mm


def write(path, steps):
    path.write_text("".join(",".join(f"{v:.4f}" for v in row) + "\n" for row in steps))
    return path


SETTINGS = ("rod=288mm", "radius=140mm", "endstop=300mm", "steps_per_mm=80", "bed_radius=85mm", "sigma=0.009mm")


def test_steps_become_carriage_heights_that_put_the_nozzle_on_the_bed(tmp_path):
    points = bed_points(30, 85.0)
    found = importers.run("carriage-steps", write(tmp_path / "s.csv", contact_steps(points, np.zeros(30))), SETTINGS)
    pose = kinematics.forward(found.robot.mechanism, found.robot.mechanism.nominal, found.data.q).pose
    assert np.abs(pose.x[:, :2] - 1e-3 * points).max() < 1e-7  # steps are written to 1e-4
    assert np.abs(pose.x[:, 2]).max() < 1e-8
    assert found.data.mask.tolist() == [[False, False, True, False, False, False]] * 30
    assert not found.data.position[:, 2].any() and found.data.frame == "base"
    assert found.robot.joint_max == pytest.approx(0.3 + np.sqrt(0.288**2 - 0.14**2), abs=1e-9)


def test_motion_capture_is_taken_as_it_stands(tmp_path):
    rng = np.random.default_rng(0)
    q, x = rng.uniform(0.5, 3, (12, 6)), rng.uniform(-50, 50, (12, 3)) + [0, 0, 750.0]
    R = rotation.exp(rng.uniform(-0.2, 0.2, (12, 3)))
    w, i, j, k = rotation.to_quaternion(R).T
    names = [f"leg_length_{n}" for n in range(1, 7)] + [f"position_{c}" for c in "xyz"]
    names += [f"orientation_{c}" for c in "xyzw"]
    rows = np.column_stack([q, x, i, j, k, w])
    text = ",".join(names) + "\n" + "\n".join(",".join(f"{v:.15g}" for v in row) for row in rows)
    (tmp_path / "c.csv").write_text(text)
    found = importers.run("motion-capture", tmp_path / "c.csv", ["home_height=600mm"])
    assert found.data.q == pytest.approx(2 * np.pi * q)
    assert found.data.position == pytest.approx(1e-3 * x)
    assert np.abs(found.data.rotation - R).max() < 1e-14
    mechanism = found.robot.mechanism
    assert mechanism.actuator_dimension == "angle"
    # A leg as drawn: its length at zero, and what one revolution adds.
    p1, b1 = (np.array([mechanism.nominal[mechanism.index(f"{s}1.{c}")] for c in "xyz"]) for s in "pb")
    assert mechanism.nominal[mechanism.index("l1")] == pytest.approx(np.linalg.norm(b1 + [0, 0, 0.6] - p1))
    longer = mechanism.actuation.base(mechanism.nominal, np.full((1, 6), 2 * np.pi)).length[0, 0]
    assert longer - mechanism.nominal[mechanism.index("l1")] == pytest.approx(1 / 13.21144)


def test_heights_at_known_points_are_the_contacts_that_steps_give(tmp_path):
    """A printer as configured touches its bed at z = 0: both forms put the carriages at the same heights."""
    points = np.random.default_rng(4).uniform(-80, 80, (30, 2))
    steps = importers.run("carriage-steps", write(tmp_path / "s.csv", contact_steps(points, np.zeros(30))), SETTINGS)
    rows = "".join(f"{x:.9f},{y:.9f},0\n" for x, y in points)
    (tmp_path / "h.csv").write_text(rows)
    own = [s for s in SETTINGS if not s.startswith("steps_per_mm")]
    heights = importers.run("bed-heights", tmp_path / "h.csv", [*own, "probe_offset=30,17mm", "contact_height=2mm"])
    np.testing.assert_allclose(heights.data.q, steps.data.q, atol=1e-8)
    assert (heights.data.position[:, 2] == 2e-3).all() and heights.data.tool[0] == pytest.approx([0.03, 0.017, 0.0])


@pytest.mark.parametrize("turns", [0.0, 1.5, 154.07, 600.4, 9876.5])
def test_the_robot_of_a_capture_admits_its_commands(tmp_path, turns):
    """However many revolutions a leg takes, at rest too."""
    legs, pose = turns * np.linspace([0.1] * 6, [1.0] * 6, 2), (1, 2, 1234.56, 0, 0, 0, 1)
    rows = [",".join(f"{v:.12g}" for v in (*leg, *pose)) for leg in legs]
    (tmp_path / "c.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    found = importers.run("motion-capture", tmp_path / "c.csv")
    w = found.robot.workspace
    assert found.robot.joint_min < found.data.q.min() and found.data.q.max() < found.robot.joint_max
    assert w.contains(found.data.position).all()
    measurement.save(tmp_path / "d.csv", found.data)
    assert len(measurement.load(tmp_path / "d.csv", found.robot)) == 2


@pytest.mark.parametrize(
    ("form", "text", "settings", "says"),
    [
        ("carriage-step", "1,2,3\n" * 9, [], "did you mean 'carriage-steps'"),
        ("carriage-steps", "1,2,3\n4,5\n" * 5, [], r"in.csv:2: '4,5' is not three step counts"),
        ("carriage-steps", "a,b,c\n1,2,3\n", [], r"in.csv:1: 'a,b,c' is not three step counts"),
        ("carriage-steps", "1,2,nan\n" * 9, [], "is not three step counts"),
        ("carriage-steps", "1,2,3\n" * 3, [], "3 contacts are too few"),
        ("bed-heights", "0,0,0\n1,2\n" * 5, [], r"in.csv:2: '1,2' is not x, y and z"),
        ("bed-heights", "0,0,0\n900,0,0\n" * 5, [], r"in.csv:2: rods of 340 mm do not reach this point"),
        ("carriage-steps", "1,2,3\n1,90000,3\n" * 3, [], r"in.csv:2: .* below the bed"),
        ("carriage-steps", "1,2,3\n" * 9, ["rod=100mm"], "rods of 100 mm cannot span"),
        ("carriage-steps", "1,2,3\n" * 9, ["rod=100"], "no unit"),
        ("carriage-steps", "1,2,3\n" * 9, ["rood=100mm"], "did you mean 'rod'"),
        ("carriage-steps", "1,2,3\n" * 9, ["towers=1,2deg"], "3 numbers needed, not 2"),
        ("carriage-steps", "", [], "empty"),
        ("motion-capture", "leg_length_1\n1\n", [], "column 'leg_length_2' is missing"),
    ],
)
def test_bad_input_is_named(tmp_path, form, text, settings, says):
    (tmp_path / "in.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        importers.run(form, tmp_path / "in.csv", settings)


CELLS = st.one_of(
    st.floats(-1e5, 1e5).map("{:.6g}".format), st.sampled_from(["", "nan", "1e400", "x", "1,2", '"', "#", "é", "\x00"])
)
ROWS = st.lists(st.lists(CELLS, min_size=1, max_size=14).map(",".join), max_size=12).map("\n".join)
HEADER = ",".join(
    [f"leg_length_{n}" for n in range(1, 7)] + [f"position_{c}" for c in "xyz"] + [f"orientation_{c}" for c in "xyzw"]
)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(form=st.sampled_from(importers.names()), head=st.sampled_from(["", HEADER + "\n"]), rows=ROWS)
def test_whatever_a_file_holds_is_read_or_refused_in_words(tmp_path, form, head, rows):
    (tmp_path / "f.csv").write_text(head + rows, encoding="utf-8")
    try:
        found = importers.run(form, tmp_path / "f.csv")
    except InputError as error:
        assert str(error)
    else:
        assert np.isfinite(found.data.q).all()


def test_the_command_writes_both_files_or_says_what_is_missing(tmp_path, capsys):
    steps = write(tmp_path / "s.csv", contact_steps(bed_points(12, 85.0), np.zeros(12)))
    data, robot = tmp_path / "d.csv", tmp_path / "r.toml"
    options = [part for setting in SETTINGS for part in ("--set", setting)]
    assert main(["import", "carriage-steps", str(steps), "-o", str(data), *options]) == 2
    assert not data.exists() and "--robot-output" in capsys.readouterr().err
    assert main(["import", "carriage-steps", str(steps), "-o", str(data), "--robot-output", str(robot), *options]) == 0
    loaded = measurement.load(data, robots.load(robot))
    assert len(loaded) == 12 and loaded.sigma[0, 2] == pytest.approx(9e-6)
    assert main(["import", "carriage-steps", "--json", str(tmp_path / "s.json")]) == 0
    assert "steps_per_mm" in capsys.readouterr().out
    content = json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))
    assert content["schema"] == "pcalib.import/1" and content["form"] == "carriage-steps"
    rod = {"setting": "rod", "default": [340.0], "unit": "mm", "text": "rod length in the present configuration"}
    assert rod in content["settings"] and len(content["settings"]) == 11


def test_a_good_residual_with_the_wrong_rods_is_not_taken_on_trust(tmp_path):
    """Rods of 288 mm found to be 269 mm at 9 µm: a wrong motor scale scales everything, and heights cannot tell.

    The tool says so, gives σ and names the measurement that settles it; with that measurement the trap is sprung.
    """
    noise = 9.5e-3 * np.random.default_rng(4).standard_normal(41)
    steps = contact_steps(bed_points(41, 85.0), noise) * (269 / 288)
    found = importers.run("carriage-steps", write(tmp_path / "s.csv", steps), SETTINGS)
    fit = identification.fit(found.data, found.robot, "firmware7", method="base")
    assert fit.status == "converged" and fit.accuracy.rms_pos < 1e-5
    rod = fit.estimate[fit.unknowns.names.index("rod.length")]
    assert rod == pytest.approx(-19e-3, abs=2.5e-3)
    doubts = {doubt.name: doubt for doubt in trust.doubts(fit, found.data)}
    doubt = doubts["rod.length"]
    assert doubt.change == rod and 0.4e-3 < doubt.sigma < 2e-3
    assert doubt.rms_held < 6e-5  # 19 mm of rod are 40 µm of height
    assert doubt.remedy.startswith("the length of rod 11") and doubt.sigma_after < 0.1 * doubt.sigma
    assert "288" not in doubt.sentence() and "far beyond any tolerance" in doubt.sentence()
    # A change within its own σ is none: nothing is said to lie anywhere.
    loose = replace(fit, covariance=400 * fit.covariance)
    assert "rod.length" not in [doubt.name for doubt in trust.doubts(loose, found.data)]
    assert doubts["scale"].sigma > 1e-3 and "wrong motion per motor step" in doubts["scale"].sentence()
    # With the rod as measured, the misfit shows that something else is wrong, and the residual is no longer small.
    held = identification.fit(found.data, found.robot, "firmware7", method="base", fixed=["rod.length"])
    assert held.accuracy.rms_pos > 3 * fit.accuracy.rms_pos
    assert held.accuracy.rms_pos == pytest.approx(doubt.rms_held, rel=0.1)


def test_an_honest_printer_raises_no_doubt_about_its_rods(tmp_path):
    noise = 9e-3 * np.random.default_rng(2).standard_normal(41)
    steps = contact_steps(bed_points(41, 85.0), noise)
    found = importers.run("carriage-steps", write(tmp_path / "s.csv", steps), SETTINGS)
    fit = identification.fit(found.data, found.robot, "firmware7")
    assert [doubt.name for doubt in trust.doubts(fit, found.data)] in ([], ["scale"])


def test_known_distances_take_the_doubt_about_scale_away(tmp_path):
    """The same contacts with x and y of each measured: nothing is left to doubt."""
    points = bed_points(41, 85.0)
    found = importers.run("carriage-steps", write(tmp_path / "s.csv", contact_steps(points, np.zeros(41))), SETTINGS)
    position = np.column_stack([1e-3 * points, np.zeros(41)])
    data = measurement.Measurements.create(found.robot, found.data.q, position, sigma_pos=1e-5)
    assert trust.doubts(identification.fit(data, found.robot, "firmware7"), data) == []


@real
@pytest.mark.parametrize(
    ("level", "rms"), [("firmware4", 60), ("firmware6", 39), ("firmware7", 35), ("tower_lean", 27)]
)
@pytest.mark.parametrize("method", ["map", "base"])
def test_real_printer_levels(level, rms, method):
    found = importers.run("carriage-steps", STEPS)
    fit = identification.fit(found.data, found.robot, level, method=method)
    assert fit.status == "converged"
    assert fit.accuracy.rms_pos * 1e6 == pytest.approx(rms, abs=2)
    doubts = {doubt.name: doubt for doubt in trust.doubts(fit, found.data)}
    assert doubts["scale"].sigma > 3e-4 and "absolute scale is weak" in doubts["scale"].sentence()


@real
@pytest.mark.parametrize("method", ["map", "base"])
def test_separate_tower_radii_are_refused_with_the_reason(method, tmp_path, capsys):
    found = importers.run("carriage-steps", STEPS)
    fit = identification.fit(found.data, found.robot, "tower_radii", method=method)
    assert fit.status == "rank_deficient" and fit.n_identified == 7
    assert "x and y never measured" in fit.reason and ".radius cannot be told from" in fit.reason
    with pytest.raises(FitError, match=r"fix only 7 of 9"):
        _ = fit.model
    data, robot, model = (str(tmp_path / name) for name in ("d.csv", "r.toml", "m.toml"))
    assert main(["import", "carriage-steps", str(STEPS), "-o", data, "--robot-output", robot]) == 0
    assert main(["fit", data, "--robot", robot, "--level", "tower_radii", "-o", model, "--method", method]) == 2
    assert not Path(model).exists() and "cannot be told from" in capsys.readouterr().err


@real
def test_more_parameters_of_the_real_printer_do_not_predict_better():
    """What a falling residual hides: lean towers fit best and predict worse."""
    found = importers.run("carriage-steps", STEPS)
    rms = {
        level: crossvalidation.cross_validate(found.data, found.robot, level).rms_pos
        for level in ("firmware4", "firmware6", "tower_lean")
    }
    assert rms["firmware6"] < rms["firmware4"] < 2 * rms["firmware6"] and rms["tower_lean"] > rms["firmware6"]


@real
def test_real_printer_gets_its_configuration_back(tmp_path, capsys):
    data, robot, model = (str(tmp_path / name) for name in ("d.csv", "r.toml", "m.toml"))
    assert main(["import", "carriage-steps", str(STEPS), "-o", data, "--robot-output", robot]) == 0
    assert main(["fit", data, "--robot", robot, "--level", "firmware6", "-o", model, "--folds", "6"]) == 0
    assert "absolute scale is weak" in capsys.readouterr().out
    assert main(["firmware", model]) == 0
    said = capsys.readouterr().out
    assert "delta_radius: 173.5" in said and "M665 L" in said and "three upright towers" in said
    # As a firmware would apply them: the same steps, counted from the new endstops, put every contact on the bed.
    from pcalib import modelfile

    arms = firmware.configuration(modelfile.load(model)).arms
    heights = arms.nozzle(importers.run("carriage-steps", STEPS).data.q)[:, 2]
    assert np.sqrt(np.mean(heights**2)) * 1e6 == pytest.approx(39, abs=2)


@real
def test_real_platform():
    """Nominal 50 mm; full geometry below 0.5 mm at poses not fitted; what is not supported is said; nothing absurd."""
    found = importers.run("motion-capture", CAPTURE)
    rod = {
        level: crossvalidation.cross_validate(found.data, found.robot, level, 6).rms_rod
        for level in ("nominal", "classical", "complete")
    }
    assert rod["nominal"] == pytest.approx(50.5e-3, abs=0.5e-3)
    assert rod["classical"] < 2.5e-3
    assert rod["complete"] <= 0.50e-3
    fit = identification.fit(found.data, found.robot)
    assert fit.status == "converged" and 0.8 < fit.accuracy.chi2_dof < 1.3
    said = [doubt.sentence() for doubt in trust.doubts(fit, found.data)]
    assert said and all("far beyond any tolerance" in text for text in said)
    # Beside the capture's frames, which may lie anywhere, joints are millimetres from the drawing.
    mechanism = found.robot.mechanism
    U, _, _ = np.linalg.svd(mechanism.rigid_motions, full_matrices=False)
    change = fit.candidate.errors
    joints = [i for i, name in enumerate(mechanism.parameters) if name[0] in "pb"]
    assert np.abs(change - U @ (U.T @ change))[joints].max() < 15e-3
    travel = fit.candidate.k[[mechanism.index(f"s{i}") for i in range(1, 7)]]
    assert np.abs(travel - 1).max() < 0.07


def test_bed_contacts_are_compared_and_shown_like_any_data(tmp_path):
    """Heights alone: the map stands where the model puts the contacts, and only heights can be off."""
    from pcalib.diagnosis import recording

    points = bed_points(20, 85.0)
    noise = 9e-3 * np.random.default_rng(0).standard_normal(20)
    found = importers.run("carriage-steps", write(tmp_path / "s.csv", contact_steps(points, noise)), SETTINGS)
    ladder = recording.story(identification.fit(found.data, found.robot, "firmware4").model, found.data)
    (shown,) = ladder.maps
    assert np.abs(shown.targets[:, :2] - 1e-3 * points).max() < 1e-3
    assert not shown.errors[..., :2].any() and (shown.status == "ok").all()
    assert 3e-6 < ladder.rms[-1, 0] <= ladder.rms[0, 0]


def test_commands_of_a_platform_go_out_in_revolutions(tmp_path):
    text = (Path(__file__).parents[1] / "models" / "hexapod.toml").read_text()
    text = text.replace("[joints] ", "leg_travel_mm_rev = [70.0, 70.0, 70.0, 70.0, 70.0, 70.0]\n[joints] ")
    text = text.replace("min_mm = -120.0", "min_rev = -2").replace("max_mm = 120.0", "max_rev = 2")
    (tmp_path / "r.toml").write_text(text)
    robot = robots.load(tmp_path / "r.toml")
    plan, targets, commands = (tmp_path / name for name in ("plan.csv", "t.csv", "c.csv"))
    assert main(["plan", "--robot", str(tmp_path / "r.toml"), "-n", "10", "-o", str(plan)]) == 0
    assert "q1_rev,q2_rev" in plan.read_text()
    from pcalib import modelfile
    from pcalib.data.targets import load_commands
    from pcalib.model import Model

    modelfile.save(tmp_path / "m.toml", Model.nominal(robot), {})
    targets.write_text("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n10,20,460,3,-2,5\n0,0,450,0,0,0\n")
    assert main(["compensate", str(targets), "--model", str(tmp_path / "m.toml"), "-o", str(commands)]) == 0
    assert "q6_rev" in commands.read_text()
    q, status = load_commands(commands, robot)
    pose = kinematics.forward(robot.mechanism, robot.mechanism.nominal, q).pose
    assert list(status) == ["ok", "ok"]
    assert pose.x * 1e3 == pytest.approx(np.array([[10, 20, 460.0], [0, 0, 450]]), abs=1e-9)
    assert np.degrees(rotation.log(pose.R)) == pytest.approx(np.array([[3, -2, 5.0], [0, 0, 0]]), abs=1e-9)


@real
def test_a_platform_whose_leg_zeros_nobody_knows_is_fitted_with_a_warning(tmp_path, capsys):
    from pcalib.cli import main

    data, robot, model = (str(tmp_path / name) for name in ("d.csv", "r.toml", "m.toml"))
    assert main(["import", "motion-capture", str(CAPTURE), "-o", data, "--robot-output", robot]) == 0
    capsys.readouterr()
    assert main(["fit", data, "--robot", robot, "-o", model]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Far from the drawing") and Path(model).exists()


CONTACTS = np.array([[x, y, 0.01 * x - 0.02 * y + 0.1] for x in (-40.0, 0.0, 40.0) for y in (-40.0, 0.0, 40.0)])
LOGS = {
    "plain": "\n".join(f"{x},{y},{z}" for x, y, z in CONTACTS),
    "klipper": "Send: G29\n" + "\n".join(f"Recv: // probe at {x:.3f},{y:.3f} is z={z:.6f}" for x, y, z in CONTACTS),
    "marlin": "echo:busy\n" + "\n".join(f"Recv: Bed X: {x:.3f} Y: {y:.3f} Z: {z:.4f}" for x, y, z in CONTACTS) + "\nok",
    "reprapfirmware": "RepRapFirmware height map file v2 generated at 2026-01-01\n"
    "xmin,xmax,ymin,ymax,radius,xspacing,yspacing,xnum,ynum\n-40.0,40.0,-40.0,40.0,-1.0,40.0,40.0,3,3\n"
    + "\n".join(", ".join(f"{0.01 * x - 0.02 * y + 0.1:.4f}" for x in (-40, 0, 40)) for y in (-40, 0, 40)),
}


@pytest.mark.parametrize("name", LOGS)
def test_what_firmware_prints_is_a_bed_that_was_probed(tmp_path, name):
    (tmp_path / "plain.csv").write_text(LOGS["plain"])
    (tmp_path / "log.txt").write_text(LOGS[name])
    plain, found = (importers.run("bed-heights", tmp_path / file) for file in ("plain.csv", "log.txt"))
    order = [np.lexsort(np.round(one.data.q, 6).T) for one in (plain, found)]
    assert np.allclose(plain.data.q[order[0]], found.data.q[order[1]], atol=1e-9)


def test_a_broken_height_map_is_refused(tmp_path):
    (tmp_path / "h.csv").write_text("RepRapFirmware height map file v2\nxmin\n1,2\n0.1, 0.2\n")
    with pytest.raises(InputError, match="is not x, y and z"):
        importers.run("bed-heights", tmp_path / "h.csv")
