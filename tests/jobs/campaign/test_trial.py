"""One robot of a campaign: what it is made of, what it gives, and how it fails."""

from __future__ import annotations

import numpy as np
import pytest

from bench.jobs import methods, study
from bench.jobs.campaign import spec, trial
from bench.jobs.campaign.study import Campaign
from bench.kinds import MODELS
from bench.machine import Machine
from pcalib import compensation
from pcalib import robot as robots
from pcalib.errors import FitError
from pcalib.model import Model


def rows_of(campaign, number=0):
    return study.rows(Campaign(campaign), [number])


def figures(rows, method, tool="0,0,-300mm"):
    (row,) = [r for r in rows if r["method"] == method and r["tool"] == tool]
    return row


def test_rows_of_a_robot(written):
    rows = rows_of(spec.load(written()))
    assert [(r["method"], r["tool"]) for r in rows] == [
        (m, t) for m in ("model24", "complete") for t in ("0,0,0mm", "0,0,-300mm")
    ]
    for row in rows:
        assert row["status"] == "ok" and row["reason"] == "" and row["measured"] == 14
        assert row["reached"] == row["targets"] == 8 == len(row["error_um"])
        assert row["rms_um"] == pytest.approx(np.sqrt(np.mean(row["error_um"].astype(float) ** 2)), rel=1e-6)
        assert row["rms_um"] <= row["p95_um"] <= row["max_um"] == pytest.approx(row["error_um"].max(), rel=1e-6)
    assert figures(rows, "complete")["rms_um"] < 60 < 300 < figures(rows, "model24")["rms_um"]


def test_errors_are_those_of_the_machine(written):
    """What a row says of the nominal robot, from the truth and MuJoCo with rod bodies."""
    campaign = spec.load(written(written.small.replace("model24", "nominal")))
    row = figures(rows_of(campaign, 3), "nominal")
    stand = trial.stand(campaign, 0)
    robot = stand.cell.robot
    tool = np.array([0.0, 0.0, -0.3])
    goal = stand.targets.x + tool
    q = compensation.compensate(Model.nominal(robot), goal, tool).q
    landing = Machine(robot, robot.mechanism.nominal + trial.truth_errors(campaign, 3)).land(q, tool)
    error = np.linalg.norm(landing.tcp - goal, axis=1) * 1e6
    assert row["rms_um"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    turn = np.degrees(np.arccos(np.clip((np.trace(landing.R, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert row["tilt_urad"] == pytest.approx(np.radians(np.sqrt(np.mean(turn**2))) * 1e6, rel=1e-5)


def test_a_trial_depends_on_its_number_only(written):
    campaign = spec.load(written())
    alone = rows_of(campaign, 4)
    rows_of(campaign, 1)
    again = study.rows(Campaign.parse(campaign.source), [4])
    for a, b in zip(alone, again, strict=True):
        assert {k: v for k, v in a.items() if k != "error_um"} == {k: v for k, v in b.items() if k != "error_um"}


def test_cells_differ_by_what_is_swept_and_not_by_luck(written):
    sweep = '[[sweep]]\n"geometry.sigma_length_mm" = [0.1, 0.2]\n"geometry.sigma_angle_deg" = [0.05, 0.1]\n'
    campaign = spec.load(written(written.small + sweep))
    small, large = trial.truth_errors(campaign, 2), trial.truth_errors(campaign, 2 + campaign.robots)
    assert np.allclose(large, 2 * small) and small.any()
    a, b = (figures(rows_of(campaign, n), "complete") for n in (2, 2 + campaign.robots))
    assert a["rms_um"] != b["rms_um"] == pytest.approx(a["rms_um"], rel=0.3)  # noise, not geometry, limits both


def test_exact_data_are_landed_on(written):
    """Without noise and with all there is to know, what is left is rounding and what no data can tell."""
    exact = {"sigma_pos_mm": "sigma_pos_mm = 1e-9", "sigma_rot_deg": "sigma_rot_deg = 1e-9"}
    row = figures(rows_of(spec.load(written(poses="poses = 30", **exact))), "complete")
    assert row["rms_um"] < 1e-3


def test_a_robot_that_cannot_be_built_is_recorded(written):
    short = "".join(f"l{i}{j}_mm = -600\n" for i in (1, 2, 3) for j in (1, 2))
    campaign = spec.load(written(written.small + "[geometry.errors]\n" + short))
    rows = rows_of(campaign)
    assert len(rows) == 4 and all(r["status"] == "failed" and r["reached"] == 0 for r in rows)
    assert "cannot be assembled" in rows[0]["reason"] and "\n" not in rows[0]["reason"]


def test_a_method_that_fails_leaves_the_others_alone(written):
    campaign = spec.load(written(poses="poses = 5"))
    rows = rows_of(campaign)
    assert figures(rows, "model24")["status"] == "failed" or figures(rows, "model24")["measured"] == 5
    assert figures(rows, "complete")["status"] == "failed" and "too few poses" in figures(rows, "complete")["reason"]


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
        (FitError("the fit is not usable (not converged): no minimum\nmore lines"),
         "the fit is not usable (not converged): no minimum"),
    ],
    ids=["unexpected", "unusable fit"],
)  # fmt: skip
def test_what_stops_a_fit_is_the_reason_of_a_failed_row(written, monkeypatch, error, reason):
    def broken(*_args, **_more):
        raise error

    campaign = spec.load(written())
    monkeypatch.setattr(methods.identification, "fit", broken)
    assert figures(rows_of(campaign), "complete")["reason"] == reason


@pytest.mark.parametrize("error", [MemoryError(), OSError(28, "No space left on device")])
def test_troubles_of_the_computer_are_no_property_of_a_robot(written, monkeypatch, error):
    def broken(*_args, **_more):
        raise error

    campaign = spec.load(written())
    monkeypatch.setattr(methods.identification, "fit", broken)
    with pytest.raises(type(error)):
        rows_of(campaign)


def test_faults_are_drawn_and_act(written):
    text = written.small.replace("targets = 8", "targets = 3\npayload_kg = 1")
    text = text.replace("tools_mm = [0, 300]", "tools_mm = [100]")
    fault = "[faults.drive_compliance]\ncompliance_urad_Nm = { uniform = [100, 200] }\n"
    plain, soft = spec.load(written(text)), spec.load(written(text + fault, "soft.toml"))
    fixed, drawn = soft.cell(0).faults[0].fixed, soft.cell(0).faults[0].drawn
    assert not fixed and set(drawn) == {"compliance_urad_Nm"}
    rigid, bent = (figures(rows_of(c), "complete", "0,0,-100mm") for c in (plain, soft))
    assert rigid["status"] == bent["status"] == "ok"
    assert bent["rms_um"] > 2 * rigid["rms_um"]


@pytest.mark.parametrize("kind", ["hexa", "linear_delta"])
def test_other_robots(written, kind):
    robot = robots.load(MODELS / f"{kind}.toml")
    text = written.small.replace('robot = "delta"', f'robot = "{kind}"').replace('name = "model24"', 'name = "nominal"')
    rows = rows_of(spec.load(written(text.replace("poses = 14", "poses = 30").replace("targets = 8", "targets = 4"))))
    assert all(row["status"] == "ok" for row in rows), rows
    tool = "0,0,-300mm"
    assert figures(rows, "complete", tool)["rms_um"] < 0.3 * figures(rows, "nominal", tool)["rms_um"]
    assert robot.kind == kind


def test_directions_that_no_command_prescribes_are_no_error(written):
    """The planar robot is sent along x; where the closure lets it stand in y is not its fault."""
    text = written.small.replace('robot = "delta"', 'robot = "planar"').replace("model24", "nominal")
    campaign = spec.load(written(text, tools_mm="tools_mm = [[0, -100, 0]]"))
    row = figures(rows_of(campaign), "complete", "0,-100,0mm")
    assert row["rms_um"] < 30
    landing, goals = trial.landings(campaign, 0)["complete"], trial.stand(campaign, 0).goals.tcp(np.array([0, -0.1, 0]))
    assert np.array_equal(landing.tcp[:, 1:], goals[:, 1:])
    assert row["rms_um"] == pytest.approx(1e6 * np.sqrt(np.mean((landing.tcp - goals)[:, 0] ** 2)))


def test_targets_on_a_grid(written):
    campaign = spec.load(written(targets='places = "grid"\nspacing_mm = 200'))
    x = trial.stand(campaign, 0).targets.x * 1e3
    assert len(np.unique(np.round(x[:, 0]))) > 2 and set(np.round(np.abs(x[:, 0]))) <= {0, 200, 400}
    assert {row["targets"] for row in rows_of(campaign)} == {len(x)}


@pytest.mark.parametrize("plan", ["border", "rich", "d-optimal"])
def test_plans(written, plan):
    campaign = spec.load(written(poses=f'kind = "{plan}"\nposes = 16\ncandidates = 60\ntools_mm = [0, 100]'))
    first, second = rows_of(campaign, 0), rows_of(campaign, 1)
    assert figures(first, "complete")["status"] == "ok" and figures(first, "complete")["measured"] == 16
    assert figures(first, "complete")["rms_um"] != figures(second, "complete")["rms_um"]


def test_position_only(written):
    text = written.small + 'reads = "position"\n'
    pose = figures(rows_of(spec.load(written(poses="poses = 30"))), "complete")
    position = figures(rows_of(spec.load(written(text, "p.toml", poses="poses = 30"))), "complete")
    assert position["rms_um"] > 3 * pose["rms_um"]  # the tilt is not seen with one tool


def test_a_tracker_of_unknown_place_costs_no_accuracy(written):
    """Its model cannot know where the base stands: landings are judged after the best rigid motion, as by verify."""
    base = figures(rows_of(spec.load(written(poses="poses = 30"))), "complete")
    unknown = {"poses": "poses = 30", "sigma_rot_deg": 'sigma_rot_deg = 0.005\nframe = "tracker"'}
    tracker = figures(rows_of(spec.load(written(**unknown))), "complete")
    assert tracker["rms_um"] < 1.5 * base["rms_um"] and tracker["tilt_urad"] < 1.5 * base["tilt_urad"]
    few = figures(rows_of(spec.load(written(targets="targets = 2", **unknown))), "complete")
    assert few["status"] == "failed" and "fewer than three of the targets: no rigid motion" in few["reason"]


def test_drives_repeat_themselves_no_better_while_landing(written):
    sigma = np.radians(0.02)
    text = written.small.replace("model24", "nominal").replace("sigma_length_mm = 0.1", "sigma_length_mm = 0")
    noise = "sigma_rot_deg = 0.005\nsigma_joint_deg = 0.02"
    exact = written(text, sigma_angle_deg="sigma_angle_deg = 0", sigma_rot_deg=noise, targets="targets = 100")
    campaign = spec.load(exact)
    row = figures(rows_of(campaign), "nominal", "0,0,0mm")
    stand = trial.stand(campaign, 0)
    robot, x = stand.cell.robot, stand.targets.x
    q = compensation.compensate(Model.nominal(robot), x).q
    step = 1e-6 * np.eye(3)
    J = np.stack([Machine(robot).land(q + h).tcp - Machine(robot).land(q - h).tcp for h in step], axis=-1) / 2e-6
    expected = sigma * np.sqrt(np.sum(J**2, axis=(1, 2)).mean())
    assert row["rms_um"] == pytest.approx(expected * 1e6, rel=0.2)
    assert row["rms_um"] != figures(rows_of(campaign, 1), "nominal", "0,0,0mm")["rms_um"]
