"""What a first user met: gross rows, rows in another unit, command files taken for measurements, joined files."""

from dataclasses import replace

import numpy as np
import pytest

from pcalib import cli, compensation
from pcalib import robot as robots
from pcalib.data import joining, measurement, table
from pcalib.fitting import as_drawn, identification
from pcalib.model import Model
from pcalib.rotation import exp
from pcalib.uncertainty import assessed
from pcalib.uncertainty.outlook import outlook

TURN = exp(np.array([0.2, -0.1, 2.0]))


@pytest.fixture(scope="module")
def data(delta, perturb, measure):
    """50 poses in a tracker's frame, of which the last ten are held out."""
    check = np.arange(50) >= 40
    found = measure(Model(delta, perturb(1), "complete"), 50, check=check)
    position = found.position @ TURN.T + [2.0, 1.0, 0.3]
    return replace(found, frame="tracker", position=position, rotation=TURN @ found.rotation)


@pytest.fixture
def run(tmp_path, delta, monkeypatch, capfd):
    """A function that runs a command in a folder with the robot file, and gives its exit code and all that it says."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "delta.toml").write_text(delta.text)

    def call(command):
        code = cli.main(command.split())
        said = capfd.readouterr()
        return code, said.out + said.err

    return call


@pytest.mark.parametrize("spoil", [lambda x: 1e6 * x, lambda x: x / 25.4, lambda x: x * [-1, 1, 1]])
def test_gross_rows_are_named_by_inspect_and_by_fit(data, run, spoil):
    position = data.position.copy()
    position[[4, 17, 30]] = spoil(position[[4, 17, 30]])
    measurement.save("gross.csv", replace(data, position=position))
    lines = "lines {}, {} and {}".format(*measurement.load("gross.csv").lines[[4, 17, 30]])
    assert lines in run("inspect gross.csv --robot delta.toml")[1].replace("\n", " ")
    code, said = run("fit gross.csv --robot delta.toml -o m.toml")
    assert code != 0 and lines in said.replace("\n", " ")


def test_rows_are_told_apart_without_a_registration(data, delta):
    position = data.position.copy()
    position[::4] = position[::4] / 25.4
    found = as_drawn.compare(replace(data, position=position), delta)
    assert set(found.odd) == set(range(0, 50, 4)) and found.typical < 1e-3


def test_held_out_rows_in_another_unit_are_said_to_be_far_off(data, run):
    position = np.where(data.check[:, None], data.position / 25.4, data.position)
    measurement.save("held.csv", replace(data, position=position))
    code, said = run("fit held.csv --robot delta.toml")
    assert code == 0 and "times as far off as the fitted rows" in said.replace("\n", " ")


def test_targets_are_no_measurements(data, run):
    measurement.save("d.csv", data)
    assert run("fit d.csv --robot delta.toml -o m.toml")[0] == 0
    rng = np.random.default_rng(3)
    x, y, z = (rng.uniform(-0.2, 0.2, 20), rng.uniform(-0.2, 0.2, 20), rng.uniform(-0.85, -0.75, 20))
    table.write("t.csv", {"x_mm": 1e3 * x, "y_mm": 1e3 * y, "z_mm": 1e3 * z}, {})
    assert run("compensate t.csv --model m.toml -o c.csv")[0] == 0
    code, said = run("accept c.csv --model m.toml --within 100um")
    assert code == 2 and "nothing in them was measured" in said.replace("\n", " ")


def test_a_tracker_that_was_set_up_anew_is_no_miss_of_the_robot(data, run):
    turn = exp(np.array([0.0, 0.02, 0.4]))
    moved = replace(data, position=data.position @ turn.T + [0.1, -0.2, 0.0], rotation=turn @ data.rotation)
    measurement.save("d.csv", data.take(~data.check))
    again = moved.take(moved.check)
    measurement.save("again.csv", replace(again, check=~again.check))
    assert run("fit d.csv --robot delta.toml -o m.toml")[0] == 0
    code, said = run("accept again.csv --model m.toml --within 150um")
    assert code == 0 and "its frame is found from these rows" in said.replace("\n", " ")
    code, said = run("compare again.csv --model m.toml")
    assert "The tracker was set up anew" in said.replace("\n", " ") and "pcalib changed again.csv" in said
    assert run("accept again.csv --model m.toml --within 1um")[0] == 1


def test_joints_of_a_controller_are_given_the_line_that_reads_them(run, tmp_path):
    (tmp_path / "j.csv").write_text("J1 [deg];J2 [deg];J3 [deg];X [mm];Y [mm];Z [mm];Load [kg]\n1;2;3;4;5;-800;0\n")
    code, said = run("inspect j.csv --robot delta.toml")
    assert code == 2 and "# columns = q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm,Load_kg" in said.replace("\n", "")
    assert "--robot is missing" in run("fit j.csv")[1]


def test_a_column_of_masses_by_another_name_is_asked_about(data, run):
    measurement.save("d.csv", replace(data, payload=np.arange(50) % 3.0))
    text = open("d.csv", encoding="utf-8").read().replace("payload_kg", "Load_kg")
    with open("d.csv", "w", encoding="utf-8") as file:
        file.write(text)
    said = run("inspect d.csv --robot delta.toml")[1].replace("\n", " ").split()
    assert "Is Load_kg the payload? Name that column payload_kg." in " ".join(said)


def test_a_plan_carries_what_the_file_says_of_its_instrument(data):
    text = measurement.instrument_metadata(replace(data, euler="xyz"))
    assert text == {"frame": "tracker", "euler": "xyz"}
    assert measurement.instrument_metadata(replace(data, frame="base")) == {}


def test_rows_without_a_stated_noise_take_that_of_the_others(data):
    silent = replace(data, stated=(False, False), sigma=2 * data.sigma, source="more.csv", euler="xyz")
    joined = joining.join([data, silent])
    assert joined.stated == (True, True)
    assert joined.sigma == pytest.approx(np.concatenate([data.sigma, data.sigma]))
    said = joining.differences([data, silent])
    assert len(said) == 3 and "Euler angles xyz" in said[0] and "more.csv states no σ of positions" in said[1]


def test_a_workspace_that_nobody_stated_refuses_no_target(delta, data):
    start = delta.text.index("[workspace]")
    rest = delta.text[start + 11 :]
    text = delta.text[:start] + (rest[rest.index("\n[") + 1 :] if "\n[" in rest else "")
    found = robots.parse(text)
    assert not found.workspace.stated
    high = np.array([[0.0, 0.0, found.workspace.z_max + 0.02]])
    assert compensation.compensate(Model.nominal(found), high).status.tolist() == ["ok"]


@pytest.mark.parametrize("joints", [[1], [0, 1, 2]])
def test_a_drive_that_counts_the_other_way_is_named_where_values_leave_the_range(data, run, delta, joints):
    sign = np.where(np.isin(np.arange(3), joints), -1.0, 1.0)
    q = np.clip(data.q, np.radians(-59.0), -0.2) * sign
    narrow = "[joints]\nmin_deg = -60\nmax_deg = 0\n"
    before, _, after = delta.text.partition("[joints]")
    with open("narrow.toml", "w") as file:
        file.write(before + narrow + after[after.index("\n[") :])
    measurement.save("turned.csv", replace(data, q=q))
    code, said = run("inspect turned.csv --robot narrow.toml")
    names = ", ".join(f"q{i + 1}_deg" for i in joints)
    assert code == 2 and f"with the other sign all values of {names} are in range" in said.replace("\n", " ")


def test_one_value_out_of_range_is_no_wrong_sign(data, run, delta):
    q = np.clip(data.q, np.radians(-59.0), -0.2)
    q[3, 1] = np.radians(80.0)
    before, _, after = delta.text.partition("[joints]")
    with open("narrow.toml", "w") as file:
        file.write(before + "[joints]\nmin_deg = -60\nmax_deg = 0\n" + after[after.index("\n[") :])
    measurement.save("one.csv", replace(data, q=q))
    code, said = run("inspect one.csv --robot narrow.toml")
    assert code == 2 and "other sign" not in said


def test_diameters_for_all_radii_are_named(data, run, delta):
    robot = robots.parse(delta.text).dimensions
    text = delta.text
    for name in ("base_radius", "plate_radius"):
        text = text.replace(f"{name}_mm = {robot[name] * 1e3:.1f}", f"{name}_mm = {robot[name] * 2e3:.1f}")
    assert text != delta.text
    with open("wide.toml", "w") as file:
        file.write(text)
    measurement.save("d.csv", data)
    said = run("inspect d.csv --robot wide.toml")[1].replace("\n", " ")
    assert "base radius and plate radius are diameters" in said


def test_measurements_are_no_targets(data, run, delta, perturb):
    from pcalib import modelfile

    modelfile.save("m.toml", Model(delta, perturb(1), "complete"))
    measurement.save("d.csv", data)
    code, said = run("compensate d.csv --model m.toml -o c.csv")
    assert code == 2 and "a measurement file: it holds commands" in said.replace("\n", " ")


@pytest.mark.parametrize("size", [2e-3, 2e-2])
def test_a_gross_row_in_a_robust_fit_does_not_widen_what_to_expect(data, delta, size):
    position = data.position.copy()
    position[7, 0] += size
    right = outlook(assessed(identification.fit(data, delta)))
    robust = outlook(assessed(identification.fit(replace(data, position=position), delta, loss="huber")))
    plain = outlook(assessed(identification.fit(replace(data, position=position), delta)))
    assert robust.taught == pytest.approx(right.taught, rel=0.25)
    assert plain.taught > 3 * right.taught


def test_a_file_of_held_out_rows_alone_is_accepted(data, run):
    measurement.save("all.csv", data)
    measurement.save("held.csv", replace(data, check=np.ones(len(data), bool)))
    assert run("fit all.csv --robot delta.toml -o m.toml")[0] == 0
    code, said = run("accept held.csv --model m.toml --within 500um")
    assert code == 0 and said.startswith("Pass") and "No row is held out" not in said


def test_what_groups_thousands_is_said_to_be_in_the_way(data, run, tmp_path):
    measurement.save("d.csv", data)
    text = (tmp_path / "d.csv").read_text().replace(",", ";").replace(".", ",")
    lines = text.splitlines()
    lines[-1] = "2.400,5;" + lines[-1].partition(";")[2]
    (tmp_path / "d.csv").write_text("\n".join(lines) + "\n")
    code, said = run("inspect d.csv --robot delta.toml")
    assert code == 2 and "leave out what groups the thousands" in said
    metadata = [line for line in text.splitlines() if line.startswith("#") and "sigma" not in line]
    rows = [line for line in text.splitlines() if not line.startswith("#")]
    (tmp_path / "d.csv").write_text("\n".join(["# sigma_pos_mm = 0,03", *metadata, *rows]) + "\n")
    assert measurement.load("d.csv").sigma[0, 0] == pytest.approx(3e-5)


def test_options_that_do_not_go_together_are_refused(run):
    for option in ("--repeat", "--check"):
        code, said = run(f"plan --to-tell --robot delta.toml -n 24 {option} 3 -o p.csv")
        assert code == 2 and f"{option} does not go with --to-tell" in said


def test_a_file_that_fit_refuses_is_not_sent_to_fit(data, run):
    measurement.save("rows.csv", replace(data, q=np.roll(data.q, 1, axis=0)))
    assert "Next: pcalib fit" not in run("inspect rows.csv --robot delta.toml")[1]
    assert run("fit rows.csv --robot delta.toml")[0] != 0
    measurement.save("right.csv", data)
    assert "Next: pcalib fit" in run("inspect right.csv --robot delta.toml")[1]


def test_small_misfits_lead_to_a_diagnosis(data, run):
    """What is little more than the noise is more than chance, and may grow with another tool."""
    measurement.save("right.csv", data)
    assert "pcalib compensate" in run("fit right.csv --robot delta.toml -o m.toml")[1]
    error = 2.0e-5 * np.random.default_rng(5).standard_normal(data.position.shape)
    measurement.save("more.csv", replace(data, position=data.position + 0.7 * error))
    code, said = run("fit more.csv --robot delta.toml -o m.toml")
    assert code == 0 and "pcalib diagnose more.csv" in said, said
