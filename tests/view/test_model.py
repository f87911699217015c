"""What a model predicts that commands from the drawing miss by."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcalib import effects, modelfile, view
from pcalib import robot as robots
from pcalib.mechanics import kinematics
from pcalib.model import FittedEffect, Frame, Model
from pcalib.view.model import predicted

MODELS = Path(__file__).parents[2] / "models"


def test_deviation_is_that_of_the_forward_kinematics(delta, perturb):
    k = perturb(1)
    tool = np.array([0.0, 0.0, -0.2])
    what = predicted(Model(delta, k, frame=Frame(translation=np.ones(3))), [tool])
    field = what.maps[0]
    nominal = kinematics.inverse(delta.mechanism, delta.mechanism.nominal, field.targets, tool=tool)
    landed = kinematics.forward(delta.mechanism, k, nominal.q).pose.tcp(tool)
    assert field.errors[0] == pytest.approx(landed - field.targets, abs=1e-12)
    assert [s.label for s in what.steps] == ["As drawn", "Calibrated"] and (field.status == "ok").all()


def test_the_nominal_robot_misses_nothing(delta):
    assert predicted(Model.nominal(delta)).max.max() < 1e-9


def test_earlier_steps_of_the_history_are_steps_of_the_ladder(delta, perturb):
    """Halfway to the model, half of the error is left (to first order)."""
    k = perturb(2)
    half = Model(delta, delta.mechanism.nominal + 0.5 * (k - delta.mechanism.nominal))
    model = Model(delta, k)
    entries = (modelfile.snapshot(half, "fit"), modelfile.snapshot(model, "add"))
    what = predicted(replace(model, history=entries))
    assert [s.label for s in what.steps] == ["As drawn", "fit 1", "Calibrated"]
    assert delta.mechanism.levels[half.level].text in what.steps[1].text
    assert what.rms[1] == pytest.approx(0.5 * what.rms[0], rel=0.02)


def test_load_counts_and_other_conditions_are_at_their_reference(delta):
    compliance, warm = (effects.parse(name, delta) for name in ("drive_compliance", "thermal_rods"))
    model = Model(delta, delta.mechanism.nominal, effects=(
        FittedEffect(compliance, np.full(len(compliance.parameters), 8e-5)),
        FittedEffect(warm, np.full(len(warm.parameters), 1e-5)),
    ))  # fmt: skip
    light, heavy = (predicted(model, payload=kg).rms[0, 0] for kg in (0.0, 2.0))
    assert heavy > 1.5 * light > 1e-5
    no_load = replace(model, effects=model.effects[1:])
    assert predicted(no_load).max.max() < 1e-9


@pytest.mark.parametrize("name", sorted(f.stem for f in MODELS.glob("*.toml") if "." not in f.stem))
def test_every_kind_can_be_recorded(name, tmp_path, entities):
    robot = robots.load(MODELS / f"{name}.toml")
    size = np.array([{"m": 1e-4, "rad": 1e-3, "1": 1e-4}[u] for u in robot.mechanism.units])
    model = Model(robot, robot.mechanism.nominal + size * np.random.default_rng(0).standard_normal(len(size)))
    what = predicted(model)
    away = {"hexapod": [0, 0, 1]}.get(name, [0, 0, -1] if 2 in robot.mechanism.plate_dofs else [0, -1, 0])
    assert what.maps[1].tool / np.linalg.norm(what.maps[1].tool) == pytest.approx(away)
    assert (what.rms[0] > 1e-6).all() and (what.rms[0] < 3e-2).all()
    assert (what.rms[-1] == 0).all() and np.array_equal(what.steps[-1].model.k, model.k)
    view.write(tmp_path / "m.rrd", what, model=model)
    assert any(path.endswith("/error") for path in entities(tmp_path / "m.rrd"))
