"""From what sensors read to a calibrated robot: the virtual robot's sensors, pcalib's fit, and MuJoCo's landing."""

from dataclasses import replace

import numpy as np
import pytest

from bench import plan as plans
from bench import simulate
from bench import truth as truths
from bench.jobs import instruments
from bench.jobs.alignment import align
from bench.kinds import MODELS
from pcalib import compensation, modelfile
from pcalib.changes.search import changes
from pcalib.data import measurement
from pcalib.diagnosis.compare import compare
from pcalib.diagnosis.diagnose import diagnose
from pcalib.diagnosis.steps import add
from pcalib.errors import InputError
from pcalib.fitting import drawing, identification, linearisation, mixups
from pcalib.fitting.result import Code
from pcalib.fitting.unknowns import apply, unknowns_of
from pcalib.model import Conditions, Model
from pcalib.uncertainty import radius
from pcalib.uncertainty.discrepancy import assessed
from pcalib.uncertainty.outlook import outlook, sentence, to_json
from pcalib.uncertainty.propagation import beside_a_frame
from pcalib.workspace import reachable

SENSORS = """[sensors.ballbar]
sigma_um = 2
stations_mm = [300, 0, -1050, -200, 250, -1050, -150, -280, -1050]
[sensors.inclinometer]
sigma_urad = 20
zero_mrad = [3, -2]
level_mrad = [1, 2]
turn_deg = 1.5
[sensors.dial_gauge]
place_mm = [0, 0, -1100]
slope = [0.01, -0.02]
"""
TOOLS = [np.zeros(3), np.array([0.0, 0.0, -0.15])]


def measured(kind="none", n=60, check=0, fault="", sensors=SENSORS, seed=3, plan="random", frame="base"):
    text = (
        f'robot = "{MODELS / "delta.toml"}"\n[geometry]\nsigma_length_mm = 0.2\nsigma_angle_deg = 0.05\nseed = {seed}\n'
        f'[instrument]\nkind = "{kind}"\nframe = "{frame}"\nsigma_pos_um = 15\nsigma_rot_urad = 60\n{sensors}{fault}'
    )
    truth = truths.parse(text)
    plan = plans.make(truth.robot, plan, n, check=check, tools=TOOLS, seed=seed)
    return truth, simulate.run(truth, plan, seed).measurements


@pytest.mark.parametrize("case", instruments.CASES[:1], ids=lambda c: c.name)
def test_a_robot_calibrated_with_a_ballbar_lands(case):
    assert instruments.one(case, 7) < case.within


@pytest.mark.parametrize("kind, frame", [("none", "base"), ("pose", "tracker")])
def test_residuals_and_columns_belong_together(kind, frame, delta):
    _, data = measured(kind, n=12, frame=frame)
    assert {"distance", "inclinometer", "probe"} <= set(data.readings.sensor)
    model = linearisation.seen_from(Model.nominal(delta), data)
    model = model.with_geometry(model.k + 1e-4 * np.random.default_rng(0).standard_normal(len(model.k)))
    unknowns = unknowns_of(model, "complete", frame=frame == "tracker")
    linear = linearisation.linearise(model, data, unknowns)
    sigma = data.sigma[linear.row, linear.component]
    h = 1e-2 * unknowns.scale
    for j in range(len(unknowns.names)):
        step = h[j] * np.eye(len(unknowns.names))[j]
        ahead, back = (linearisation.residuals(apply(model, unknowns, s), data)[0] for s in (step, -step))
        slope = (back - ahead)[linear.row, linear.component] / (2 * h[j])
        size = max(1.0, np.abs(slope).max())
        off = np.abs(slope - linear.jacobian[:, j] * sigma)
        sensed = data.readings.sensor[linear.row] != ""
        assert off[sensed].max() < 2e-6 * size, unknowns.names[j]


def test_a_fit_finds_the_set_up_and_the_file_says_so(tmp_path, delta):
    _, data = measured(n=80)
    measurement.save(tmp_path / "data.csv", data)
    again = measurement.load(tmp_path / "data.csv", delta)
    fit = identification.fit(again, delta)
    assert fit.status == "converged" and fit.accuracy.at_the_noise
    modelfile.save(tmp_path / "m.toml", fit.model)
    model = modelfile.load(tmp_path / "m.toml")
    assert [b.name for b in model.setup] == [b.name for b in fit.model.setup]
    for a, b in zip(model.setup, fit.model.setup, strict=True):
        assert a.parameters == b.parameters and np.allclose(a.theta, b.theta, rtol=1e-12)
    place = {b.name: b.theta for b in model.setup}
    assert np.linalg.norm(place["station A"] - [0.3, 0, -1.05]) < 2e-3  # the base itself is known no better
    assert compare(model, again).times_noise[0] < 1.2


def test_a_hidden_effect_is_found_and_added(delta):
    fault = "[faults.drive_compliance]\ncompliance_urad_Nm = 30\n"
    _, data = measured(n=100, check=20, fault=fault, plan="rich", sensors=SENSORS.partition("[sensors.dial")[0])
    fit = identification.fit(data, delta)
    found = diagnose(fit.model, data)
    assert ["drive_compliance"] in [[member.name for member in chosen.members] for chosen in found.sets]
    step = add(fit.model, data, "drive_compliance")
    assert step.after.accuracy.at_the_noise
    value = step.after.candidate.effects[0]
    assert abs(value.theta[0] - 30e-6) < 4 * value.sigma[0]


def test_readings_beside_poses_sharpen_a_fit(delta):
    _, both = measured("position", n=40)
    alone = both.take(both.readings.sensor == "")
    a, b = (identification.fit(data, delta).covariance for data in (alone, both))
    geometry = slice(0, len(delta.mechanism.nominal))
    assert np.trace(b[geometry, geometry]) < 0.7 * np.trace(a[geometry, geometry])


def test_a_station_with_too_few_readings_is_named(delta):
    _, data = measured(n=40)
    station = (data.readings.sensor == "distance") & (data.readings.to == "C")
    few = data.take(np.flatnonzero(~station | (np.cumsum(station) <= 2)))
    with pytest.raises(InputError, match="2 readings to station C, which has 3 unknowns"):
        identification.fit(few, delta)


def test_a_model_that_knows_no_set_up_says_so(delta):
    _, data = measured(n=12)
    with pytest.raises(InputError, match="does not know station A"):
        linearisation.residuals(Model.nominal(delta), data)


@pytest.mark.parametrize("axes", [True, False])
def test_a_sigma_that_is_not_alike_along_all_axes_is_told(axes, delta):
    case = instruments.CASES[-2 if axes else -1]
    truth = instruments.truth_of(case, 3)
    fit = identification.fit(simulate.run(truth, instruments.plan_of(case, delta, 3), 3).measurements, delta)
    told = [c.text for c in fit.warnings if c.code is Code.SIGMA_UNEVEN]
    assert bool(told) is not axes
    if told:
        assert "tracker's z axis are" in told[0] and "# sigma_z_mm" in told[0]


def test_a_later_session_with_the_same_stations_has_not_changed(delta):
    truth, data = measured(n=80)
    model = assessed(identification.fit(data, delta))
    plan = plans.make(truth.robot, "random", 40, tools=TOOLS, seed=99)
    again = simulate.run(truth, plan, 99).measurements
    assert not changes(model, again).sets
    moved = replace(truth, errors=truth.errors + 3e-4 * (np.array(delta.mechanism.parameters) == "l11"))
    found = changes(model, simulate.run(moved, plan, 99).measurements)
    assert ("l11",) in [chosen.names for chosen in found.sets]


def test_what_to_expect_is_said_beside_a_frame_that_is_taught(delta):
    case = instruments.CASES[0]
    truth = instruments.truth_of(case, 11)
    data = simulate.run(truth, instruments.plan_of(case, delta, 11), 11).measurements
    model = assessed(identification.fit(data, delta))
    found = outlook(model, instruments.LONG)
    assert found.taught is not None and found.taught < 30e-6 < found.u95
    assert "once the cell's frame is taught" in sentence(found) and to_json(found)["u95_taught_um"] < 30
    wanted = reachable(delta, 40, np.random.default_rng(1)).pose.x + instruments.LONG
    conditions = Conditions.of(40, instruments.LONG)
    q = compensation.compensate(model, wanted, conditions=conditions, limits=False).q
    stated = radius.containing(beside_a_frame(model, q, conditions))
    landed = truth.machine().land(q, instruments.LONG)
    miss = np.linalg.norm(align(landed.tcp[None], wanted)[0] - wanted, axis=1)[landed.ok]
    assert np.mean(miss < stated[landed.ok]) > 0.8


@pytest.fixture(scope="module")
def gauge(tmp_path_factory):
    """A file of distances between the two poses of every pair, from where MuJoCo lands, 3 µm."""
    truth = instruments.truth_of(instruments.CASES[0], 21)
    plan = plans.make(truth.robot, "random", 160, tools=TOOLS, seed=5)
    landed = truth.machine().run(plan.commands)
    rng = np.random.default_rng(2)
    lines = ["# sigma_distance_um = 3", "q1_deg,q2_deg,q3_deg,tool_x_mm,tool_y_mm,tool_z_mm,pose_id,distance_mm,from"]
    for i, (q, tool, x) in enumerate(zip(plan.commands.q, plan.commands.tool, landed.tcp, strict=True)):
        d = 1e3 * (np.linalg.norm(x - landed.tcp[i - 1]) + 3e-6 * rng.standard_normal()) if i else None
        said = f"{d:.6f},P{i - 1}" if i else ","
        lines.append(",".join(f"{v:.12g}" for v in (*np.degrees(q), *(1e3 * tool))) + f",P{i},{said}")
    path = tmp_path_factory.mktemp("gauge") / "gauge.csv"
    path.write_text("\n".join(lines))
    return truth, path


def test_distances_between_poses_calibrate_a_robot(gauge, delta):
    truth, path = gauge
    data = measurement.load(path, delta)
    assert set(data.readings.sensor) == {"", "pose_distance"} and data.mask.sum() == 159
    first = np.flatnonzero(data.readings.sensor == "pose_distance")[0]
    assert np.degrees(data.q[data.readings.origin[first]]) @ [1, 0, 0] == pytest.approx(np.degrees(data.q[0, 0]))
    fit = identification.fit(data, delta)
    assert fit.status == "converged" and fit.accuracy.at_the_noise and not fit.model.setup
    assert instruments.landed(truth, data, 3) < 25e-6


def test_columns_of_distances_between_poses_are_those_of_differences(gauge, delta):
    data = measurement.load(gauge[1], delta).take(slice(0, 24))
    model = Model.nominal(delta)
    unknowns = unknowns_of(model, "complete")
    linear = linearisation.linearise(model, data, unknowns)
    h = 1e-2 * unknowns.scale
    for j in range(0, len(h), 7):
        step = h[j] * np.eye(len(h))[j]
        ahead, back = (linearisation.residuals(apply(model, unknowns, s), data)[0] for s in (step, -step))
        slope = (back - ahead)[linear.row, linear.component] / (2 * h[j])
        off = np.abs(slope - linear.jacobian[:, j] * data.sigma[linear.row, linear.component])
        assert off.max() < 2e-6 * max(1.0, np.abs(slope).max()), unknowns.names[j]


def test_a_distance_whose_other_pose_is_not_there_counts_nothing(gauge, delta, tmp_path):
    data = measurement.load(gauge[1], delta)
    some = data.take(np.arange(10, 60))
    assert some.readings.orphan.sum() == some.mask.shape[0] - some.mask.sum() - np.sum(some.readings.sensor == "")
    measurement.save(tmp_path / "again.csv", data)
    again = measurement.load(tmp_path / "again.csv", delta)
    assert np.array_equal(again.readings.origin, data.readings.origin) and np.array_equal(again.mask, data.mask)


def test_a_pose_that_is_not_there_is_named(gauge, delta, tmp_path):
    (tmp_path / "bad.csv").write_text(gauge[1].read_text().replace(",P7\n", ",P777\n", 1))
    with pytest.raises(InputError, match="there is no pose 'P777'"):
        measurement.load(tmp_path / "bad.csv", delta)


@pytest.mark.parametrize("seed", [0, 1])
def test_readings_of_stations_in_turn_are_not_far_from_the_drawing(seed):
    """Three stations and an inclinometer take turns: rows that are evenly spaced would all be of one station."""
    truth, data = measured("none", 59, seed=seed)
    data = data.take(np.flatnonzero(data.readings.sensor != "probe"))
    taken = drawing.some_rows(data).readings.parts
    assert len(taken) == 4 and all(len(rows) >= 8 for *_, rows in taken)
    found = mixups.judge(data, truth.robot)
    assert not found.far and not found.named
    assert found.distance is not None and found.distance.near
