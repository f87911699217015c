"""Figures of a fit: the robot with its parameters' names, for every kind."""

from pathlib import Path

import pytest

from pcalib import robot as robots
from pcalib.model import Model
from pcalib.report import residuals

MODELS = Path(__file__).resolve().parents[2] / "models"


@pytest.mark.parametrize("name", ["delta", "hexa", "hexa321", "h4", "linear_delta", "hexapod", "planar"])
def test_every_kind_is_drawn_with_its_plate_joints_and_rods_named(name):
    model = Model.nominal(robots.load(MODELS / f"{name}.toml"))
    drawn = residuals.robot(model)
    mechanism = model.robot.mechanism
    for index in mechanism.rod_lengths:
        assert f">{mechanism.parameters[index].partition('.')[0]}<" in drawn
    assert drawn.count("<text") > len(mechanism.rod_lengths)
