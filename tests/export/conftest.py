"""Robots as built, one of every file of models/."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pcalib import effects
from pcalib import robot as robots
from pcalib.model import FittedEffect, Model

FILES = sorted((Path(__file__).parents[2] / "models").glob("*.toml"))


@pytest.fixture(params=FILES, ids=lambda f: f.stem)
def built(request) -> Model:
    """A robot with errors in all of its geometry."""
    robot = robots.load(request.param)
    mechanism, rng = robot.mechanism, np.random.default_rng(4)
    size = np.where(np.array(mechanism.units) == "m", 2e-4, 1e-3)
    return Model(robot, mechanism.nominal + size * rng.standard_normal(len(size)), "complete")


@pytest.fixture(scope="session")
def with_effects() -> Callable[[Model], Model]:
    """A function: a model → the same with every effect that has a closed form, in its richest variant."""

    def add(model: Model) -> Model:
        robot, rng, found = model.robot, np.random.default_rng(5), []
        for name in effects.names():
            kind = effects.get(name)
            if kind.unsuited(robot.mechanism):
                continue
            effect = effects.get(name, kind.variants[-1], robot)
            theta = np.array([p.prior for p in effect.parameters]) * rng.standard_normal(len(effect.parameters))
            closed = effect.closed_form(theta) is not None or effect.channels == ("sensor",)
            if closed:
                found.append(FittedEffect(effect, theta, effect.spec))
        assert found
        return Model(robot, model.k, "complete", tuple(found))

    return add
