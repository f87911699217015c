"""Changes between sessions, on MuJoCo's robots: the part that was moved is named, and nothing where nothing was."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from bench import plan as plans
from bench import simulate
from bench import truth as truths
from bench.instrument import Instrument
from bench.jobs.changes import pairs
from pcalib import effects, importers, modelfile, rotation
from pcalib import robot as robots
from pcalib.changes import telling
from pcalib.changes.results import Verdict
from pcalib.changes.search import changes, hypotheses
from pcalib.changes.update import update
from pcalib.data import measurement
from pcalib.data.measurement import Measurements
from pcalib.diagnosis.discriminate import next_rows
from pcalib.errors import EffectError, FitError, InputError
from pcalib.fitting import identification
from pcalib.model import FittedEffect, Model

ROOT = Path(__file__).parents[2]
CASE = ROOT / "tests" / "cases" / "second_session_one_tower"
REAL = ROOT / ".." / "shared" / "data" / "hexapod108" / "measurements.csv"
TOOLS = [np.zeros(3), np.array([0.06, 0.0, -0.2])]


@lru_cache(maxsize=8)
def _first(kind: str) -> tuple[np.ndarray, Model]:
    """A robot with random errors and the model of its first session of 40 poses."""
    robot = robots.load(ROOT / "models" / f"{kind}.toml")
    errors = truths.draw_errors(robot, 1e-4, np.radians(0.05), 3)
    return errors, identification.fit(_session(robot, errors, 40, 1), robot).model


def _session(robot, errors, n, seed, moved=False) -> Measurements:
    truth = truths.Truth(robot, errors, Instrument(sigma_pos=15e-6, sigma_rot=60e-6), ())
    data = simulate.run(truth, plans.make(robot, "random", n, tools=TOOLS, seed=seed), seed).measurements
    if not moved:
        return data
    turn, shift = rotation.exp(np.array([2e-4, -3e-4, 4e-4])), np.array([1e-3, -5e-4, 3e-4])
    return replace(data, position=data.position @ turn.T + shift, rotation=turn @ data.rotation)


def _second(kind: str, part: str, change: list[float], n: int = 12, seed: int = 5, moved: bool = True) -> Measurements:
    errors, model = _first(kind)
    found = next(p for p in model.robot.mechanism.parts if p.name == part)
    return _session(model.robot, errors + found.basis @ np.array(change), n, seed, moved)


@pytest.mark.parametrize("kind", ["delta", "linear_delta", "hexapod"])
def test_nothing_changed(kind):
    errors, model = _first(kind)
    alarms = [
        changes(model, _session(model.robot, errors, 12, seed, moved=True)).verdict is not Verdict.NOTHING
        for seed in range(20, 40)
    ]
    assert sum(alarms) <= 4  # 5 % of 20 is 1; more than 4 would come once in four hundred


@pytest.mark.parametrize(
    ("kind", "part", "change"),
    [
        ("delta", "b21", [0.0, -240e-6, 0.0]),
        ("delta", "q2.zero", [2e-3]),
        ("linear_delta", "q2.scale", [2e-3]),
        ("hexapod", "leg4.zero", [-300e-6]),
        ("hexapod", "a3", [200e-6, 0.0, 100e-6]),
    ],
)
def test_the_part_that_changed_is_named_with_its_size(kind, part, change):
    _, model = _first(kind)
    found = changes(model, _second(kind, part, change))
    assert found.verdict in (Verdict.ESTABLISHED, Verdict.AMBIGUOUS)
    first = found.sets[0]
    assert first.names == (part,)
    (member,) = first.members
    off = np.abs(member.theta - change) / np.maximum(member.sigma, 1e-9)
    assert off.max() < 4
    assert found.frame[:3] == pytest.approx([1e-3, -5e-4, 3e-4], abs=1e-3)
    assert member.candidate.hypothesis.words in telling.sentence(found)


def test_two_parts_at_once():
    errors, model = _first("hexapod")
    parts = {p.name: p.basis for p in model.robot.mechanism.parts}
    both = errors + parts["leg1.zero"][:, 0] * 3e-4 + parts["b4"] @ np.array([3e-4, 0.0, 0.0])
    found = changes(model, _session(model.robot, both, 24, 6, moved=True))
    assert ("b4", "leg1.zero") in [e.names for e in found.sets]


def test_a_slip_within_the_session_has_its_row():
    _, model = _first("delta")
    before = _second("delta", "q1.zero", [0.0], 40, 7)
    after = _second("delta", "q1.zero", [1.5e-3], 40, 7)
    joined = replace(
        before,
        position=np.where(np.arange(40)[:, None] < 25, before.position, after.position),
        rotation=np.where(np.arange(40)[:, None, None] < 25, before.rotation, after.rotation),
    )
    found = changes(model, joined)
    best = found.sets[0].members[0]
    assert best.slip is not None and best.slip.hypothesis.name == "q1.zero"
    assert abs(best.slip.row - 25) <= 1
    assert telling.as_json(found)["slip"] == {"row": best.slip.row + 1, "part": "q1.zero"}


def test_an_update_moves_the_part_and_little_else():
    _, model = _first("hexapod")
    data = _second("hexapod", "leg4.zero", [-1e-3])
    part = next(h for h in hypotheses(model) if h.name == "leg4.zero")
    made = update(model, data, [part])
    assert made.rms_after < 40e-6 < made.rms_before
    moved = (made.model.k - model.k) / np.sqrt(np.diag(model.posterior.covariance))
    own = np.flatnonzero(part.basis[:, 0])
    assert np.abs(np.delete(moved, own)).max() < 4
    assert (part.basis[:, 0] @ (made.model.k - model.k)) == pytest.approx(-1e-3, abs=2e-4)
    again = changes(made.model, _second("hexapod", "leg4.zero", [-1e-3], 12, 9))
    assert again.verdict is Verdict.NOTHING


def test_the_covariance_survives_the_file():
    _, model = _first("delta")
    back = modelfile.loads(modelfile.dumps(model))
    assert back.posterior.names == model.posterior.names
    scale = np.sqrt(np.diag(model.posterior.covariance))
    off = (back.posterior.covariance - model.posterior.covariance) / np.outer(scale, scale)
    assert np.abs(off).max() < 1e-5


def test_what_cannot_be_asked_is_said():
    _, model = _first("delta")
    data = _second("delta", "l11", [1e-4])
    with pytest.raises(InputError, match="keeps no uncertainty"):
        changes(replace(model, posterior=None, sigma=None), data)
    simple = identification.fit(_session(model.robot, _first("delta")[0], 40, 1), model.robot, "classical").model
    part = next(h for h in hypotheses(model) if h.name == "b11")
    with pytest.raises(FitError, match="cannot express"):
        update(simple, data, [part])


DAMAGED = ["unknowns = []", 'factor_f32 = "AAAA"', "noise = [1.0]", 'factor_f32 = "not base64!"']


@pytest.mark.parametrize("section", DAMAGED)
def test_a_damaged_covariance_is_refused(section):
    _, model = _first("hexapod")
    key = section.partition(" ")[0]
    lines = modelfile.dumps(model).splitlines()
    start = next(i for i, line in enumerate(lines) if line == "[posterior]")
    first = next(i for i in range(start, len(lines)) if lines[i].startswith(f"{key} ="))
    last = first if not lines[first].endswith("[") else next(i for i in range(first, len(lines)) if lines[i] == "]")
    with pytest.raises(InputError, match="posterior"):
        modelfile.loads("\n".join([*lines[:first], section, *lines[last + 1 :]]))


def test_an_endstop_that_slipped_though_the_model_keeps_no_covariance():
    """A model file of an earlier version: its σ count as independent, and 2 mm at a tower are seen all the same."""
    model = modelfile.load(CASE / "first.model.toml")
    found = changes(model, measurement.load(CASE / "second.csv", model.robot))
    assert model.posterior is None
    assert found.sets[0].names == ("q2.zero",)
    assert found.sets[0].members[0].theta == pytest.approx([-2e-3], abs=5e-5)
    assert "the zero of motor q2, by -2.0" in telling.sentence(found)


def test_a_set_up_that_was_not_touched_shows_more():
    errors, model = _first("hexapod")
    data = _second("hexapod", "leg4.zero", [-100e-6], moved=False)
    same, free = changes(model, data, same_setup=True), changes(model, data)
    assert same.sets[0].names == ("leg4.zero",) and not len(same.frame)
    assert len(free.frame) == 6
    smallest = [next(f.smallest for f in found.findings if f.name == "leg4.zero")[0] for found in (same, free)]
    assert 3 * smallest[0] < smallest[1]  # the frame can take up most of a leg
    moved = _session(model.robot, errors, 12, 5, moved=True)
    assert changes(model, moved, same_setup=True).verdict is not Verdict.NOTHING


def test_a_misstated_sigma_raises_no_alarm():
    """Instruments that are 1.5 times as noisy as stated: the old fit's residuals say so."""
    errors, _ = _first("delta")
    robot = robots.load(ROOT / "models" / "delta.toml")
    first = _session(robot, errors, 40, 1)
    model = identification.fit(replace(first, sigma=first.sigma / 1.5), robot).model
    assert model.posterior.left.ratio == pytest.approx([1.5, 1.5], rel=0.25)
    second = _session(robot, errors, 12, 31, moved=True)
    assert changes(model, replace(second, sigma=second.sigma / 1.5)).verdict is Verdict.NOTHING


@pytest.mark.skipif(not REAL.exists(), reason=f"no real measurements at {REAL}")
def test_a_real_session_split_in_time_shows_no_change(tmp_path):
    """The legs of this hexapod repeat to 0.3 mm, and its model fits worse where it was not fitted."""
    found = importers.run("motion-capture", REAL, [])
    robot, data = found.robot, found.data
    first = np.arange(len(data)) < 70
    model = identification.fit(data.take(first), robot).model
    left = model.posterior.left
    assert left.sigma_q == pytest.approx(0.03, abs=0.01)  # [rad] of motors that lengthen a leg by 11 mm/rad
    assert left.misfit > 1.2 and left.dof < 60
    assert changes(model, data.take(~first)).verdict is Verdict.NOTHING


def test_a_backlash_that_grew_is_a_change_of_what_the_model_has():
    drawn = pairs.Pair.draw("delta", 40, "aligned", np.random.default_rng(4), loaded=True)
    play = pairs.effect(drawn.robot, "backlash")
    first = drawn.measured([play], 1.0, pairs.plan_of(drawn.robot, 60, 9, True), 3, again=False)
    play_known = effects.parse("backlash", drawn.robot)
    start = FittedEffect(play_known, np.zeros(len(play_known.parameters)), play_known.spec)
    model = identification.fit(first, drawn.robot, effects=[start]).model
    assert changes(model, drawn.second([play], 1.0)).verdict is Verdict.NOTHING
    found = changes(model, drawn.second([play], 3.0))
    assert ("backlash",) in [e.names for e in found.sets]
    member = next(e for e in found.sets if e.names == ("backlash",)).members[0]
    assert member.theta / member.before == pytest.approx(2.0, rel=0.15)  # three times as large as before
    assert "before" in telling.amount(member)
    after = update(model, drawn.second([play], 3.0), [member.candidate.hypothesis]).model
    assert after.effects[0].theta == pytest.approx(3 * model.effects[0].theta, rel=0.15)


def test_rows_that_tell_rival_parts_apart_are_planned():
    _, model = _first("delta")
    data = _second("delta", "l21", [120e-6])
    found = next_rows(model, data, ("l21", "b21"), 6)
    assert found.between == ("l21", "b21")
    assert found.before < found.after[0] < found.after[-1]
    assert found.after[-1] > found.more_of_the_same * 0.9
    with pytest.raises(InputError, match="keeps no uncertainty"):
        next_rows(replace(model, posterior=None), data, ("l21", "b21"), 6)
    with pytest.raises(EffectError, match="unknown effect or level"):
        next_rows(model, data, ("l99", "b21"), 6)


@pytest.mark.parametrize("moved", [0.0, 0.15])
def test_a_tracker_whose_body_is_turned_is_registered_anew_and_its_motion_is_told(moved):
    """The body's axes are 33° off those of the plate; between the sessions the tracker moves along its x or not."""
    errors, base = _first("delta")
    body, turn = rotation.exp(np.array([0.05, -0.03, 0.57])), rotation.exp(np.array([0.02, 0.03, 2.2]))

    def tracked(data: Measurements, shift: float) -> Measurements:
        position = data.position @ turn.T + np.array([2.5 + shift, -0.8, 0.4])
        return replace(data, frame="tracker", position=position, rotation=turn @ data.rotation @ body)

    model = identification.fit(tracked(_session(base.robot, errors, 40, 1), 0.0), base.robot).model
    second = tracked(_session(base.robot, errors, 12, 5), moved)
    found = changes(model, second)
    assert found.verdict is Verdict.NOTHING
    assert np.linalg.norm(found.frame[:3]) == pytest.approx(moved, abs=2e-5)
    assert np.linalg.norm(found.frame[3:]) < 2e-4
    part = next(h for h in hypotheses(model) if h.name == "l21")
    rod = tracked(_second("delta", "l21", [150e-6], moved=False), moved)
    assert "l21" in [n for e in changes(model, rod).sets for n in e.names]
    after = update(model, rod, [part]).model
    column = model.robot.mechanism.parameters.index("l21")
    assert (after.k - model.k)[column] == pytest.approx(150e-6, abs=4e-5)
