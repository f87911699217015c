"""Data sets with a right answer, made by simulators that share nothing with this project."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from pcalib import modelfile
from pcalib import robot as robots
from pcalib.data import measurement
from pcalib.diagnosis import advice, telling
from pcalib.diagnosis.diagnose import Diagnosis, diagnose
from pcalib.diagnosis.verdict import Against, Doubt
from pcalib.fitting import identification
from pcalib.model import Model

CASES = Path(__file__).parent / "cases"


def fitted(name: str, robot: str, level: str = "complete", **options) -> Model:
    nominal = robots.load(CASES / f"{robot}.toml")
    return identification.fit(measurement.load(CASES / f"{name}.csv", nominal), nominal, level, **options).model


@cache
def diagnosed(name: str, robot: str = "delta_a", level: str = "complete") -> Diagnosis:
    model = fitted(name, robot, level)
    return diagnose(model, measurement.load(CASES / f"{name}.csv", model.robot))


def judged(model: Model, name: str) -> Diagnosis:
    return diagnose(model, measurement.load(CASES / f"{name}.csv", model.robot))


def test_a_true_effect_that_nothing_confirmed_is_not_established():
    found = diagnosed("nocheck")
    assert found.verdict == "ambiguous" and not found.established
    assert [e.names for e in found.sets] == [("backlash",)] and Doubt.NOTHING_HELD_OUT in found.sets[0].doubts
    assert "no rows are held out" in telling.sentence(found)


def test_the_model_of_another_robot_does_not_fit():
    found = judged(fitted("n12_0", "delta_a"), "temp_split1")
    assert found.verdict == "unexplained" and found.given.against[0] is Against.STALE
    assert telling.sentence(found).startswith("The model does not fit these data as it stands: 4")


def test_a_model_of_a_session_before_an_endstop_slipped():
    found = judged(modelfile.load(CASES / "first_session.toml"), "second_session")
    assert found.verdict == "unexplained" and 40 < found.given.fit < 45


def test_outliers_that_bent_the_model_are_said_to_have_bent_it():
    found = diagnosed("outl4")
    assert found.verdict == "unexplained" and len(found.problem.outliers.rows) == 3
    assert "--loss huber" in telling.sentence(found)
    model = fitted("outl4", "delta_a", loss="huber")
    assert judged(model, "outl4").verdict == "nothing_missing"


@pytest.mark.parametrize(("name", "condition"), [("payload_split2", "payload"), ("temp_split1", "temperature")])
def test_what_only_held_out_rows_show_is_missing(name, condition):
    found = diagnosed(name)
    assert found.verdict != "nothing_missing" and Against.HELD_OUT in found.given.against
    assert condition in telling.sentence(found).partition(". Something")[0]


def test_contacts_of_a_level_bed_are_noise():
    assert diagnosed("bed_level", "printer", "firmware6").verdict == "nothing_missing"


def test_contacts_of_a_tilted_bed_show_the_level_that_tilts():
    found = diagnosed("bed_tilted", "printer", "firmware6")
    assert [e.names for e in found.sets] == [("tower_lean",)]
    assert judged(fitted("bed_tilted", "printer", "tower_lean"), "bed_tilted").verdict == "nothing_missing"


def test_rods_of_another_length_are_named_before_levels_that_fit_anything():
    """The robot file has rods that are 5 mm too long. Thirty parameters more fit 40 heights as well, and no others."""
    found = diagnosed("rod_5mm", "rod_5mm", "firmware6")
    assert found.verdict == "ambiguous" and found.sets[0].names == ("firmware7",)
    assert telling.sentence(found).endswith("firmware7 or complete. These poses cannot tell which.")
    model = fitted("rod_5mm", "rod_5mm", "firmware7")
    level = model.robot.mechanism.levels["firmware7"]
    rod = level.coordinates(model.errors)[level.columns.index("rod.length")]
    assert abs(rod + 4.88e-3) < 0.5e-3  # m; 5 mm are right


def test_towers_that_lean_and_a_rod_that_is_too_long_tilt_a_plate_alike():
    """One rod pair is unequal; heights probed beside the nozzle cannot tell it from towers that lean."""
    found = diagnosed("rod_pair", "linear", "firmware6")
    assert found.verdict == "ambiguous" and not found.established
    named = [e.names for e in found.sets]
    assert ("tower_lean",) in named and {("l11",), ("l12",)} & set(named)
    assert "rod 12" in telling.sentence(found)


def test_what_is_nearly_everything_is_named_with_what_it_leaves():
    """Warm rods and a gear ripple of 30 per turn; what both leave is a trace."""
    found = diagnosed("both", "own_delta")
    assert not found.established
    if found.verdict == "unexplained":
        assert found.nearly is not None and set(found.nearly.explanation.names) == {"thermal_rods", "gear_ripple"}
        assert found.nearly.explanation.held_out is not None and found.nearly.explanation.held_out.times_after < 1.1
        assert "gear_ripple:arm@30 with thermal_rods" in telling.sentence(found)
    else:
        assert ("gear_ripple", "thermal_rods") in [e.names for e in found.sets]


def test_a_member_that_held_out_rows_do_not_ask_for_is_not_established():
    """Warm rods of 12 ppm/K alone; beside them chance asks for a compliance, and `add` would say to drop it again."""
    model = fitted("warm_rods", "default_delta")
    found = judged(model, "warm_rods")
    assert found.established == ("thermal_rods",) and found.verdict == "ambiguous"
    assert found.sets[0].names == ("rod_compliance", "thermal_rods")
    assert found.sets[0].unconfirmed == ("rod_compliance",)
    assert "Perhaps also rods stretch under load" in telling.sentence(found)
    assert [a["effect"] for a in advice.advice(found) if a["do"] == "add"] == ["thermal_rods"]


def test_a_bound_that_excludes_the_truth_is_a_misfit():
    model = fitted("bound", "bound", bounds={"l11": (-0.5e-3, 0.5e-3)})
    assert judged(model, "bound").verdict == "unexplained"
    assert judged(fitted("bound", "bound"), "bound").verdict == "nothing_missing"


@pytest.mark.parametrize(
    ("name", "robot", "channel", "member", "line", "size"),
    [
        ("slip_2", "delta_a", "actuator", 0, 63, None),
        ("bump-x2_0", "delta_a", "body", -1, 52, None),
        ("slip_1mm", "linear", "actuator", 1, 43, 1e-3),
        ("slip_1mm_with_time", "linear", "actuator", 1, 43, 1e-3),
        ("slip_5mm_last_quarter", "linear", "actuator", 1, 63, 5e-3),
    ],
)
def test_a_step_is_named_with_its_part_row_and_size(name, robot, channel, member, line, size):
    """With a time or without; that of the tracker is twice 50 µm, those of the linear Delta are 1 and 5 mm."""
    found = diagnosed(name, robot)
    assert found.verdict == "unexplained" and not found.established
    event = found.events[0]
    assert event.found.shape == "step" and (event.found.channel, event.found.member) == (channel, member)
    assert abs(int(found.problem.data.lines[event.found.row]) - line) <= 1
    assert size is None or abs(event.theta[0]) == pytest.approx(size, rel=0.03)
    said = telling.sentence(found)
    assert "Something happened while measuring" in said and f"line {line}" in said


def test_errors_of_a_coarse_encoder_repeat_and_are_no_noise():
    found = diagnosed("encq_2")
    assert found.noise.sigma_pos < 17e-6 and found.noise.sigma_q == 0  # replicates scatter by 13.8 µm
    assert found.verdict == "unexplained" and "errors of the motor angles" in telling.sentence(found)


def test_the_map_of_a_ripple_accuses_the_motor_angles_alone():
    found = diagnosed("ripple37", "own_delta")
    assert found.established == ("gear_ripple",)
    hot = telling.hot_cells(found.cells)
    assert [(c.channel, c.variable) for c in hot] == [("actuator", "q")]


def test_noise_that_is_correlated_in_time_establishes_nothing():
    found = diagnosed("ou_4")
    assert not found.established and found.verdict in ("nothing_missing", "ambiguous")
    assert "replicates lie too close in time to stand for slow noise" in telling.sentence(found)
