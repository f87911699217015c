"""Findings about measurement files: each appears when its cause is there, and not on a good file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import inspection, planning, robot, rotation
from pcalib.cli.frame import plain
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.mechanics import kinematics

DELTA = robot.load(Path(__file__).resolve().parents[1] / "models" / "delta.toml")


def good(**changes) -> Measurements:
    """25 poses measured twice, with all that a later step could wish for, in random order of conditions."""
    rng = np.random.default_rng(5)
    poses = planning.reachable(DELTA, 25, rng)
    q = np.repeat(poses.q, 2, axis=0)
    n = len(q)
    tool = np.array([[0.0, 0, -0.1], [0.05, 0, -0.1], [0, 0.05, -0.1]])[np.repeat(rng.integers(0, 3, 25), 2)]
    pose = kinematics.forward(DELTA.mechanism, DELTA.mechanism.nominal, q).pose
    columns = {
        "temp": np.repeat(rng.uniform(18, 30, 25), 2), "time": np.arange(n) * 30.0,
        **{f"dir{i}": np.repeat(rng.choice([-1.0, 1.0], 25), 2) for i in (1, 2, 3)},
    }  # fmt: skip
    columns |= dict.fromkeys(("temp_arms", "temp_rods", "temp_base"), columns["temp"])
    options = {
        "tool": tool, "payload": np.repeat(rng.integers(0, 3, 25), 2) * 1.0, "columns": columns,
        "pose_id": np.arange(n) // 2, "check": np.repeat(np.arange(25) % 5 == 0, 2),
        "sigma_pos": 2e-5, "sigma_rot": 6e-5,
    }  # fmt: skip
    return Measurements.create(
        DELTA, q, pose.tcp(tool) + 2e-5 * rng.standard_normal((n, 3)),
        rotation.exp(6e-5 * rng.standard_normal((n, 3))) @ pose.R, **(options | changes),
    )  # fmt: skip


def codes(data, described: robot.Robot | None = DELTA, level=None):
    return {f.code for f in inspection.inspect(data, described).findings if level in (None, f.level)}


def test_a_good_file_has_nothing_to_be_said_against():
    result = inspection.inspect(good(), DELTA)
    assert result.findings == () and result.errors == ()
    facts = result.facts
    assert (facts["rows"], facts["fit"], facts["check"], facts["readings"]) == (50, 40, 10, 300)
    assert facts["measured"] == {"full_pose": 50, "position_only": 0, "partial": 0, "nothing": 0}
    assert facts["replicates"]["groups"] == 25 and facts["replicates"]["verified"]
    assert facts["nominal"]["rms_pos_um"] == pytest.approx(2e-5 * 3**0.5 * 1e6, rel=0.2)
    assert sum(p["rows"] for p in facts["payloads"]) == 50
    assert facts["joints"][0]["share_of_range"] == pytest.approx(np.ptp(good().q[:, 0]) / np.deg2rad(105))


def without(*names):
    return {k: v for k, v in good().columns.items() if k not in names}


def moved(column, values):
    return {**good().columns, column: values}


TEMPERATURES = ("temp", "temp_arms", "temp_rods", "temp_base")
RISING = 20 + np.arange(50) * 0.1
FINDINGS = {
    "nothing_measured": lambda: good_with(position=np.full((50, 3), np.nan), rotation=np.full((50, 3, 3), np.nan)),
    "empty_rows": lambda: blanked(3),
    "nothing_to_fit": lambda: good(check=np.ones(50, bool)),
    "one_pose": lambda: good().take(slice(2, 4)),
    "few_readings": lambda: good().take(slice(0, 20)),
    "no_check_rows": lambda: good(check=np.zeros(50, bool)),
    "leak": lambda: good(check=np.arange(50) % 2 == 0),
    "position_only": lambda: good_with(rotation=np.full((50, 3, 3), np.nan), tool=np.zeros((50, 3))),
    "equal_columns": lambda: replace(good(), q=good().q[:, [0, 0, 2]]),
    "tiny_joints": lambda: replace(good(), q=np.deg2rad(good().q)),
    "narrow_joints": lambda: replace(good(), q=good().q * [1, 1, 0.2]),
    "no_payload_variation": lambda: good(payload=1.0),
    "no_direction": lambda: good(columns=without("dir1", "dir2", "dir3")),
    "one_direction": lambda: good(columns=moved("dir2", np.ones(50))),
    "no_temperature": lambda: good(columns=without(*TEMPERATURES)),
    "constant_temperature": lambda: good(columns={**good().columns, **dict.fromkeys(TEMPERATURES, np.full(50, 25.0))}),
    "equal_temperatures": lambda: good(columns=without("temp")),
    "no_time": lambda: good(columns=without("time")),
    "temperature_follows_time": lambda: good(columns={**good().columns, **dict.fromkeys(TEMPERATURES, RISING)}),
    "sigma_not_stated": lambda: good(sigma_pos=None),
    "no_replicates": lambda: good(pose_id=None),
    "few_replicates": lambda: good(pose_id=np.where(np.arange(50) < 4, np.arange(50) // 2, -1)),
    "noise_position": lambda: good(sigma_pos=1e-5),
    "noise_rotation": lambda: good(sigma_rot=12e-5),
    "frozen": lambda: good_with(position=np.repeat(good().position[::5], 5, axis=0)),
    "copies": lambda: good().take(np.r_[:50, 49]),
    "odd_sigma": lambda: good(sigma_pos=2e-2),
    "odd_temperature": lambda: good(columns=moved("temp_rods", good().columns["temp"] + 273)),
    "other_robot": lambda: replace(good(), robot_name="gamma"),
    "odd_payload": lambda: good(payload=good().payload * 1000),
    "rotations_zero": lambda: replace(good_with(rotation=np.tile(np.eye(3), (50, 1, 1))), written=np.zeros((50, 3))),
    "odd_rotation": lambda: good_with(rotation=rotation.exp(np.tile([0.5, 0, 0], (50, 1)))),
    "unreachable": lambda: replace(good(), q=np.where(np.arange(50)[:, None] == 7, [1.6, -1.6, -1.6], good().q)),
    "clock_jumps": lambda: good(columns=moved("time", (85800 + 60.0 * np.arange(50)) % 86400)),
    "odd_time": lambda: good(columns=moved("time", 1.7e12 + 6e4 * np.arange(50))),
    "swapped_columns": lambda: replace(good(), q=good().q[:, [1, 0, 2]]),
    "not_aligned": lambda: good_with(position=good().position + [0.05, 0, 0]),
    "far_rows": lambda: good_with(position=good().position + np.where(np.arange(50)[:, None] == 7, 0.1, 0)),
}


def good_with(**values):
    """The good file with measurements replaced, and its mask with them."""
    data = replace(good(), **values)
    mask = ~np.isnan(np.concatenate([data.position, data.rotation[:, 0]], axis=1))
    return replace(data, mask=mask)


def blanked(row):
    position, turn = good().position.copy(), good().rotation.copy()
    position[row], turn[row] = np.nan, np.nan
    return good_with(position=position, rotation=turn)


@pytest.mark.parametrize("code", FINDINGS)
def test_every_lack_is_found(code):
    result = inspection.inspect(FINDINGS[code](), DELTA)
    found = {f.code: f for f in result.findings}
    assert code in found
    assert found[code].message.endswith((".", "?"))
    assert (found[code].level == "error") == (code in ("nothing_measured", "nothing_to_fit", "swapped_columns"))
    json.dumps(plain(result.to_json()), allow_nan=False)
    order = ["error", "warning", "note"]
    assert [f.level for f in result.findings] == sorted((f.level for f in result.findings), key=order.index)


def test_each_sigma_is_stated_or_assumed_by_itself():
    result = inspection.inspect(good(sigma_rot=None), DELTA)
    found = {f.code: f.message for f in result.findings}
    assert "σ of rotations (# sigma_rot_deg):" in found["sigma_not_stated"]
    sigma = result.facts["sigma"]
    assert (sigma["stated"], sigma["pos_stated"], sigma["rot_stated"]) == (False, True, False)
    noisy = good(sigma_rot=None, sigma_pos=4e-6)
    found = {f.code: f.message for f in inspection.inspect(noisy, DELTA).findings}
    assert "times the stated σ" in found["noise_position"]
    alone = inspection.inspect(good_with(rotation=np.full((50, 3, 3), np.nan), stated=(True, False)), DELTA)
    assert alone.facts["sigma"]["rot_stated"] is None and "sigma_not_stated" not in {f.code for f in alone.findings}


def test_repeated_commands_that_no_pose_id_joins_are_named():
    found = {f.code: f.message for f in inspection.inspect(good(pose_id=None), DELTA).findings}
    assert found["no_replicates"].startswith("50 rows repeat a command, but no pose_id says")
    once = good(pose_id=None).take(slice(0, 50, 2))
    found = {f.code: f.message for f in inspection.inspect(once, DELTA).findings}
    assert found["no_replicates"].startswith("No replicates (pose_id)")


def test_messages_name_lines():
    data = FINDINGS["far_rows"]()
    (finding,) = [f for f in inspection.inspect(data, DELTA).findings if f.code == "far_rows"]
    assert f"line {data.lines[7]}." in finding.message
    (empty,) = [f for f in inspection.inspect(blanked(slice(0, 7)), DELTA).findings if f.code == "empty_rows"]
    assert empty.message == "No measurement in lines 1, 2, 3, 4, 5 and 2 more."


def test_without_a_robot_the_rest_is_still_said():
    assert codes(good(), None) == set()
    assert codes(good(payload=0.0), None) == {"no_payload_variation"}
    assert np.isnan(inspection.inspect(good(), None).facts["joints"][0]["share_of_range"])


def test_a_tracker_frame_is_compared_after_registration():
    turn = rotation.exp(np.array([0.5, 1.0, -2.0]))
    position = good().position @ turn.T + [4, 2, 1]
    assert codes(replace(good(), position=position, rotation=turn @ good().rotation, frame="tracker")) == set()


def test_false_alarms_about_the_noise_are_rare():
    rng = np.random.default_rng(0)
    alarms = 0
    for _ in range(300):
        noisy = good()
        shifted = np.repeat(noisy.position[::2], 2, axis=0) + 2e-5 * rng.standard_normal((50, 3))
        alarms += "noise_position" in codes(replace(noisy, position=shifted), None)
    assert alarms <= 3  # p < 0.001 each: 0.3 expected


def test_what_sensors_leave_open_is_said(tmp_path):
    head = "# sigma_distance_um = 2\nq1_deg,q2_deg,q3_deg,distance_mm,station\n"
    rows = [f"{-i},{-2 * i},{i % 7},{200 + i},{'B' if i > 11 else 'A'}" for i in range(15)]
    (tmp_path / "d.csv").write_text(head + "\n".join(rows))
    found = {f.code: f for f in inspection.inspect(measurement.load(tmp_path / "d.csv", DELTA), DELTA).findings}
    assert "base_unknown" in found
    assert "Station B has 3 readings to fit and 3 unknowns" in found["few_to_station"].message


def test_one_landing_is_told_without_a_longer_tool():
    """Where the plate cannot turn, tools of all lengths land alike, and a forecast has one line."""
    facts = inspection.inspect(good(), DELTA).facts
    one = {"landings": [{"tool_mm": 0.0, "u95_um": 12.0}]}
    assert dict(inspection.words({**facts, "forecast": one}))["a fit lets land within"] == "12.0 µm at the plate (95 %)"
